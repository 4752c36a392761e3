"""FactorTest: one F test with effect, power, permutation p-value and checks of its assumptions.

The checks are normality (after Shapiro and Francia), equal variances (Brown and Forsythe), drift within
sessions, and levels measured in turn. The first two take p-values from simulation of the same design.
The permutation test relabels units within blocks: all arrangements where feasible, else random ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations, product
from math import factorial, prod

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.anova.contrasts import (
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

CellStatistic = Callable[[Array, IntArray], Array]
"""Of readings, shape (..., n), and the cell of each; the larger, the less the assumption holds."""

SIMULATION_DRAWS, MAX_SIMULATED_NUMBERS = 999, 500_000


def monte_carlo_p(statistic: CellStatistic, values: Array, cell: IntArray) -> float:
    """Share of normal readings of the same design whose statistic is as large as that of these.

    Drawn, not looked up: cells of a few readings each are far from what tables of these statistics are for.
    """
    from scipy.stats import monte_carlo_test

    order = np.argsort(cell, kind="stable")
    tested = monte_carlo_test(
        values[order],
        np.random.default_rng(0).standard_normal,
        lambda drawn, axis: statistic(drawn, cell[order]),
        vectorized=True,
        n_resamples=max(199, min(SIMULATION_DRAWS, MAX_SIMULATED_NUMBERS // len(cell))),
        alternative="greater",
    )
    return float(tested.pvalue)


def shapiro_francia(values: Array, cell: IntArray) -> Array:
    """1 - W', of ordered residuals from the cells' means and normal scores."""
    from scipy.special import ndtri

    n = values.shape[-1]
    scores = ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    ordered = np.sort(cell_residuals(values, cell), axis=-1)
    return 1.0 - (ordered @ scores) / np.sqrt(np.sum(ordered**2, axis=-1) * np.sum(scores**2))


def brown_forsythe(values: Array, cell: IntArray) -> Array:
    """F of the distances from each cell's median, between cells."""
    from scipy.stats import levene

    samples = [values[..., cell == one] for one in np.unique(cell)]
    return np.asarray(levene(*samples, center="median", axis=-1).statistic)


def cell_residuals(values: Array, cell: IntArray) -> Array:
    """Values less the mean of their cell, shape (..., n)."""
    values = subtract_median(values)
    share = (cell[:, None] == np.unique(cell)).astype(float)
    return values - (values @ share / share.sum(axis=0)) @ share.T


ASSUMPTION_LEVEL = 0.01  # a log has dozens of checks; at 0.05 one in twenty would be doubted for nothing
MIN_RESIDUAL_DF = 6  # degrees of freedom below which nothing can be told of a shape or a trend
MIN_CELL_SIZE = 3  # two readings are always equally far from their middle
MAX_TIME_SHARE = (
    0.9  # share of the variance of time that levels explain where they were read one after another
)


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


def check_assumptions(
    values: Array, time: Array, level: IntArray, block: IntArray
) -> tuple[AssumptionCheck, ...]:
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
        _check_normality(values, cell),
        _check_equal_variance(values, cell),
        _check_drift(values, time, cell),
        _check_interleaving(time, level, block),
    )


def _check_normality(values: Array, cell: IntArray) -> AssumptionCheck:
    name = "normal scatter"
    if _residual_df(cell) < MIN_RESIDUAL_DF or not np.any(cell_residuals(values, cell)):
        return _cannot_check(name, "too few readings to tell whether they scatter normally")
    doubt = "the readings do not scatter normally: trust the permutation p more than the F test's"
    p_value = monte_carlo_p(shapiro_francia, values, cell)
    return _conclude(name, p_value, "the readings scatter as normal ones would", doubt)


def _check_equal_variance(values: Array, cell: IntArray) -> AssumptionCheck:
    name = "equal scatter"
    sizes = np.bincount(cell)
    used = sizes[cell] >= MIN_CELL_SIZE
    readings, cells = values[used], np.unique(cell[used], return_inverse=True)[1]
    if cells.max(initial=0) < 1 or not np.any(cell_residuals(readings, cells)):
        return _cannot_check(name, "too few readings at one level to tell whether all levels scatter alike")
    doubt = "levels do not scatter alike: where their numbers of readings differ, the F test's p may be off"
    return _conclude(name, monte_carlo_p(brown_forsythe, readings, cells), "all levels scatter alike", doubt)


