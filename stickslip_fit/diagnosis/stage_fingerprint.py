"""Fingerprints of changes of a stage: what each would do to the counts of one joint and direction.

At one lambda after the other the physical law is fitted to counts without the change; then each change is
fitted to what is left. Its effect on every count is exact, that of the law's own parameters on it linear.
`stage_change` says what each change does to the law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.linearized import LawBlock, LinearizedFit, linearize_fit
from stickslip_fit.estimation._problem import DEFAULT_OPTIONS, single_problem
from stickslip_fit.estimation.drive_ratio import RATIOS, laws_by_width, stack_ratios, start_at
from stickslip_fit.laws import FRICTION_LIMITED
from stickslip_fit.laws.physical import POWERS, Physical
from stickslip_fit.machine import Machine

FREE = "free"
SINGLE = tuple(POWERS)  # of mass is friction's with the sign reversed
EVERYWHERE = (*RATIOS, FRICTION_LIMITED)
NEAR = (*RATIOS[::2], FRICTION_LIMITED)  # between which is looked for lambda where it is likely
REFINEMENTS = 2
REFITS, FINER = 2, 6  # of the law without the change that fits best, each at ever closer lambdas
UNLIKELY = 60.0  # deviance beyond the least, in units of the noise, of a lambda that is not looked at
LARGEST_EXCESS = 6.0  # standard deviations; where the best change leaves more, all lambdas are looked at
MAX_ITERATIONS = 60  # of the law's own fit
STEPS = 5  # of Gauss-Newton in the size of a change
DIFFERENCE = 1e-3
LARGEST = 0.5  # logarithm of a change
TINY, SINGULAR = 1e-9, 1e-6  # information of which counts say nothing, and relative to the most


@dataclass(frozen=True, eq=False)
class ChangeFit:
    """Least squares of a change's size s at one lambda: `deviance` + (s - size) information (s - size).

    Attributes
    ----------
    deviance : float
        Sum of squares of the residuals in units of the noise.
    size : array, shape (k,)
        Logarithm of what a quantity is multiplied by, where the course is 1; of a free change those of the
        step size without load and of r.
    information : array, shape (k, k)
    """

    deviance: float
    size: Array
    information: Array


IMPOSSIBLE = {
    name: ChangeFit(np.inf, np.zeros(k), np.zeros((k, k)))
    for name, k in {**dict.fromkeys(SINGLE, 1), FREE: 2}.items()
}


@dataclass(frozen=True, eq=False)
class Fingerprint:
    """All changes fitted to the traverses of one joint and direction.

    Attributes
    ----------
    joint : int
    direction : str
    ratios : array, shape (m,)
        The lambdas, in rising order.
    fits : tuple of mapping of str to ChangeFit
        At each, by change: those of `SINGLE` and `FREE`; of infinite deviance where lambda is too unlikely.
    df : array of int, shape (m,)
        Of the residuals that a free change leaves.
    """

    joint: int
    direction: str
    ratios: Array
    fits: tuple[dict[str, ChangeFit], ...]
    df: IntArray

    @property
    def excess(self) -> float:
        """Deviance that the best of the single changes leaves beyond noise's, in standard deviations."""
        deviance = np.array([_least(fits) for fits in self.fits])
        return float(np.min((deviance - self.df) / np.sqrt(2.0 * self.df)))

    @property
    def spread(self) -> float:
        """Variance of the residuals beside the noise's; at least 1."""
        return max(1.0, float(np.min(self._best / self.df)))

    @property
    def penalty(self) -> Array:
        """What laws of more parameters pay for them as in Akaike's criterion, as a deviance, shape (m,)."""
        return np.asarray(2.0 * self.spread * (self.df.max() - self.df), float)

    @property
    def least(self) -> float:
        """The deviance that the best change leaves, free or into the other regime, with the penalty."""
        return float(np.min(self._best + self.penalty))

    @property
    def _best(self) -> Array:
        """The least deviance at each lambda, shape (m,)."""
        return np.array([min(fit.deviance for fit in fits.values()) for fits in self.fits])

    def log_ratio(self, excess: Array) -> Array:
        """Twice the log likelihood ratio of deviances that differ so; the residuals tell the noise."""
        df = int(self.df.max())
        return df * np.log1p(np.maximum(excess, 0.0) / (df * self.spread))


