"""Intervals of 95 % from a covariance."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import t as student_t

from stickslip_fit.fit.repeatability import Repeatability

Array = npt.NDArray[np.float64]
COVERAGE = 0.95


def quadratic_interval(
    values: Array, covariance: Array, groups: pd.DataFrame, repeatability: dict[str, Repeatability]
) -> Array:
    """Estimate plus and minus Student's t times its standard error.

    Parameters
    ----------
    values : array, shape (g, p)
    covariance : array, shape (g, p, p)
    groups : DataFrame
        Its column direction says whose degrees of freedom count.
    repeatability : dict of str to Repeatability

    Returns
    -------
    array, shape (g, p, 2)
        NaN where there is no error bar.
    """
    half = reaches(groups, repeatability)[:, None] * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return np.stack([values - half, values + half], axis=-1)


def reaches(groups: pd.DataFrame, repeatability: dict[str, Repeatability]) -> Array:
    """Half-width of each group's intervals in standard errors, shape (g,)."""
    return np.array([quantile(repeatability[way].freedom) for way in groups["direction"]])


def quantile(freedom: int) -> float:
    """Half-width of a 95 % interval in standard errors.

    Examples
    --------
    >>> round(quantile(4), 3)
    2.776
    """
    return float(student_t.ppf(0.5 + COVERAGE / 2, freedom)) if freedom > 0 else np.nan
