"""Which change of the stage stands behind changes of an actuator, from step sizes and load coefficients.

To first order in the load over friction, a quantity of the stage times e^s multiplies the step without load
by e^(u s) and the response to load by e^(v s); u and v depend on the regime (`laws.physical`,
`FINGERPRINTS`). Each of them is fitted to the differences of all joints and directions, one size s for all.
Errors are taken as normal and as wide as Student's t of their degrees of freedom; s is normal about 0
beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy.special import chdtrc, logsumexp

from stickslip_fit._typing import Array
from stickslip_fit.changes.detection import Change, Changes
from stickslip_fit.diagnosis.stage_change import (
    CREDIBLE,
    PRIOR_SD,
    QUANTITIES,
    StageChange,
    choose_credible,
    order_changes,
)
from stickslip_fit.units import Interval

REGIMES = ("friction-limited", "velocity-limited")
FINGERPRINTS: Mapping[tuple[str, str], tuple[float, float]] = {
    ("friction", REGIMES[0]): (1.0, 0.0),
    ("mass", REGIMES[0]): (-1.0, 0.0),
    ("ramp time", REGIMES[0]): (2.0, 2.0),
    ("voltage", REGIMES[0]): (0.0, 0.0),
    ("friction", REGIMES[1]): (0.0, -2.0),
    ("mass", REGIMES[1]): (0.0, 2.0),
    ("ramp time", REGIMES[1]): (0.0, -2.0),
    ("voltage", REGIMES[1]): (1.0, 2.0),
}
"""u and v by quantity and regime."""
MIN_DF = 2.5  # of a difference, with fewer of which its error is too uncertain
MAX_ERROR = 0.3  # of a logarithm, beyond which it says nothing


@dataclass(frozen=True)
class StageDifference:
    """Which change of the stage the differences of two logs stand for.

    Attributes
    ----------
    changes : tuple of StageChange
        Likeliest first; relative sizes, new against old.
    regime : str
        Where it has 95 %, else empty.
    p_value : float
        That the likeliest describes all differences.
    """

    changes: tuple[StageChange, ...]
    regime: str
    p_value: float

    @property
    def credible(self) -> tuple[StageChange, ...]:
        """The smallest set that holds the change with 95 %; empty where none describes the differences."""
        return choose_credible(self.changes, self.p_value)


def read_stage_difference(changes: Changes) -> StageDifference | None:
    """Read changes of published laws as one change of the stage.

    Returns
    -------
    StageDifference or None
        None where nothing changed, for other laws, and where the scatter from day to day is hardly known.
    """
    if not changes.significant or not changes.machine.has_published_geometry:
        return None
    values, errors, responds = [], [], []
    for change in changes.changes:
        value, error = _log_ratio(change)
        if change.role and error < MAX_ERROR and change.difference.df > MIN_DF:
            values.append(value)
            errors.append(error)
            responds.append(change.role == "response")
    if not any(responds) or all(responds):
        return None
    return _compare(np.array(values), np.array(errors), np.array(responds))


def _log_ratio(change: Change) -> tuple[float, float]:
    """Logarithm of new over old, and its error, as wide as Student's t; NaN where the sign differs."""
    difference = change.difference
    if not difference.old * difference.new > 0:
        return np.nan, np.nan
    widened = difference.standard_error * np.sqrt(difference.df / max(difference.df - 2.0, 0.5))
    return log(difference.new / difference.old), float(widened / abs(difference.old))


def _compare(values: Array, errors: Array, responds: Array) -> StageDifference:
    target, prior = values / errors, 1.0 / PRIOR_SD**2
    log_evidence, fits = {}, {}
    for key, (unloaded, response) in FINGERPRINTS.items():
        slope = np.where(responds, response, unloaded) / errors
        information = float(slope @ slope)
        size = float(slope @ target) / (information + prior)
        square = float(target @ target) - size * float(slope @ target)
        log_evidence[key] = -0.5 * (square + np.log1p(information / prior))
        sd = (information + prior) ** -0.5
        fits[key] = size, sd, float(np.sum((target - slope * size) ** 2))
    total = logsumexp(list(log_evidence.values()))
    share = {key: float(np.exp(value - total)) for key, value in log_evidence.items()}
    changes = order_changes(_change(quantity, share, fits) for quantity in QUANTITIES)
    best = max(share, key=lambda key: share[key])
    regimes = {
        way: sum(p for (_, of), p in share.items() if of == way) for way in dict.fromkeys(w for _, w in share)
    }
    likely = [way for way, probability in regimes.items() if probability > CREDIBLE]
    p_value = float(chdtrc(len(values) - 1, fits[best][2]))
    return StageDifference(changes, likely[0] if likely else "", p_value)


def _change(
    quantity: str, share: Mapping[tuple[str, str], float], fits: Mapping[tuple[str, str], Sequence[float]]
) -> StageChange:
    """A quantity's probability over both regimes, and its size in the likelier one."""
    keys = [key for key in share if key[0] == quantity]
    size, sd, _ = fits[max(keys, key=lambda key: share[key])]
    interval = Interval(*np.expm1([size, size - 1.96 * sd, size + 1.96 * sd]).tolist())
    return StageChange(quantity, sum(share[key] for key in keys), interval)