def _check_drift(values: Array, time: Array, cell: IntArray) -> AssumptionCheck:
    """Readings against the time within their session, reshuffled within each cell."""
    name = "drift within a session"
    left = cell_residuals(values, cell)
    observed = abs(float(left @ time))
    if _residual_df(cell) < MIN_RESIDUAL_DF or observed == 0.0:
        return _cannot_check(name, "too few repeated readings to tell whether they drift within a session")
    home = np.argsort(cell, kind="stable")
    count = max(199, min(SIMULATION_DRAWS, MAX_SIMULATED_NUMBERS // len(cell)))
    keys = np.random.default_rng(0).random((count, len(cell))) + cell[home]
    shuffled = left[home][np.argsort(keys, axis=1)] @ time[home]
    p_value = (1 + np.sum(np.abs(shuffled) >= observed * (1 - 1e-9))) / (1 + count)
    doubt = "repeated readings drift within their session: what looks like an effect may be the hour"
    return _conclude(name, float(p_value), "repeated readings show no drift within a session", doubt)


def _check_interleaving(time: Array, level: IntArray, block: IntArray) -> AssumptionCheck:
    """Whether levels took turns within sessions, or were read one after another in all of them."""
    name = "levels in turn"
    turns = sums_of_squares(time, build_comparison(level, block))
    if turns.df[1] == 0 or turns.between + turns.within <= 0:
        return AssumptionCheck(name, "holds", "each level is a session of its own")
    if turns.between < MAX_TIME_SHARE * (turns.between + turns.within):
        return AssumptionCheck(
            name, "holds", "levels took turns, so that a drift would not pass for an effect"
        )
    doubt = "levels were read one after another, so that a drift in the session could pass for an effect"
    return AssumptionCheck(name, "doubtful", doubt)


def _residual_df(cell: IntArray) -> int:
    return len(cell) - len(np.unique(cell))


def _cannot_check(name: str, message: str) -> AssumptionCheck:
    return AssumptionCheck(name, "cannot tell", message)


def _conclude(name: str, p_value: float, fine: str, doubt: str) -> AssumptionCheck:
    verdict, message = ("holds", fine) if p_value >= ASSUMPTION_LEVEL else ("doubtful", doubt)
    return AssumptionCheck(name, verdict, message, p_value)


MAX_ARRANGEMENTS = 20_000
PERMUTATION_DRAWS = 9_999
MAX_PERMUTED_NUMBERS = 3_000_000  # arrangements times units that are looked at
CHUNK_SIZE = 2_000_000
TIE_TOL = 1e-9  # arrangements that differ by less than this have the same statistic


@dataclass(frozen=True)
class PermutationResult:
    """What relabelling says.

    Attributes
    ----------
    p_value : float
    floor : float
        The smallest p-value that so few units can give.
    arrangements : int
        How many were looked at.
    exact : bool
        Whether these were all; otherwise they were drawn, and the units as they were count as one more.
    """

    p_value: float
    floor: float
    arrangements: int
    exact: bool


def permute_levels(values: Array, comparison: BlockedComparison, seed: int = 0) -> PermutationResult:
    """Compare the statistic with that of units relabelled within their blocks.

    Within blocks the sum of squares of blocks does not change, so F rises and falls with that of the
    levels, which is what is compared.

    Parameters
    ----------
    values : array, shape (n,)
    comparison : Comparison
    seed : int, optional
        Of the draws, where there are too many arrangements to look at all.

    Examples
    --------
    >>> from stickslip_fit.anova.contrasts import build_comparison
    >>> permute_levels(np.array([1.0, 2, 3, 4, 5, 6]), build_comparison(list("aaabbb")))
    Permutation(p_value=0.1, floor=0.1, arrangements=20, exact=True)
    """
    table = _cell_counts(comparison)
    count = prod(_count_arrangements(row) for row in table)
    same = prod(factorial(int(alike)) for alike in np.unique(table, axis=1, return_counts=True)[1])
    centred = subtract_median(values)
    centred = centred - (centred @ comparison.nuisance) @ comparison.nuisance.T
    observed = _between_squares(centred, comparison)
    exact = count <= MAX_ARRANGEMENTS
    looked_at = count if exact else max(199, min(PERMUTATION_DRAWS, MAX_PERMUTED_NUMBERS // len(values)))
    orders = _enumerate_orders(comparison) if exact else _draw_orders(comparison, looked_at, seed)
    as_large = sum(
        int(np.sum(_between_squares(centred[chunk], comparison) >= observed * (1 - TIE_TOL)))
        for chunk in orders
    )
    extra = 0 if exact else 1
    p_value = (as_large + extra) / (looked_at + extra)
    floor = max(same / count, extra / (looked_at + extra))
    return PermutationResult(min(1.0, p_value), min(1.0, floor), looked_at, exact)


def _cell_counts(comparison: BlockedComparison) -> IntArray:
    """Units of each block and level, shape (b, k)."""
    table = np.zeros((int(comparison.block.max()) + 1, comparison.levels), dtype=np.intp)
    np.add.at(table, (comparison.block, comparison.level), 1)
    return table


def _count_arrangements(row: IntArray) -> int:
    return factorial(int(row.sum())) // prod(factorial(int(size)) for size in row)


def _between_squares(centred: Array, comparison: BlockedComparison) -> Array:
    """Sum of squares of the levels; without blocks their sums will do, however many levels there are."""
    if comparison.nuisance.shape[1] > 1:
        return np.sum((centred @ comparison.effect) ** 2, axis=-1)
    home = np.argsort(comparison.level, kind="stable")
    count = np.bincount(comparison.level)
    sums = np.add.reduceat(centred[..., home], np.cumsum(count) - count, axis=-1)
    return np.sum(sums**2 / count, axis=-1)


def _enumerate_orders(comparison: BlockedComparison) -> Iterator[IntArray]:
    """Every distinct way to hand each block's units to its levels, as indices, shape (chunk, n)."""
    blocks = [np.flatnonzero(comparison.block == block) for block in range(int(comparison.block.max()) + 1)]
    choices = [list(_enumerate_assignments(units, comparison.level[units])) for units in blocks]
    order = np.concatenate(blocks)
    back = np.argsort(order)
    whole = np.array([np.concatenate(parts) for parts in product(*choices)], dtype=np.intp)
    yield whole[:, back]


def _enumerate_assignments(units: IntArray, level: IntArray) -> Iterator[IntArray]:
    """Each assignment of `units` to the places of `level`, those within a level not told apart."""
    present = np.unique(level)
    places = [np.flatnonzero(level == one) for one in present]
    for parts in _enumerate_splits(tuple(units), [len(place) for place in places]):
        found = np.empty(len(units), dtype=np.intp)
        for place, part in zip(places, parts, strict=True):
            found[place] = part
        yield found


def _enumerate_splits(units: tuple[int, ...], sizes: list[int]) -> Iterator[list[tuple[int, ...]]]:
    if len(sizes) == 1:
        yield [units]
        return
    for first in combinations(units, sizes[0]):
        rest = tuple(unit for unit in units if unit not in first)
        for others in _enumerate_splits(rest, sizes[1:]):
            yield [first, *others]


def _draw_orders(comparison: BlockedComparison, count: int, seed: int) -> Iterator[IntArray]:
    rng = np.random.default_rng(seed)
    n = len(comparison.block)
    home = np.argsort(comparison.block, kind="stable")
    back = np.argsort(home)
    size = max(1, CHUNK_SIZE // n)
    for begin in range(0, count, size):
        keys = rng.random((min(size, count - begin), n)) + comparison.block[home]
        yield home[np.argsort(keys, axis=1)][:, back]


EXACT_REPEAT_TOL = 1e-12  # relative scatter that is the rounding of doubles
MIN_ROUNDING_RATIO = 1.5  # times the rounding of the counts: scatter that is hardly more than it


@dataclass(frozen=True)
class FactorTest:
    """What a log says to one question; SI.

    Attributes
    ----------
    design : Question
    squares : SumsOfSquares
        Sums of squares, F and its p-value.
    effect : Effect
        Means of the levels and the largest difference between them.
    levels : tuple of str
        Names of the levels, in the order of `effect`'s means.
    permutation : Permutation
    p_holm : float
        The F test's p-value, adjusted for everything that was asked.
    detectable : float
        The smallest difference between two levels that so many readings, scattering so much, would show
        at 5 % in 80 of 100 such logs.
    premises : tuple of AssumptionCheck
    """

    design: FactorTestDesign
    squares: SumsOfSquares
    effect: LevelDifference
    levels: tuple[str, ...]
    permutation: PermutationResult
    p_holm: float
    detectable: float
    assumptions: tuple[AssumptionCheck, ...]

    @property
    def p_value(self) -> float:
        """Of the F test."""
        return float(self.squares.p_value)

    @property
    def statistic(self) -> float:
        """F."""
        return float(self.squares.statistic)

    @property
    def extreme_levels(self) -> tuple[str, str]:
        """The levels with the largest and with the smallest mean."""
        return self.levels[self.effect.largest], self.levels[self.effect.smallest]

    @property
    def relative_difference(self) -> float:
        """The difference as a share of the mean step size."""
        return self.effect.difference / float(self.design.readings["step_size"].mean())

    @property
    def table(self) -> pd.DataFrame:
        """Sums of squares (SI), degrees of freedom, mean squares, F and p; over sessions, of cell means."""
        squares, design = self.squares, self.design
        names = ["session", design.factor, design.error_term, "total"]
        sums = [squares.blocks, squares.between, squares.within, squares.total]
        df = [*squares.df, sum(squares.df)]
        table = pd.DataFrame({"term": names, "ss": np.array(sums, float), "df": df})
        if design.error_term == WITHIN_SESSION_ERROR:
            table = table[1:].reset_index(drop=True)
        table["ms"] = (table["ss"] / table["df"]).where(table["term"] != "total")
        tested = table["term"] == design.factor
        table["F"] = np.where(tested, self.statistic, np.nan)
        return table.assign(p=np.where(tested, self.p_value, np.nan))


def run_factor_test(design: FactorTestDesign) -> FactorTest | NotTestable:
    """Answer one question; `p_holm` is its p-value as if nothing else had been asked.

    Readings without any scatter are refused: F would be infinite.
    """
    units = design.units
    values = units["step_size"].to_numpy(float)
    comparison = build_comparison(units["level"], units["block"])
    squares = sums_of_squares(values, comparison)
    spread = float(np.sqrt(squares.variance))
    if spread <= EXACT_REPEAT_TOL * float(np.abs(values).max()):
        return NotTestable(
            design.analysis, design.joint, design.direction, design.session, design.configuration,
            f"{design.error_term}: no scatter at all, so that nothing can be compared with it",
        )  # fmt: skip
    return FactorTest(
        design,
        squares,
        largest_difference(values, comparison),
        tuple(map(str, np.unique(units["level"].to_numpy(object)))),
        permute_levels(values, comparison),
        float(squares.p_value),
        detectable_difference(spread, comparison),
        _assumption_checks(design, spread),
    )


def _assumption_checks(design: FactorTestDesign, spread: float) -> tuple[AssumptionCheck, ...]:
    rows = design.readings
    codes = [np.unique(rows[name].to_numpy(object), return_inverse=True)[1] for name in ("level", "session")]
    checks = check_assumptions(
        rows["step_size"].to_numpy(float), rows["session_seconds"].to_numpy(float), codes[0], codes[1]
    )
    rounding = float(np.sqrt(np.mean(rows["rounding"] ** 2)))
    if design.error_term == WITHIN_SESSION_ERROR and spread < MIN_ROUNDING_RATIO * rounding:
        message = "readings scatter hardly more than the counts are rounded: check the end stop more often"
        checks = (*checks, AssumptionCheck("finer than the count", "doubtful", message))
    return checks
