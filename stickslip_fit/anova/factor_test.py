"""FactorTest: one F test with effect, power, permutation p-value and checks of its assumptions.

The checks are normality (after Shapiro and Francia), equal variances (Brown and Forsythe), drift within
sessions, and levels measured in turn. The first two take p-values from simulation of the same design.
The permutation test relabels units within blocks: all arrangements where feasible, else random ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import factorial, prod
from typing import Literal

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.anova.contrasts import (
    SIGNIFICANCE_LEVEL,
    BlockedComparison,
    LevelDifference,
    SumsOfSquares,
    build_comparison,
    detectable_difference,
    largest_difference,
    subtract_median,
    sums_of_squares,
)
from stickslip_fit.anova.designs import WITHIN_SESSION_ERROR, FactorTestDesign, NotTestable
from stickslip_fit.logs.schema import NO_TIMES

CellStatistic = Callable[[Array, IntArray], Array]
"""Of observations, shape (..., n), and their cells; the larger, the less the assumption holds."""

SIMULATION_DRAWS, MAX_SIMULATED_NUMBERS = 999, 500_000
ROUNDING = 100 * np.finfo(float).eps  # relative, of a statistic


def monte_carlo_p(statistic: CellStatistic, values: Array, cell: IntArray) -> float:
    """Share of simulated normal observations of the same design whose statistic is as large.

    Tables of these statistics do not hold for cells of a few observations each.
    """
    order = np.argsort(cell, kind="stable")
    number = max(199, min(SIMULATION_DRAWS, MAX_SIMULATED_NUMBERS // len(cell)))
    drawn = np.random.default_rng(0).standard_normal((number, len(cell)))
    observed, simulated = statistic(values[order], cell[order]), statistic(drawn, cell[order])
    # As large but for rounding counts as well.
    tolerance = ROUNDING * np.abs(observed)
    return float((1 + np.sum(simulated >= observed - tolerance)) / (1 + number))


def shapiro_francia(values: Array, cell: IntArray) -> Array:
    """1 - W', of ordered residuals from the cells' means and normal scores."""
    from scipy.special import ndtri

    n = values.shape[-1]
    scores = ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    ordered = np.sort(cell_residuals(values, cell), axis=-1)
    return 1.0 - (ordered @ scores) / np.sqrt(np.sum(ordered**2, axis=-1) * np.sum(scores**2))


def brown_forsythe(values: Array, cell: IntArray) -> Array:
    """F of the distances from each cell's median, between cells."""
    cells, n = np.unique(cell), values.shape[-1]
    distances = [
        np.abs(own - np.median(own, axis=-1, keepdims=True))
        for own in (values[..., cell == one] for one in cells)
    ]
    means = np.stack([own.mean(axis=-1) for own in distances], axis=-1)
    within = sum(np.sum((own - own.mean(axis=-1, keepdims=True)) ** 2, axis=-1) for own in distances)
    sizes = np.array([own.shape[-1] for own in distances])
    centre = means @ sizes / n
    between = (means - centre[..., None]) ** 2 @ sizes
    return np.asarray((n - len(cells)) / (len(cells) - 1) * between / within)


def cell_residuals(values: Array, cell: IntArray) -> Array:
    """Values less the mean of their cell, shape (..., n)."""
    values = subtract_median(values)
    share = (cell[:, None] == np.unique(cell)).astype(float)
    return values - (values @ share / share.sum(axis=0)) @ share.T


ASSUMPTION_LEVEL = 0.01  # of each check, for normal readings; a log has dozens, at 0.05 most would doubt one
MIN_RESIDUAL_DF = 6  # for a check of a distribution or a trend
MIN_CELL_SIZE = 3  # two observations are always equally far from their median
MAX_TIME_SHARE = 0.9  # of the variance of time, explained by levels measured one after another


@dataclass(frozen=True)
class AssumptionCheck:
    """Outcome of one check: holds, doubtful or cannot tell; with a p-value where it is a test."""

    name: str
    outcome: Literal["holds", "doubtful", "cannot tell"]
    message: str
    p_value: float | None = None


def check_assumptions(
    values: Array, time: Array, level: IntArray, block: IntArray
) -> tuple[AssumptionCheck, ...]:
    """Check observations against the assumptions of an F test.

    Parameters
    ----------
    values, time : array, shape (n,)
        Step sizes, and when each was observed, seconds, NaN where nobody knows.
    level, block : array of int, shape (n,)
        Level and session of each observation.
    """
    cell = np.unique(np.stack([block, level]), axis=1, return_inverse=True)[1].ravel()
    shape = (_check_normality(values, cell), _check_equal_variance(values, cell))
    if np.isnan(time).any():
        reason = f"{NO_TIMES}, so that drift cannot be told from an effect"
        return (*shape, *(AssumptionCheck(name, "cannot tell", reason) for name in TIME_CHECKS))
    return (*shape, _check_drift(values, time, cell), _check_interleaving(time, level, block))


