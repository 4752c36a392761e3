"""Readings made up to match a printed p-value and printed means, and what these imply of a drive.

Who prints the p-value of an F test, the means and the number of readings leaves one thing to know: how much
the readings scattered. Readings with that scatter are a reconstruction; nobody measured them, and every
question made of them says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.anova import FactorTestDesign
from stickslip_fit.anova.designs import WITHIN_SESSION_ERROR
from stickslip_fit.errors import InputError

Array = npt.NDArray[np.float64]

LABEL = "RECONSTRUCTED from a printed p-value and means; not measured"
FACTORS = {"day": "session", "direction": "direction", "normal-force": "orientation"}


@dataclass(frozen=True)
class Implied:
    """What a p-value and means imply.

    Attributes
    ----------
    repeatability : float
        Standard deviation of a reading over the mean of all.
    change : float
        Largest less smallest mean over the mean of all.
    """

    repeatability: float
    change: float


def reconstruct(
    analysis: str,
    means: Mapping[str, float],
    p_value: float,
    *,
    readings: int = 3,
    joint: int = 3,
    direction: str | None = None,
) -> FactorTestDesign:
    """A question whose answer has this p-value and these means.

    Parameters
    ----------
    analysis : {"day", "direction", "normal-force"}
    means : mapping of str to float
        Mean step size of each level, SI.
    p_value : float
        Of the F test.
    readings : int, optional
        At each level.
    joint : {1, 2, 3}, optional
    direction : str, optional
        In which the joint was driven, unless directions are compared.

    Raises
    ------
    InputError
        If no readings can have that p-value and those means.

    Examples
    --------
    >>> from stickslip_fit.anova.factor_test import run_factor_test
    >>> question = reconstruct("day", {"first": 976e-9, "second": 951e-9}, 0.0002)
    >>> round(run_factor_test(question).p_value, 12)
    0.0002
    """
    spread = implied_spread(list(means.values()), p_value, readings)
    pattern = np.arange(readings) - (readings - 1) / 2
    pattern = pattern / np.std(pattern, ddof=1) * spread
    level = np.repeat(list(means), readings)
    rows = pd.DataFrame(
        {
            "joint": joint,
            "level": level,
            "session": level if analysis == "day" else "",
            "direction": level if analysis == "direction" else direction,
            "step_size": np.add.outer(list(means.values()), pattern).ravel(),
            "session_seconds": np.tile(np.arange(readings, dtype=float), len(means)),
            "rounding": 0.0,
        }
    )
    return FactorTestDesign(
        analysis, joint, direction, None, LABEL, FACTORS[analysis], WITHIN_SESSION_ERROR, rows
    )


def implied_spread(means: npt.ArrayLike, p_value: float, readings: int) -> float:
    """Standard deviation of readings whose means, `readings` at each level, differ with this p-value.

    Examples
    --------
    >>> round(implied_spread([0.0, 1.0], 0.0213116, 3) * 3, 4)  # as 1, 2, 3 against 4, 5, 6
    1.0
    """
    between = readings * float(np.var(np.asarray(means, float), ddof=1))
    return float(np.sqrt(between / _statistic(np.size(means), p_value, readings)))


def implied_difference(spread: float, p_value: float, readings: int) -> float:
    """Difference of two means that has this p-value where `readings` at each scatter by `spread`."""
    return spread * float(np.sqrt(2.0 * _statistic(2, p_value, readings) / readings))


def implied(means: npt.ArrayLike, p_value: float, readings: int = 3) -> Implied:
    """The repeatability behind a printed p-value, and the change that it was of."""
    means = np.asarray(means, float)
    middle = float(means.mean())
    return Implied(implied_spread(means, p_value, readings) / middle, float(np.ptp(means)) / middle)


def _statistic(levels: int, p_value: float, readings: int) -> float:
    from scipy.stats import f

    if not 0.0 < p_value < 1.0 or levels < 2 or readings < 2:
        raise InputError(
            f"p = {p_value}, {levels} levels of {readings} readings: give 0 < p < 1 and two of each at least"
        )
    return float(f.isf(p_value, levels - 1, levels * (readings - 1)))