def fit_changes(
    joint: int,
    direction: str,
    rows: pd.DataFrame,
    machine: Machine,
    response: Array,
    effect: Array,
    scale: Array,
    course: Array,
) -> Fingerprint:
    """Fit every change to the traverses of one joint and direction.

    Parameters
    ----------
    rows : DataFrame
        n traverses.
    response : array, shape (n,)
        log(steps).
    effect : array, shape (n,)
        The part of it that is the finding's, as the diagnosis fitted it.
    scale : array, shape (n,)
        Standard deviation of the responses.
    course : array, shape (n,)
        How far the change is on at each traverse, 1 at most.
    """
    traverses = _Traverses(joint, direction, rows, machine, response, scale, course)
    found = traverses.fit_near(effect)
    if found.excess < LARGEST_EXCESS:
        return found
    # Of a change that takes some loads from one regime to the other, the finding's effect may be far off, and
    # with it the lambda that fits best without it.
    wide = found
    for _ in range(REFITS):
        wide, effect = traverses.fit_everywhere(effect)
    return min(found, wide, key=lambda one: one.excess)


@dataclass(frozen=True, eq=False)
class _Traverses:
    """The traverses of one joint and direction; see `fit_changes`."""

    joint: int
    direction: str
    rows: pd.DataFrame
    machine: Machine
    response: Array
    scale: Array
    course: Array

    def fit_near(self, effect: Array) -> Fingerprint:
        """Changes at the lambdas that are likely once `effect` is taken out."""
        before = self._fit_laws(NEAR, effect)
        for _ in range(REFINEMENTS):
            squares = {ratio: float(at.residual @ at.residual) for ratio, at in before.items()}
            before |= self._fit_laws(_middles_beside_best(squares), effect)
        squares = {ratio: float(at.residual @ at.residual) for ratio, at in before.items()}
        least, df = min(squares.values()), max(at.df for at in before.values())
        most = least + UNLIKELY * max(1.0, least / max(df, 1))
        fits = {
            ratio: self._fit_all(at, ratio) if squares[ratio] < most else IMPOSSIBLE
            for ratio, at in before.items()
        }
        return self._fingerprint(before, fits)

    def fit_everywhere(self, effect: Array) -> tuple[Fingerprint, Array]:
        """Changes at every lambda, and what the one that fits best does to each count, shape (n,)."""
        before: dict[float, LinearizedFit] = {}
        fits: dict[float, dict[str, ChangeFit]] = {}
        ratios: Sequence[float] = EVERYWHERE
        for _ in range(FINER):
            before |= self._fit_laws(ratios, effect)
            fits |= {ratio: self._fit_all(before[ratio], ratio) for ratio in ratios}
            ratios = _middles_beside_best({ratio: _least(own) for ratio, own in fits.items()})
        ratio = min(fits, key=lambda one: _least(fits[one]))
        name = min(SINGLE, key=lambda one: fits[ratio][one].deviance)
        best = _effects(before[ratio], ratio).by(name, fits[ratio][name].size, self.course)
        return self._fingerprint(before, fits), best

    def _fit_laws(self, ratios: Iterable[float], effect: Array) -> dict[float, LinearizedFit]:
        """The law at each lambda, without an effect."""
        fits: dict[float, LinearizedFit] = {}
        for laws in laws_by_width(self.joint, self.rows, self.machine, ratios):
            fits |= _linearize(laws, self.rows, self.response - effect, self.scale)
        return fits

    def _fit_all(self, at: LinearizedFit, ratio: float) -> dict[str, ChangeFit]:
        """Every change at one lambda."""
        changes = _effects(at, ratio)
        target = at.project(at.whiten(self.response - changes.unchanged))
        fits = {}
        for name in (*SINGLE, FREE):

            def projected(size: Array, name: str = name) -> Array:
                return at.project(at.whiten(changes.by(name, size, self.course)))

            fits[name] = _fit_size(projected, target, 2 if name == FREE else 1)
        return fits

    def _fingerprint(
        self, before: Mapping[float, LinearizedFit], fits: Mapping[float, dict[str, ChangeFit]]
    ) -> Fingerprint:
        ratios = sorted(fits)
        df = np.array([max(before[ratio].df - 2, 1) for ratio in ratios])
        own = tuple(fits[ratio] for ratio in ratios)
        return Fingerprint(self.joint, self.direction, np.array(ratios), own, df)


def _effects(at: LinearizedFit, ratio: float) -> StageEffects:
    """Of changes of the law that was fitted at one lambda."""
    (part,) = at.parts
    return StageEffects(part.law, at.rows, part.values, ratio)


def _least(fits: Mapping[str, ChangeFit]) -> float:
    """The deviance that the best of the single changes leaves."""
    return min(fits[name].deviance for name in SINGLE)


