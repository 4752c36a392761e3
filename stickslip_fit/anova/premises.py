"""Checks of an F test's assumptions: normality, equal variances, no drift, interleaved levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.comparison import Codes, compare, sums_of_squares
from stickslip_fit.anova.scatter import (
    DRAWS,
    MOST_NUMBERS,
    brown_forsythe,
    monte_carlo_p,
    residual,
    shapiro_francia,
)

Array = npt.NDArray[np.float64]

LEVEL = 0.01  # a log has dozens of checks; at 0.05 one in twenty would be doubted for nothing
FEWEST_RESIDUALS = 6  # degrees of freedom below which nothing can be told of a shape or a trend
FEWEST_IN_A_CELL = 3  # two readings are always equally far from their middle
APART = 0.9  # share of the variance of time that levels explain where they were read one after another


@dataclass(frozen=True)
class AssumptionCheck:
    """Outcome of one check.

    Attributes
    ----------
    name : str
    verdict : {"holds", "doubtful", "cannot tell"}
    message : str
        In plain words.
    p_value : float or None
        Of the check, where it is a test.
    """

    name: str
    verdict: str
    message: str
    p_value: float | None = None


def check_assumptions(values: Array, time: Array, level: Codes, block: Codes) -> tuple[AssumptionCheck, ...]:
    """Check readings against the assumptions of an F test.

    Parameters
    ----------
    values : array, shape (n,)
        Step sizes.
    time : array, shape (n,)
        When each was read, seconds.
    level, block : array of int, shape (n,)
        What is compared, and the session of each reading.
    """
    cell = np.unique(np.stack([block, level]), axis=1, return_inverse=True)[1].ravel()
    return (
        _normal(values, cell),
        _equal(values, cell),
        _no_trend(values, time, cell),
        _interleaved(time, level, block),
    )


def _normal(values: Array, cell: Codes) -> AssumptionCheck:
    name = "normal scatter"
    if _repeats(cell) < FEWEST_RESIDUALS or not np.any(residual(values, cell)):
        return _few(name, "too few readings to tell whether they scatter normally")
    doubt = "the readings do not scatter normally: trust the permutation p more than the F test's"
    p_value = monte_carlo_p(shapiro_francia, values, cell)
    return _tested(name, p_value, "the readings scatter as normal ones would", doubt)


def _equal(values: Array, cell: Codes) -> AssumptionCheck:
    name = "equal scatter"
    sizes = np.bincount(cell)
    used = sizes[cell] >= FEWEST_IN_A_CELL
    readings, cells = values[used], np.unique(cell[used], return_inverse=True)[1]
    if cells.max(initial=0) < 1 or not np.any(residual(readings, cells)):
        return _few(name, "too few readings at one level to tell whether all levels scatter alike")
    doubt = "levels do not scatter alike: where their numbers of readings differ, the F test's p may be off"
    return _tested(name, monte_carlo_p(brown_forsythe, readings, cells), "all levels scatter alike", doubt)


def _no_trend(values: Array, time: Array, cell: Codes) -> AssumptionCheck:
    """Readings against the time within their session, reshuffled within each cell."""
    name = "drift within a session"
    left = residual(values, cell)
    observed = abs(float(left @ time))
    if _repeats(cell) < FEWEST_RESIDUALS or observed == 0.0:
        return _few(name, "too few repeated readings to tell whether they drift within a session")
    home = np.argsort(cell, kind="stable")
    count = max(199, min(DRAWS, MOST_NUMBERS // len(cell)))
    keys = np.random.default_rng(0).random((count, len(cell))) + cell[home]
    shuffled = left[home][np.argsort(keys, axis=1)] @ time[home]
    p_value = (1 + np.sum(np.abs(shuffled) >= observed * (1 - 1e-9))) / (1 + count)
    doubt = "repeated readings drift within their session: what looks like an effect may be the hour"
    return _tested(name, float(p_value), "repeated readings show no drift within a session", doubt)


def _interleaved(time: Array, level: Codes, block: Codes) -> AssumptionCheck:
    """Whether levels took turns within sessions, or were read one after another in all of them."""
    name = "levels in turn"
    turns = sums_of_squares(time, compare(level, block))
    if turns.freedom[1] == 0 or turns.between + turns.within <= 0:
        return AssumptionCheck(name, "holds", "each level is a session of its own")
    if turns.between < APART * (turns.between + turns.within):
        return AssumptionCheck(
            name, "holds", "levels took turns, so that a drift would not pass for an effect"
        )
    doubt = "levels were read one after another, so that a drift in the session could pass for an effect"
    return AssumptionCheck(name, "doubtful", doubt)


def _repeats(cell: Codes) -> int:
    return len(cell) - len(np.unique(cell))


def _few(name: str, message: str) -> AssumptionCheck:
    return AssumptionCheck(name, "cannot tell", message)


def _tested(name: str, p_value: float, fine: str, doubt: str) -> AssumptionCheck:
    verdict, message = ("holds", fine) if p_value >= LEVEL else ("doubtful", doubt)
    return AssumptionCheck(name, verdict, message, p_value)
