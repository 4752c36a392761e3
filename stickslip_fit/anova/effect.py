"""How large an effect is: the two levels furthest apart, with an interval that knows they were picked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.comparison import Comparison, level_means, sums_of_squares

Array = npt.NDArray[np.float64]

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Effect:
    """The largest difference between levels.

    Attributes
    ----------
    means : array, shape (k,)
        Of each level, adjusted for blocks.
    half_width : array, shape (k,)
        Of each mean's 95 % interval, for the error alone.
    largest, smallest : int
        The two levels.
    difference, low, high : float
        Largest less smallest mean, with the 95 % interval of Tukey and Kramer: it holds for all pairs
        at once, so also for the pair that stood out. With two levels it is Student's.
    """

    means: Array
    half_width: Array
    largest: int
    smallest: int
    difference: float
    low: float
    high: float


def effect_of(values: Array, comparison: Comparison) -> Effect:
    """The effect of the levels of one set of values, shape (n,).

    Examples
    --------
    >>> from stickslip_fit.anova.comparison import compare
    >>> found = effect_of(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), compare(list("aaabbb")))
    >>> round(found.difference, 3), round(found.low, 3), round(found.high, 3)
    (3.0, 0.733, 5.267)
    """
    from scipy.stats import t

    means, factor = level_means(values, comparison)
    squares = sums_of_squares(values, comparison)
    freedom = comparison.freedom[1]
    spread = float(np.sqrt(squares.variance))
    largest, smallest = int(np.argmax(means)), int(np.argmin(means))
    difference = float(means[largest] - means[smallest])
    error = spread * np.sqrt(difference_factor(factor)[largest, smallest])
    reach = _studentized(comparison.levels, freedom) * error
    count = np.bincount(comparison.level)
    half_width = float(t.isf((1 - CONFIDENCE) / 2, freedom)) * spread / np.sqrt(count)
    return Effect(
        means, half_width, largest, smallest, difference, float(difference - reach), float(difference + reach)
    )


def difference_factor(factor: Array) -> Array:
    """Times the error's variance: that of the difference between each two means, shape (k, k)."""
    own = np.diag(factor)
    return own[:, None] + own[None, :] - 2 * factor


@cache
def _studentized(levels: int, freedom: int) -> float:
    """Quantile of the studentized range for a difference in units of its own standard error."""
    from scipy.stats import studentized_range, t

    if levels == 2:
        return float(t.isf((1 - CONFIDENCE) / 2, freedom))
    return float(studentized_range.ppf(CONFIDENCE, levels, freedom) / np.sqrt(2.0))
