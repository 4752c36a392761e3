"""Which change of the stage stands behind changes of an actuator, from step sizes and responses to load.

Under the physical law (`laws.physical`) a quantity of the stage times e^s changes the step size without load
and the response to load of each joint and direction in a way of its own, which depends on lambda. The
response as a share of the step size, in the old log, gives r for each lambda; what follows from there is
exact. Where the logs leave lambda open it is integrated out, as in `diagnosis.stage_change`. Errors are
taken as normal and as wide as Student's t of their degrees of freedom; s is normal about 0 beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from scipy.special import chdtrc

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.changes.detection import RESPONSE, SHARE, UNLOADED, Change, Changes
from stickslip_fit.diagnosis.stage_change import (
    SIZES,
    StageChange,
    choose_credible,
    find_regime,
    friction_limited,
    weigh_changes,
)
from stickslip_fit.estimation.drive_ratio import COARSE, prior_shares
from stickslip_fit.laws.physical import FRICTION_LIMITED, MAX_SHARE, POWERS, Physical
from stickslip_fit.step import relative_step

RATIOS = np.array([*COARSE, FRICTION_LIMITED])
SHARES = np.linspace(0.0, MAX_SHARE, 901)
IMPOSSIBLE = 1e6  # sum of squares at a lambda that is ruled out, or at which a joint would stall
SMALL = 1e-3
MIN_DF = 2.5  # of a difference, with fewer of which its error is too uncertain
MAX_ERROR = 0.3  # of a logarithm, beyond which it says nothing


@dataclass(frozen=True)
class StageDifference:
    """Which change of the stage the differences of two logs stand for.

    Attributes
    ----------
    changes : tuple of StageChange
        Of the likeliest trace first; relative sizes, new against old.
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
    """Read changes of published or physical laws as one change of the stage.

    Returns
    -------
    StageDifference or None
        None where nothing changed, for other laws, and where the scatter from day to day is hardly known.
    """
    if not changes.significant or not changes.machine.has_published_geometry:
        return None
    keys = dict.fromkeys((one.joint, one.direction) for one in changes.changes)
    drives = [drive for joint, direction in keys if (drive := _drive(changes, joint, direction)) is not None]
    responds = np.concatenate([np.zeros(0, bool), *(drive.responds for drive in drives)])
    if not responds.any() or responds.all():
        return None
    terms = {quantity: [drive.log_likelihood(quantity) for drive in drives] for quantity in POWERS}
    found, log_posterior = weigh_changes(terms)
    limited = friction_limited([RATIOS] * len(drives), terms, log_posterior)
    best = found[0].trace
    at = int(np.argmax(log_posterior[best]))
    excess = sum(float(drive.squares(best)[:, at].min()) for drive in drives)
    return StageDifference(found, find_regime(limited), float(chdtrc(len(responds) - 1, excess)))


@dataclass(frozen=True, eq=False)
class _DriveChange:
    """A joint and direction.

    Attributes
    ----------
    values, errors : array, shape (n,)
        Logarithms of new over old, and their errors.
    responds : array of bool, shape (n,)
        Of the response to load, else of the step size without load.
    is_physical : bool
        Of parameters of a physical law: the step size is that without load, the response a share of it. Of a
        published law both are those of a line through steps under several loads.
    relative : float
        Response to full load as a share of the step size, in the old log.
    loads : array, shape (k,)
        Against the motion, as shares of the full load.
    is_open : array of bool, shape (m,)
        Which of `RATIOS` the logs leave open.
    """

    values: Array
    errors: Array
    responds: BoolArray
    is_physical: bool
    relative: float
    loads: Array
    is_open: BoolArray

    def squares(self, quantity: str) -> Array:
        """Sum of squares, in units of the errors, at each lambda and size, shape (m, sizes)."""
        unloaded, response = self._predict(quantity)
        square = np.zeros(unloaded.shape)
        for value, error, responds in zip(self.values, self.errors, self.responds, strict=True):
            square += ((value - (response if responds else unloaded)) / error) ** 2
        return np.where(np.isfinite(square) & self.is_open[:, None], square, IMPOSSIBLE)

    def log_likelihood(self, quantity: str) -> Array:
        """With the prior of lambda, shape (m, sizes)."""
        return np.log(prior_shares(RATIOS))[:, None] - self.squares(quantity) / 2

    def _predict(self, quantity: str) -> tuple[Array, Array]:
        """Logarithms of what a change of each size makes of step size and response, (m, sizes) each.

        NaN at a lambda at which the response was never so large, and where the joint stalls.
        """
        unit, by_share, by_ratio = (np.exp(power * SIZES) for power in POWERS[quantity])
        with np.errstate(invalid="ignore", divide="ignore"):
            possible = [_Line(np.full(len(SHARES), ratio), SHARES, self.loads).fall for ratio in RATIOS]
            share = np.array([np.interp(self.relative, fall, SHARES, right=np.nan) for fall in possible])
            before = _Line(RATIOS[:, None], share[:, None], self.loads)
            after = _Line(RATIOS[:, None] * by_ratio, share[:, None] * by_share, self.loads)
            response = np.log(after.fall / before.fall)
            if self.is_physical:
                return np.log(unit * after.unloaded / before.unloaded), response
            middle = np.log(unit * after.middle / before.middle)
            return middle, middle + response