TIME_CHECKS = ("drift within a session", "levels in turn")


def _check_normality(values: Array, cell: IntArray) -> AssumptionCheck:
    name = "normal scatter"
    if _residual_df(cell) < MIN_RESIDUAL_DF or not np.any(cell_residuals(values, cell)):
        return AssumptionCheck(name, "cannot tell", "too few traverses to tell whether they scatter normally")
    doubt = "the traverses do not scatter normally: trust the permutation p more than the F test's"
    p_value = monte_carlo_p(shapiro_francia, values, cell)
    return _conclude(name, p_value, "the traverses scatter as normal ones would", doubt)


def _check_equal_variance(values: Array, cell: IntArray) -> AssumptionCheck:
    name = "equal scatter"
    sizes = np.bincount(cell)
    used = sizes[cell] >= MIN_CELL_SIZE
    readings, cells = values[used], np.unique(cell[used], return_inverse=True)[1]
    if cells.max(initial=0) < 1 or not np.any(cell_residuals(readings, cells)):
        return AssumptionCheck(
            name, "cannot tell", "too few traverses at one level to tell whether all levels scatter alike"
        )
    doubt = "levels do not scatter alike: where their numbers of traverses differ, the F test's p may be off"
    return _conclude(name, monte_carlo_p(brown_forsythe, readings, cells), "all levels scatter alike", doubt)


