"""The core: units compared between levels, within blocks, on arrays.

The same algebra serves readings of one configuration (blocks: none) and cell means of sessions (blocks:
the sessions). Values may be stacked, ``(..., n)``, so that ten thousand logs cost little more than one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.projection import contrasts, indicator, orthonormal, unit_columns

Array = npt.NDArray[np.float64]
Codes = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Comparison:
    """Which of n units has which of k levels, in which of b blocks.

    Attributes
    ----------
    level, block : array of int, shape (n,)
        Counted from 0, every number in use.
    nuisance : array, shape (n, b)
        Orthonormal basis of the blocks' means (of the general mean where there is one block).
    effect : array, shape (n, k - 1)
        Orthonormal basis of what the levels add to that; fewer columns where not all levels are
        connected through blocks.
    """

    level: Codes
    block: Codes
    nuisance: Array
    effect: Array

    @property
    def levels(self) -> int:
        """How many levels there are."""
        return int(self.level.max()) + 1

    @property
    def freedom(self) -> tuple[int, int]:
        """Degrees of freedom of the levels and of the error."""
        between = self.effect.shape[1]
        return between, len(self.level) - self.nuisance.shape[1] - between

    @property
    def connected(self) -> bool:
        """Whether blocks tie all levels together, so that each can be compared with each."""
        return self.effect.shape[1] == self.levels - 1


@dataclass(frozen=True)
class SumsOfSquares:
    """Sums of squares of stacked values.

    Attributes
    ----------
    blocks, between, within : array, shape (...)
        They add up to the total about the general mean.
    freedom : tuple of (int, int, int)
    """

    blocks: Array
    between: Array
    within: Array
    freedom: tuple[int, int, int]

    @property
    def total(self) -> Array:
        """Sum of squares about the general mean."""
        return self.blocks + self.between + self.within

    @property
    def variance(self) -> Array:
        """Mean square of the error."""
        return self.within / self.freedom[2]

    @property
    def statistic(self) -> Array:
        """F: mean square of the levels over that of the error."""
        return self.between / self.freedom[1] / self.variance

    @property
    def p_value(self) -> Array:
        """Probability of an F at least as large where the levels do not differ."""
        from scipy.special import fdtrc

        return fdtrc(*self.freedom[1:], self.statistic)

    @property
    def omega_squared(self) -> Array:
        """Share of variance that the levels account for (Hays), blocks left out; at least 0."""
        excess = self.freedom[1] * (self.statistic - 1.0)
        return np.maximum(0.0, excess / (excess + sum(self.freedom) + 1))


def compare(level: npt.ArrayLike, block: npt.ArrayLike | None = None) -> Comparison:
    """Prepare a comparison.

    Parameters
    ----------
    level, block : array_like, shape (n,)
        Labels of any kind.
    """
    levels = np.unique(np.asarray(level), return_inverse=True)[1]
    blocks = np.zeros_like(levels) if block is None else np.unique(np.asarray(block), return_inverse=True)[1]
    nuisance = unit_columns(blocks)
    one_block = nuisance.shape[1] == 1
    effect = contrasts(levels) if one_block else orthonormal(indicator(levels), nuisance)
    return Comparison(levels, blocks, nuisance, effect)


def sums_of_squares(values: npt.ArrayLike, comparison: Comparison) -> SumsOfSquares:
    """Sums of squares of blocks, of levels within them and of the rest.

    Values are shifted by one of them first. The difference of two nearby doubles is exact (Sterbenz), so
    that no digit is lost to a large common part but those that the doubles never had.

    Parameters
    ----------
    values : array_like, shape (..., n)
    comparison : Comparison

    Examples
    --------
    >>> two_days = compare(["Mon", "Mon", "Mon", "Tue", "Tue", "Tue"])
    >>> found = sums_of_squares([1e12 + 1, 1e12 + 2, 1e12 + 3, 1e12 + 4, 1e12 + 5, 1e12 + 6], two_days)
    >>> round(float(found.statistic), 12), round(float(found.p_value), 6)
    (13.5, 0.021312)
    """
    shifted = shift(values)
    centred = shifted - shifted.mean(axis=-1, keepdims=True)
    by_block = centred @ comparison.nuisance
    rest = centred - by_block @ comparison.nuisance.T
    by_level = rest @ comparison.effect
    rest = rest - by_level @ comparison.effect.T
    # What rounding left of the first two parts in the rest is taken out once more.
    rest = rest - (rest @ comparison.nuisance) @ comparison.nuisance.T
    rest = rest - (rest @ comparison.effect) @ comparison.effect.T
    between_blocks, between, within = (np.sum(part**2, axis=-1) for part in (by_block, by_level, rest))
    freedom = (comparison.nuisance.shape[1] - 1, *comparison.freedom)
    return SumsOfSquares(between_blocks, between, within, freedom)


def level_means(values: npt.ArrayLike, comparison: Comparison) -> tuple[Array, Array]:
    """Mean of each level, adjusted for the blocks, and the covariance factor of their differences.

    Returns
    -------
    means : array, shape (..., k)
    factor : array, shape (k, k)
        Times the error's variance: covariance of the means, but for what all of them share.
    """
    values = np.asarray(values, float)
    shifted = shift(values)
    origin = (values - shifted)[..., :1]
    within = indicator(comparison.level)
    within = within - comparison.nuisance @ (comparison.nuisance.T @ within)
    factor = np.linalg.pinv(within.T @ within, rcond=1e-10, hermitian=True)
    adjusted = (shifted @ within) @ factor
    share = np.bincount(comparison.level) / len(comparison.level)
    middle = shifted.mean(axis=-1, keepdims=True) - (adjusted @ share)[..., None]
    return origin + middle + adjusted, factor


def shift(values: npt.ArrayLike) -> Array:
    """Values less their median, exactly where they are near each other."""
    values = np.asarray(values, float)
    middle = values.shape[-1] // 2
    return values - np.partition(values, middle, axis=-1)[..., middle : middle + 1]
