"""Comparison of levels within blocks: sums of squares, largest difference, power, Holm's adjustment.

The blocks are none for single observations and the sessions for cell means. Values may be stacked,
shape (..., n), so that many logs are tested at once. The interval of the largest difference is that of
Tukey and Kramer; power is by the noncentral F distribution.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array, IntArray

SIGNIFICANCE_LEVEL, TARGET_POWER = 0.05, 0.80
RANK_TOL = 1e-9  # relative length of the residual of a column that earlier columns span


def indicator_columns(codes: npt.NDArray[np.intp]) -> Array:
    """One column for each code, 1 in its rows; codes count from 0, shape (n, k)."""
    return (codes[:, None] == np.arange(codes.max() + 1)).astype(float)


def unit_columns(codes: npt.NDArray[np.intp]) -> Array:
    """As `indicator_columns`, each column of length 1."""
    return indicator_columns(codes) / np.sqrt(np.bincount(codes))


def contrast_basis(codes: npt.NDArray[np.intp]) -> Array:
    """Orthonormal basis of the contrasts of k group means, shape (n, k - 1).

    A reflection takes the general mean to the first axis of the groups' space; the others are contrasts.
    """
    root = np.sqrt(np.bincount(codes) / len(codes))
    normal = root + np.eye(len(root))[0]
    reflection = np.eye(len(root)) - 2.0 * np.outer(normal, normal) / (normal @ normal)
    return unit_columns(codes) @ reflection[:, 1:]


def orthonormal_basis(columns: Array, beyond: Array) -> Array:
    """Basis of the columns' span, shape (n, p), orthogonal to that of `beyond`, orthonormal, shape (n, q).

    Its width is the term's degrees of freedom, whatever the coding: columns that are empty, or combine
    others, add nothing, so that an inner factor's labels may be reused in each outer level.

    Examples
    --------
    >>> day = indicator_columns(np.array([0, 0, 1, 1]))
    >>> orthonormal_basis(day, np.full((4, 1), 0.5)).shape
    (4, 1)
    """
    from scipy.linalg import qr

    length = np.sqrt(np.sum(columns**2, axis=0))
    columns = columns[:, length > 0] / length[length > 0]
    # Twice: the second projection removes the rounding of the first.
    for _ in range(2):
        columns = columns - beyond @ (beyond.T @ columns)
    if not columns.size:
        return np.zeros((len(columns), 0))
    basis, triangle, _ = qr(columns, mode="economic", pivoting=True)
    basis = basis[:, np.abs(np.diag(triangle)) > RANK_TOL]
    return basis - beyond @ (beyond.T @ basis)


def adjust_holm(p_values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """p-values adjusted over all of them by Holm's method, in the order given.

    Examples
    --------
    >>> adjust_holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    # statsmodels gives the same, but takes 0.1 s a call.
    p_values = np.asarray(p_values, float)
    order = np.argsort(p_values, kind="stable")
    n_left = len(p_values) - np.arange(len(p_values))
    adjusted = np.empty_like(p_values)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p_values[order] * n_left))
    return adjusted