def _linearize(
    laws: Sequence[Physical], rows: pd.DataFrame, response: Array, scale: Array
) -> dict[float, LinearizedFit]:
    """By lambda; the laws have the same parameters."""
    ratios = [law.ratios[0] for law in laws]
    problem = replace(single_problem(laws[0], rows, DEFAULT_OPTIONS), y=response)
    starts = np.concatenate([start_at(problem, ratio) for ratio in ratios])
    weight = np.tile(1.0 / scale**2, len(laws))
    minimum = stack_ratios(problem, laws[0], np.array(ratios)).minimize(weight, starts, MAX_ITERATIONS)
    block, values = problem.groups.of_row, minimum.values.reshape(len(laws), *problem.start.shape)
    parts = [
        LawBlock(law, np.arange(len(rows)), block, own[block]) for law, own in zip(laws, values, strict=True)
    ]
    return {
        ratio: linearize_fit(rows, [part], response, scale) for ratio, part in zip(ratios, parts, strict=True)
    }


def _middles_beside_best(deviance: Mapping[float, float]) -> list[float]:
    """Middles of the intervals beside the lambda that fits best."""
    ratios = sorted(deviance)
    best = int(np.argmin([deviance[ratio] for ratio in ratios]))
    return [(ratios[k] + ratios[k + 1]) / 2 for k in (best - 1, best) if 0 <= k < len(ratios) - 2]


def _fit_size(effect: Callable[[Array], Array], target: Array, k: int) -> ChangeFit:
    """Gauss-Newton in the sizes of a change; a step after which the joint stalls is halved."""
    size, now = np.zeros(k), np.zeros(len(target))
    slopes = np.stack([effect(DIFFERENCE * unit) / DIFFERENCE for unit in np.eye(k)], axis=-1)
    information = slopes.T @ slopes
    if not np.all(np.isfinite(information)) or information.max() < TINY:
        return ChangeFit(float(target @ target), size, np.zeros((k, k)))
    for _ in range(STEPS):
        step = np.linalg.lstsq(slopes, target - now, rcond=SINGULAR)[0]
        proposed = np.clip(size + step, -LARGEST, LARGEST)
        new = effect(proposed)
        while not np.all(np.isfinite(new)):
            proposed = (size + proposed) / 2
            new = effect(proposed)
        if np.sum((target - new) ** 2) > np.sum((target - now) ** 2):
            break
        done = bool(np.abs(proposed - size).max() < DIFFERENCE)
        size, now = proposed, new
        if done:
            break
        moved = [(effect(size + DIFFERENCE * unit) - now) / DIFFERENCE for unit in np.eye(k)]
        if not np.all(np.isfinite(moved)):
            break
        slopes = np.stack(moved, axis=-1)
        information = slopes.T @ slopes
    return ChangeFit(float(np.sum((target - now) ** 2)), size, information)


class StageEffects:
    """What changes of the stage do to log(steps) under a physical law at given parameters.

    Parameters
    ----------
    law : Physical
    rows : DataFrame
        n traverses.
    values : array, shape (n, p)
    ratio : float
        lambda before the change.
    """

    def __init__(self, law: Physical, rows: pd.DataFrame, values: Array, ratio: float) -> None:
        self.values, self.ratio = values, ratio
        self.count = law.ratio_counter(rows)
        self.shares = [k for k, parameter in enumerate(law.parameters) if parameter.name.startswith("r")]
        self.unchanged = np.log(self.count(values, np.full(len(rows), ratio))[0])

    def by(self, change: str, size: Array, course: Array) -> Array:
        """Change of log(steps), shape (n,); NaN where the joint stalls.

        Parameters
        ----------
        change : str
            One of `SINGLE`, or `FREE`.
        size : array, shape (1,) or (2,)
            See `ChangeFit`.
        course : array, shape (n,)
        """
        own, other = (np.log1p(np.expm1(each) * course) for each in (size[0], size[-1]))
        # Logarithms of what a_f T1^2, r and lambda are multiplied by.
        unit, share, ratio = (
            (own, other, 0.0 * own) if change == FREE else (power * own for power in POWERS[change])
        )
        now, values = self.ratio * np.exp(ratio), self.values.copy()
        values[:, 0] *= np.exp(unit) * np.minimum(now, 1.0) / min(self.ratio, 1.0)
        values[:, self.shares] *= np.exp(share)[:, None]
        with np.errstate(invalid="ignore"):
            return np.log(self.count(values, now)[0]) - self.unchanged
