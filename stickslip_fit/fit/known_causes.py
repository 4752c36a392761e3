"""Causes whose sizes are known: a published law with them in it has its own parameters left to calibrate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.fit.intervals import quadratic_interval
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.laws import Configuration, Rows, State, StepLaw
from stickslip_fit.laws.law import Counter

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Solve = Callable[[Array], Array]
"""Steps of each calibration traverse to parameters of the published law, (g, p) -> (g, p)."""

MOST_PASSES = 100
SETTLED = 1e-10  # of a change of the parameter that matters
APART = 1e-3  # of a cause's scale
BESIDE_THE_POINT = 1e-9


@dataclass(frozen=True, eq=False)
class KnownCauses:
    """Causes as a result has them.

    Attributes
    ----------
    causes : tuple of Cause
    values : array, shape (q,)
    covariance : array, shape (q, q)
    interval : array, shape (q, 2)
    """

    causes: tuple[Cause, ...]
    values: Array
    covariance: Array
    interval: Array


def known_causes(result: Result) -> KnownCauses:
    """The causes of a result.

    Raises
    ------
    InputError
        If its laws have none, or their sizes are not all known.
    """
    fits = list(result.joints.values())
    law = fits[0].law
    if not isinstance(law, ExtendedLaw):
        raise InputError("the laws of this result have no causes in them; fit a log with --cause, save that")
    last = slice(-len(law.common), None)
    known = np.all([fit.known[:, last].all(axis=0) for fit in fits], axis=0)
    if not known.all():
        unknown = ", ".join(each.name for each, fine in zip(law.common, known, strict=True) if not fine)
        raise InputError(f"this result does not know {unknown}; fit its log without that cause")
    # They are the same in all groups, but for those that have no error bars of their own.
    covariance = np.concatenate([fit.covariance[:, last, last] for fit in fits])
    interval = np.concatenate([fit.interval[:, last] for fit in fits])
    best = int(np.argmax(np.isfinite(covariance).all(axis=(1, 2))))
    return KnownCauses(law.causes, fits[0].values[0, last], covariance[best], interval[best])


class HeldLaw(StepLaw):
    """A published law with causes in it whose sizes are not to be fitted.

    Parameters
    ----------
    law : StepLaw
        Published.
    causes : sequence of Cause
    sizes : array, shape (q,)
        Of their parameters.
    """

    name = "held"

    def __init__(self, law: StepLaw, causes: Sequence[Cause], sizes: Array) -> None:
        self.law = law
        self.extended = ExtendedLaw(law, causes)
        self.sizes = sizes
        self.joint = law.joint
        self.parameters = law.parameters

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `StepLaw.columns`."""
        return self.extended.columns

    @property
    def widest(self) -> float:  # type: ignore[override]
        """See `StepLaw.widest`."""
        return self.extended.widest

    def whole(self, values: Array) -> Array:
        """Parameters of the extended law, (..., p) -> (..., p + q)."""
        sizes = np.broadcast_to(self.sizes, (*values.shape[:-1], len(self.sizes)))
        return np.concatenate([values, sizes], axis=-1)

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""
        return self.extended.gamma(state, self.whole(values))

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`."""
        return self.extended.gamma_slopes(state, self.whole(values))[..., : len(self.parameters)]

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`."""
        count, own = self.extended.counter(rows), len(self.parameters)

        def held(values: Array) -> tuple[Array, Array]:
            counts, slopes = count(self.whole(values))
            return counts, slopes[:, :own]

        return held

    def effect(self, rows: Rows, values: Array) -> Array:
        """By how much the causes change log(steps), shape (n,)."""
        return self.extended.predict(rows, self.whole(values)) - self.law.predict(rows, values)

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        return self.law.start_values(mean_step)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return self.law.scales(mean_step)

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: those of the published law, whose calibration is asked for."""
        return self.law.features(rows)

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`."""
        return self.law.calibration()


def solve_held(
    law: HeldLaw, rows: pd.DataFrame, picked: Indices, steps: Array, mean_step: Array, solve: Solve
) -> Array:
    """Parameters that give the steps of each calibration traverse with the causes at work, (g, p) -> (g, p).

    What the causes do is divided out of the counts, and again with the better parameters, until these rest.

    Parameters
    ----------
    law : HeldLaw
    rows : DataFrame
    picked : array of int, shape (g, p)
        Calibration traverses; -1 where there is none.
    steps : array, shape (g, p)
    mean_step : array, shape (g,)
    solve : callable
        For the published law.

    Returns
    -------
    array, shape (g, p)
        NaN where a traverse is missing, or a cause makes one that is there depend on what is not known.
    """
    values, scales = solve(steps), law.scales(mean_step)
    for _ in range(MOST_PASSES):
        before, values = values, solve(steps / np.exp(_effects(law, rows, picked, values, mean_step)))
        if np.nan_to_num(np.abs(values - before) / scales).max(initial=0.0) < SETTLED:
            return values
    return np.full_like(values, np.nan)


def _effects(law: HeldLaw, rows: pd.DataFrame, picked: Indices, values: Array, mean_step: Array) -> Array:
    """What the causes do to each calibration traverse; NaN where that depends on what is not known."""
    made = picked >= 0
    taken, group = rows.iloc[picked[made]], np.nonzero(made)[0]
    one, other = (
        law.effect(taken, np.where(np.isnan(values), stand_in, values)[group])
        for stand_in in _ordinary(law, mean_step)
    )
    effects = np.full(picked.shape, np.nan)
    effects[made] = np.where(np.abs(one - other) < BESIDE_THE_POINT, one, np.nan)
    return effects


def _ordinary(law: HeldLaw, mean_step: Array) -> tuple[Array, Array]:
    """Two sets of parameters that a drive might have, each shape (g, p)."""
    usual = law.start_values(mean_step)
    return usual, usual + 0.1 * law.scales(mean_step)


def effect_of_rows(law: StepLaw, rows: pd.DataFrame, values: Array, mean_step: Array) -> Array | float:
    """By how much known causes change each row's log(steps), about where a parameter is not known.

    Parameters
    ----------
    law : StepLaw
        With held causes, or without.
    rows : DataFrame
    values : array, shape (n, p)
    mean_step : array, shape (n,)
    """
    if not isinstance(law, HeldLaw):
        return 0.0
    return law.effect(rows, np.where(np.isnan(values), law.start_values(mean_step), values))


def released(fit: JointFit, known: KnownCauses, solve: Callable[[HeldLaw], Array]) -> JointFit:
    """A calibration under a held law as one of the extended law; what is not sure of the causes goes with it.

    Parameters
    ----------
    fit : JointFit
        Of a HeldLaw.
    known : KnownCauses
    solve : callable
        From a held law to its calibrated parameters, shape (g, p).
    """
    law = fit.law
    assert isinstance(law, HeldLaw)
    groups, own, q = len(fit.values), len(law.parameters), len(known.values)
    follow = np.zeros((groups, own, q))
    for k in np.flatnonzero(np.diagonal(known.covariance) != 0):
        step = APART * law.extended.sizes[k] * (np.arange(q) == k)
        ahead, behind = (solve(HeldLaw(law.law, known.causes, known.values + way * step)) for way in (1, -1))
        follow[:, :, k] = (ahead - behind) / (2 * step[k])
    both = np.concatenate([follow, np.broadcast_to(np.eye(q), (groups, q, q))], axis=1)
    covariance = both @ known.covariance @ both.swapaxes(1, 2)
    covariance[:, :own, :own] += fit.covariance
    values = law.whole(fit.values)
    interval = quadratic_interval(values, covariance, fit.groups, fit.repeatability)
    interval[:, own:] = known.interval
    settled = np.concatenate([fit.known, np.ones((groups, q), dtype=bool)], axis=1)
    return replace(
        fit, law=law.extended, values=values, covariance=covariance, interval=interval, known=settled
    )