def holm_levels(p_values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """The level that Holm's method leaves for each test: below it, its p-value is significant at 5 %.

    With the other p-values as they are. Where r of these are rejected, it is 5 % over the number of all tests
    less r: what a test is decided by, and so what its power is of.

    Examples
    --------
    >>> holm_levels([0.001, 0.04, 0.03]).round(4).tolist()
    [0.0167, 0.025, 0.025]
    """
    p_values = np.asarray(p_values, float)
    order = np.argsort(p_values, kind="stable")
    bounds = SIGNIFICANCE_LEVEL / (len(p_values) - np.arange(len(p_values)))
    rejected = _count_rejected(p_values[order], bounds)
    levels = np.full(len(p_values), bounds[min(rejected, len(bounds) - 1)] if len(bounds) else 1.0)
    for place in range(rejected):
        others = np.delete(p_values[order], place)
        levels[order[place]] = bounds[_count_rejected(others, bounds[:-1])]
    return levels


def _count_rejected(ordered: Array, bounds: Array) -> int:
    """How many of the smallest p-values, in order, are all below their bounds."""
    return int(np.argmin(np.append(ordered < bounds, False)))


@dataclass(frozen=True)
class BlockedComparison:
    """The levels (k) and blocks (b) of n units.

    Attributes
    ----------
    level, block : array of int, shape (n,)
        Counted from 0, every number in use.
    nuisance : array, shape (n, b)
        Orthonormal basis of the blocks' means (of the general mean where there is one block).
    effect : array, shape (n, k - 1)
        Orthonormal basis of the levels' effects beside the blocks'; fewer columns where blocks do not
        connect all levels.
    """

    level: IntArray
    block: IntArray
    nuisance: Array
    effect: Array

    @property
    def levels(self) -> int:
        """Number of levels."""
        return int(self.level.max()) + 1

    @property
    def df(self) -> tuple[int, int]:
        """Degrees of freedom of the levels and of the error."""
        between = self.effect.shape[1]
        return between, len(self.level) - self.nuisance.shape[1] - between

    @property
    def connected(self) -> bool:
        """Whether blocks connect all levels, so that each can be compared with each."""
        return self.effect.shape[1] == self.levels - 1


@dataclass(frozen=True)
class SumsOfSquares:
    """Sums of squares of stacked values.

    Attributes
    ----------
    blocks, between, within : array, shape (...)
        They add up to the total about the general mean.
    df : tuple of (int, int, int)
    """

    blocks: Array
    between: Array
    within: Array
    df: tuple[int, int, int]

    @property
    def total(self) -> Array:
        """Sum of squares about the general mean."""
        return self.blocks + self.between + self.within

    @property
    def variance(self) -> Array:
        """Mean square of the error."""
        return self.within / self.df[2]

    @property
    def statistic(self) -> Array:
        """F: mean square of the levels over that of the error."""
        return self.between / self.df[1] / self.variance

    @property
    def p_value(self) -> Array:
        """Probability of an F at least as large where the levels do not differ."""
        from scipy.special import fdtrc

        return fdtrc(*self.df[1:], self.statistic)

    @property
    def omega_squared(self) -> Array:
        """Share of variance that the levels account for (Hays), blocks left out; at least 0."""
        excess = self.df[1] * (self.statistic - 1.0)
        return np.maximum(0.0, excess / (excess + sum(self.df) + 1))


def build_comparison(level: npt.ArrayLike, block: npt.ArrayLike | None = None) -> BlockedComparison:
    """The comparison of n units with labels of any kind, shape (n,)."""
    levels = np.unique(np.asarray(level), return_inverse=True)[1]
    blocks = np.zeros_like(levels) if block is None else np.unique(np.asarray(block), return_inverse=True)[1]
    nuisance = unit_columns(blocks)
    one_block = nuisance.shape[1] == 1
    effect = contrast_basis(levels) if one_block else orthonormal_basis(indicator_columns(levels), nuisance)
    return BlockedComparison(levels, blocks, nuisance, effect)


def sums_of_squares(values: npt.ArrayLike, comparison: BlockedComparison) -> SumsOfSquares:
    """Sums of squares of blocks, of levels within them and of the residuals of values, shape (..., n).

    Values are shifted by one of them first: the difference of two nearby doubles is exact (Sterbenz).

    Examples
    --------
    >>> two_days = build_comparison(["Mon", "Mon", "Mon", "Tue", "Tue", "Tue"])
    >>> sums = sums_of_squares([1e12 + 1, 1e12 + 2, 1e12 + 3, 1e12 + 4, 1e12 + 5, 1e12 + 6], two_days)
    >>> round(float(sums.statistic), 12), round(float(sums.p_value), 6)
    (13.5, 0.021312)
    """
    shifted = subtract_median(values)
    centred = shifted - shifted.mean(axis=-1, keepdims=True)
    by_block = centred @ comparison.nuisance
    rest = centred - by_block @ comparison.nuisance.T
    by_level = rest @ comparison.effect
    rest = rest - by_level @ comparison.effect.T
    # Once more, for the rounding of the first projections.
    rest = rest - (rest @ comparison.nuisance) @ comparison.nuisance.T
    rest = rest - (rest @ comparison.effect) @ comparison.effect.T
    between_blocks, between, within = (np.sum(part**2, axis=-1) for part in (by_block, by_level, rest))
    df = (comparison.nuisance.shape[1] - 1, *comparison.df)
    return SumsOfSquares(between_blocks, between, within, df)


def level_means(values: npt.ArrayLike, comparison: BlockedComparison) -> tuple[Array, Array]:
    """Mean of each level, adjusted for the blocks, and the covariance factor of their differences.

    Returns
    -------
    means : array, shape (..., k)
    factor : array, shape (k, k)
        Times the error's variance: covariance of the means, up to a constant common to all.
    """
    return adjusted_means(values, comparison.level, comparison.nuisance)


def adjusted_means(values: npt.ArrayLike, level: IntArray, nuisance: Array) -> tuple[Array, Array]:
    """As `level_means`, adjusted for any other terms of which `nuisance` is an orthonormal basis."""
    values = np.asarray(values, float)
    shifted = subtract_median(values)
    origin = (values - shifted)[..., :1]
    within = indicator_columns(level)
    within = within - nuisance @ (nuisance.T @ within)
    factor = np.linalg.pinv(within.T @ within, rcond=1e-10, hermitian=True)
    adjusted = (shifted @ within) @ factor
    share = np.bincount(level) / len(level)
    middle = shifted.mean(axis=-1, keepdims=True) - (adjusted @ share)[..., None]
    return origin + middle + adjusted, factor


def subtract_median(values: npt.ArrayLike) -> Array:
    """Values less their median, without rounding where they are near each other."""
    values = np.asarray(values, float)
    middle = values.shape[-1] // 2
    return values - np.partition(values, middle, axis=-1)[..., middle : middle + 1]


CONFIDENCE_LEVEL = 0.95


@dataclass(frozen=True)
class LevelDifference:
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
        Largest less smallest mean, with the 95 % interval of Tukey and Kramer, which holds for all pairs
        at once. With two levels it is Student's.
    """

    means: Array
    half_width: Array
    largest: int
    smallest: int
    difference: float
    low: float
    high: float


def largest_difference(values: Array, comparison: BlockedComparison) -> LevelDifference:
    """The largest difference between levels of one set of values, shape (n,).

    Examples
    --------
    >>> result = largest_difference(np.array([1.0, 2, 3, 4, 5, 6]), build_comparison(list("aaabbb")))
    >>> round(result.difference, 3), round(result.low, 3), round(result.high, 3)
    (3.0, 0.733, 5.267)
    """
    spread = float(np.sqrt(sums_of_squares(values, comparison).variance))
    return compare_means(values, comparison.level, comparison.nuisance, spread, comparison.df[1])


def compare_means(
    values: Array, level: IntArray, nuisance: Array, spread: float, df: float
) -> LevelDifference:
    """As `largest_difference`, with an error of standard deviation `spread` known to `df`.

    `nuisance`, shape (n, b), is an orthonormal basis of all other terms, the general mean among them.
    """
    from scipy.special import stdtrit

    means, factor = adjusted_means(values, level, nuisance)
    largest, smallest = int(np.argmax(means)), int(np.argmin(means))
    difference = float(means[largest] - means[smallest])
    error = spread * np.sqrt(difference_factor(factor)[largest, smallest])
    reach = _studentized_range_quantile(len(means), df) * error
    count = np.bincount(level)
    half_width = float(stdtrit(df, (1 + CONFIDENCE_LEVEL) / 2)) * spread / np.sqrt(count)
    return LevelDifference(
        means, half_width, largest, smallest, difference, float(difference - reach), float(difference + reach)
    )


def difference_factor(factor: Array) -> Array:
    """Times the error's variance: variance of the difference between each two means, shape (k, k)."""
    diagonal = np.diag(factor)
    return diagonal[:, None] + diagonal[None, :] - 2 * factor


NODES = 96  # of each Gauss-Legendre quadrature of the studentized range; good to 1e-8


@cache
def _studentized_range_quantile(levels: int, df: float) -> float:
    """Quantile of the studentized range for a difference in units of its standard error.

    Of k normal values the range is below w with probability k int phi(z) (Phi(z) - Phi(z - w))^(k-1) dz, that
    is averaged over the error's standard deviation. scipy.stats has it too, a hundred times slower.
    """
    from scipy.optimize import brentq
    from scipy.special import chdtri, gammaln, ndtr, stdtrit

    if levels == 2:
        return float(stdtrit(df, (1 + CONFIDENCE_LEVEL) / 2))
    node, weight = np.polynomial.legendre.leggauss(NODES)
    low, high = np.sqrt(chdtri(df, [1 - 1e-12, 1e-12]) / df)  # of the ratio of the error's estimate to itself
    s = (low + high) / 2 + (high - low) / 2 * node
    density = np.exp(
        (df - 1) * np.log(s) - df * s**2 / 2 + df / 2 * np.log(df / 2) - gammaln(df / 2) + np.log(2)
    )
    share = density * weight * (high - low) / 2
    z = 9.0 * node
    normal = 9.0 * weight * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)

    def excess(q: float) -> float:
        ranges = ndtr(z) - ndtr(z - q * s[:, None])
        return (
            float(share @ (levels * ranges ** (levels - 1) @ normal)) / float(share.sum()) - CONFIDENCE_LEVEL
        )

    return float(brentq(excess, 1e-3, 1e4, xtol=1e-10)) / np.sqrt(2.0)