class _Line:
    """A line through steps over a_f T1^2 under some loads against the motion.

    Parameters
    ----------
    ratio, share : array
        Of one shape.
    loads : array, shape (k,)
        Shares of the full load.

    Attributes
    ----------
    unloaded, middle : array
        The step without load, and what the line says of it.
    fall : array
        What the line loses under full load, as a share of `middle`.
    """

    def __init__(self, ratio: Array, share: Array, loads: Array) -> None:
        step = relative_step(ratio[..., None], share[..., None] * loads).step
        self.unloaded = relative_step(ratio, 0.0 * share).step
        fit = np.linalg.pinv(np.column_stack([np.ones(len(loads)), -loads]))
        self.middle = step @ fit[0]
        self.fall = (step @ fit[1]) / self.middle


def _drive(changes: Changes, joint: int, direction: str) -> _DriveChange | None:
    """None where there is too little to be compared."""
    law = changes.laws[joint]
    own = [one for one in changes.changes if (one.joint, one.direction) == (joint, direction) and one.role]
    first = {one.role: one.difference.old for one in reversed(own)}
    if UNLOADED not in first or len(first) < 2:
        return None
    loads = changes.loads[joint, direction]
    if isinstance(law, Physical):
        ratio, *others = law.ratios[int(direction == "-")], *law.plausible[int(direction == "-")]
        relative = _fall(ratio, first[SHARE], loads)
        is_open = (min(ratio, *others, ratio) <= RATIOS) & (max(ratio, *others, ratio) >= RATIOS)
        is_open[np.argmin(np.abs(RATIOS - ratio))] = True
        logs = [_log_response(one, ratio, loads) if one.role == SHARE else _log_ratio(one) for one in own]
    else:
        relative, is_open = abs(first[RESPONSE] / first[UNLOADED]), np.ones(len(RATIOS), bool)
        logs = [_log_ratio(one) for one in own]
    used = [k for k, one in enumerate(own) if logs[k][1] < MAX_ERROR and one.difference.df > MIN_DF]
    if not used:
        return None
    values, errors = np.array(logs)[used].T
    responds = np.array([own[k].role != UNLOADED for k in used])
    return _DriveChange(values, errors, responds, isinstance(law, Physical), relative, loads, is_open)


def _fall(ratio: float, share: float, loads: Array) -> float:
    """The response of a lambda and an r."""
    return float(_Line(np.array(ratio), np.array(abs(share)), loads).fall)


def _log_response(change: Change, ratio: float, loads: Array) -> tuple[float, float]:
    """As `_log_ratio` of r, of the response that it makes."""
    _, error = _log_ratio(change)
    old, new = change.difference.old, change.difference.new
    before, beside, after = (_fall(ratio, share, loads) for share in (old, old * (1 + SMALL), new))
    return log(after / before), error * log(beside / before) / log(1 + SMALL)


def _log_ratio(change: Change) -> tuple[float, float]:
    """Logarithm of new over old, and its error, as wide as Student's t; NaN where the sign differs."""
    difference = change.difference
    if not difference.old * difference.new > 0:
        return np.nan, np.nan
    widened = difference.standard_error * np.sqrt(difference.df / max(difference.df - 2.0, 0.5))
    return log(difference.new / difference.old), float(widened / abs(difference.old))