def _check_drift(values: Array, time: Array, cell: IntArray) -> AssumptionCheck:
    """Permutation test of residuals against time, within each cell."""
    name = TIME_CHECKS[0]
    residuals = cell_residuals(values, cell)
    observed = abs(float(residuals @ time))
    if _residual_df(cell) < MIN_RESIDUAL_DF or observed == 0.0:
        return AssumptionCheck(
            name, "cannot tell", "too few repeated traverses to tell whether they drift within a session"
        )
    home = np.argsort(cell, kind="stable")
    count = max(199, min(SIMULATION_DRAWS, MAX_SIMULATED_NUMBERS // len(cell)))
    keys = np.random.default_rng(0).random((count, len(cell))) + cell[home]
    shuffled = residuals[home][np.argsort(keys, axis=1)] @ time[home]
    p_value = (1 + np.sum(np.abs(shuffled) >= observed * (1 - 1e-9))) / (1 + count)
    doubt = "repeated traverses drift within their session: what looks like an effect may be the hour"
    return _conclude(name, float(p_value), "repeated traverses show no drift within a session", doubt)


def _check_interleaving(time: Array, level: IntArray, block: IntArray) -> AssumptionCheck:
    """Whether levels took turns within sessions, or were measured one after another in all of them."""
    name = TIME_CHECKS[1]
    sums = sums_of_squares(time, build_comparison(level, block))
    total = sums.between + sums.within
    if sums.df[1] == 0 or total <= 0:
        return AssumptionCheck(name, "holds", "each level is a session of its own")
    if sums.between < MAX_TIME_SHARE * total:
        message = "levels took turns, so that a drift would not pass for an effect"
        return AssumptionCheck(name, "holds", message)
    doubt = "levels were read one after another, so that a drift in the session could pass for an effect"
    return AssumptionCheck(name, "doubtful", doubt)


def _residual_df(cell: IntArray) -> int:
    return len(cell) - len(np.unique(cell))


def _conclude(name: str, p_value: float, passed: str, failed: str) -> AssumptionCheck:
    if p_value >= ASSUMPTION_LEVEL:
        return AssumptionCheck(name, "holds", passed, p_value)
    return AssumptionCheck(name, "doubtful", failed, p_value)


MAX_ARRANGEMENTS, PERMUTATION_DRAWS = 20_000, 9_999
MAX_PERMUTED_NUMBERS = 3_000_000  # arrangements times units
CHUNK_SIZE = 2_000_000
TIE_TOL = 1e-9  # statistics of arrangements that differ by less are equal


@dataclass(frozen=True)
class PermutationResult:
    """Result of a permutation test.

    Attributes
    ----------
    floor : float
        The smallest p-value that so few units can give.
    exact : bool
        Whether these are all arrangements; otherwise they are random, and the observed one is added.
    """

    p_value: float
    floor: float
    arrangements: int
    exact: bool


def permute_levels(values: Array, comparison: BlockedComparison) -> PermutationResult:
    """Permutation test of levels within blocks, by the sum of squares of the levels, with which F rises.

    Where there are too many arrangements for all, random ones are drawn.

    Examples
    --------
    >>> permute_levels(np.array([1.0, 2, 3, 4, 5, 6]), build_comparison(list("aaabbb")))
    PermutationResult(p_value=0.1, floor=0.1, arrangements=20, exact=True)
    """
    table = np.zeros((int(comparison.block.max()) + 1, comparison.levels), dtype=np.intp)
    np.add.at(table, (comparison.block, comparison.level), 1)
    count = prod(factorial(int(row.sum())) // prod(factorial(int(size)) for size in row) for row in table)
    same = prod(factorial(int(alike)) for alike in np.unique(table, axis=1, return_counts=True)[1])
    centred = subtract_median(values)
    centred = centred - (centred @ comparison.nuisance) @ comparison.nuisance.T
    observed = _between_squares(centred, comparison)
    exact = count <= MAX_ARRANGEMENTS
    n_orders = count if exact else max(199, min(PERMUTATION_DRAWS, MAX_PERMUTED_NUMBERS // len(values)))
    orders = _enumerate_orders(comparison) if exact else _draw_orders(comparison, n_orders)
    as_large = sum(
        int(np.sum(_between_squares(centred[chunk], comparison) >= observed * (1 - TIE_TOL)))
        for chunk in orders
    )
    extra = 0 if exact else 1
    p_value = (as_large + extra) / (n_orders + extra)
    floor = max(same / count, extra / (n_orders + extra))
    return PermutationResult(min(1.0, p_value), min(1.0, floor), n_orders, exact)


def _between_squares(centred: Array, comparison: BlockedComparison) -> Array:
    """Sum of squares of the levels; without blocks from their sums, which is faster for many levels."""
    if comparison.nuisance.shape[1] > 1:
        return np.sum((centred @ comparison.effect) ** 2, axis=-1)
    home = np.argsort(comparison.level, kind="stable")
    count = np.bincount(comparison.level)
    sums = np.add.reduceat(centred[..., home], np.cumsum(count) - count, axis=-1)
    return np.sum(sums**2 / count, axis=-1)


def _enumerate_orders(comparison: BlockedComparison) -> Iterator[IntArray]:
    """Every distinct assignment of each block's units to its levels, as indices, shape (chunk, n)."""
    blocks = [np.flatnonzero(comparison.block == block) for block in range(int(comparison.block.max()) + 1)]
    choices = [_enumerate_assignments(units, comparison.level[units]) for units in blocks]
    place = np.indices([len(choice) for choice in choices]).reshape(len(choices), -1)
    whole = np.concatenate([choice[own] for choice, own in zip(choices, place, strict=True)], axis=1)
    yield whole[:, np.argsort(np.concatenate(blocks))]


def _enumerate_assignments(units: IntArray, level: IntArray) -> IntArray:
    """Each assignment of `units` to the places of `level`, in any order within a level, shape (count, n)."""
    assigned, left = np.empty((1, len(units)), dtype=np.intp), units[None]
    for one in np.unique(level):
        place = np.flatnonzero(level == one)
        picked = np.array(list(combinations(range(left.shape[1]), len(place))), dtype=np.intp)
        others = np.ones((len(picked), left.shape[1]), dtype=bool)
        np.put_along_axis(others, picked, False, axis=1)
        rest = np.nonzero(others)[1].reshape(len(picked), -1)
        assigned = np.repeat(assigned, len(picked), axis=0)
        assigned[:, place] = left[:, picked].reshape(len(assigned), -1)
        left = left[:, rest].reshape(len(assigned), -1)
    return assigned


def _draw_orders(comparison: BlockedComparison, count: int) -> Iterator[IntArray]:
    rng = np.random.default_rng(0)
    n = len(comparison.block)
    home = np.argsort(comparison.block, kind="stable")
    back = np.argsort(home)
    size = max(1, CHUNK_SIZE // n)
    for begin in range(0, count, size):
        keys = rng.random((min(size, count - begin), n)) + comparison.block[home]
        yield home[np.argsort(keys, axis=1)][:, back]


EXACT_REPEAT_TOL = 1e-12  # relative scatter that is the rounding of doubles
MIN_ROUNDING_RATIO = 1.5  # scatter over the rounding of the counts


@dataclass(frozen=True)
class FactorTest:
    """One F test with effect, power and checks; SI.

    Attributes
    ----------
    design : FactorTestDesign
    sums : SumsOfSquares
        Sums of squares, F and its p-value.
    effect : LevelDifference
        Means of the levels and the largest difference between them.
    levels : tuple of str
        Names of the levels, in the order of `effect`'s means.
    permutation : PermutationResult
    p_holm : float
        The F test's p-value, adjusted over all tests.
    level : float
        Of the F test's p-value, at which it is decided beside all other tests; see `holm_levels`.
    """

    design: FactorTestDesign
    sums: SumsOfSquares
    effect: LevelDifference
    levels: tuple[str, ...]
    permutation: PermutationResult
    p_holm: float
    level: float = SIGNIFICANCE_LEVEL

    @cached_property
    def detectable(self) -> float:
        """The difference between two levels that is found significant with a power of 80 %."""
        comparison = build_comparison(self.design.units["level"], self.design.units["block"])
        return detectable_difference(float(np.sqrt(self.sums.variance)), comparison, self.level)

    @cached_property
    def assumptions(self) -> tuple[AssumptionCheck, ...]:
        """Whether the observations are such as an F test assumes."""
        return _assumption_checks(self.design, float(np.sqrt(self.sums.variance)))

    @property
    def is_significant(self) -> bool:
        """Whether it shows at 5 %, adjusted over all tests."""
        return self.p_holm < SIGNIFICANCE_LEVEL

    @property
    def p_value(self) -> float:
        """Of the F test."""
        return float(self.sums.p_value)

    @property
    def statistic(self) -> float:
        """F."""
        return float(self.sums.statistic)

    @property
    def extreme_levels(self) -> tuple[str, str]:
        """The levels with the largest and with the smallest mean."""
        return self.levels[self.effect.largest], self.levels[self.effect.smallest]

    @property
    def relative_difference(self) -> float:
        """The difference as a share of the mean step size."""
        return self.effect.difference / float(self.design.observations["step_size"].mean())

    @property
    def table(self) -> pd.DataFrame:
        """Sums of squares (SI), degrees of freedom, mean squares, F and p; over sessions, of cell means."""
        sums, design = self.sums, self.design
        names = ["session", design.factor, design.error_term, "total"]
        squares = [sums.blocks, sums.between, sums.within, sums.total]
        rows = []
        for name, ss, df in zip(names, squares, [*sums.df, sum(sums.df)], strict=True):
            tested = (self.statistic, self.p_value) if name == design.factor else (np.nan, np.nan)
            mean = float(ss) / df if df and name != "total" else np.nan
            rows.append((name, float(ss), df, mean, *tested))
        first = 1 if design.error_term == WITHIN_SESSION_ERROR else 0
        return pd.DataFrame(rows[first:], columns=["term", "ss", "df", "ms", "F", "p"])


def run_factor_test(design: FactorTestDesign) -> FactorTest | NotTestable:
    """Make one test, as if it were the only one. Without any scatter F would be infinite: not testable."""
    units = design.units
    values = units["step_size"].to_numpy(float)
    comparison = build_comparison(units["level"], units["block"])
    sums = sums_of_squares(values, comparison)
    spread = float(np.sqrt(sums.variance))
    if spread <= EXACT_REPEAT_TOL * float(np.abs(values).max()):
        return design.not_testable(
            f"{design.error_term}: no scatter at all, so that nothing can be compared with it"
        )
    return FactorTest(
        design,
        sums,
        largest_difference(values, comparison),
        tuple(map(str, np.unique(units["level"].to_numpy(object)))),
        permute_levels(values, comparison),
        float(sums.p_value),
    )


def _assumption_checks(design: FactorTestDesign, spread: float) -> tuple[AssumptionCheck, ...]:
    rows = design.observations
    codes = [np.unique(rows[name].to_numpy(object), return_inverse=True)[1] for name in ("level", "session")]
    checks = check_assumptions(
        rows["step_size"].to_numpy(float), rows["session_seconds"].to_numpy(float), codes[0], codes[1]
    )
    rounding = float(np.sqrt(np.mean(rows["rounding"] ** 2)))
    if design.error_term == WITHIN_SESSION_ERROR and spread < MIN_ROUNDING_RATIO * rounding:
        message = "traverses scatter hardly more than the counts are rounded: check the end stop more often"
        checks = (*checks, AssumptionCheck("finer than the count", "doubtful", message))
    return checks