def f_test_power(noncentrality: float, df: tuple[float, float], level: float = SIGNIFICANCE_LEVEL) -> float:
    """Probability that the F test rejects at `level`.

    The noncentrality is the sum of squares of the true level means within blocks over the error's variance.

    Examples
    --------
    >>> round(f_test_power(0.0, (1, 4)), 6)
    0.05
    """
    from scipy.special import fdtri, ncfdtr

    return float(1.0 - ncfdtr(*df, noncentrality, fdtri(*df, 1.0 - level)))


def smallest_noncentrality(difference: float, spread: float, comparison: BlockedComparison) -> float:
    """The smallest noncentrality when two levels differ by `difference`, whichever two these are."""
    _, factor = level_means(np.zeros(len(comparison.level)), comparison)
    return (difference / spread) ** 2 / float(difference_factor(factor).max())


def detectable_difference(
    spread: float, comparison: BlockedComparison, level: float = SIGNIFICANCE_LEVEL
) -> float:
    """The difference between two levels that is detected at `level` with a power of 80 %.

    `spread` is the standard deviation of the error.

    Examples
    --------
    >>> two_days_of_three = build_comparison(list("aaabbb"))
    >>> round(detectable_difference(1.0, two_days_of_three), 3)
    3.071
    """
    noncentrality = noncentrality_at_power(comparison.df, level)
    return spread * float(np.sqrt(noncentrality / smallest_noncentrality(1.0, 1.0, comparison)))


@cache
def noncentrality_at_power(df: tuple[float, float], level: float) -> float:
    """The noncentrality at which the F test at `level` has a power of 80 %."""
    from scipy.optimize import brentq

    # FTestPower.solve_power stops within 1e-5 of the root, and FTestPowerF2's stays at its start for few df.
    upper = 10.0
    while f_test_power(upper, df, level) < TARGET_POWER:
        upper *= 4.0
    return float(brentq(lambda size: f_test_power(size, df, level) - TARGET_POWER, 1e-6, upper, rtol=1e-10))
