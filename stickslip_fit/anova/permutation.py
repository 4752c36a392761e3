"""Permutation p-values: how often relabelled units differ as much, over all arrangements where feasible."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product
from math import factorial, prod

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.comparison import Comparison, shift

Array = npt.NDArray[np.float64]
Codes = npt.NDArray[np.intp]

MOST_ARRANGEMENTS = 20_000
DRAWS = 9_999
MOST_NUMBERS = 3_000_000  # arrangements times units that are looked at
CHUNK = 2_000_000
TIE = 1e-9  # arrangements that differ by less than this have the same statistic


@dataclass(frozen=True)
class Permutation:
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


def permutation_test(values: Array, comparison: Comparison, seed: int = 0) -> Permutation:
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
    >>> from stickslip_fit.anova.comparison import compare
    >>> permutation_test(np.array([1.0, 2, 3, 4, 5, 6]), compare(list("aaabbb")))
    Permutation(p_value=0.1, floor=0.1, arrangements=20, exact=True)
    """
    table = _table(comparison)
    count = prod(_arrangements(row) for row in table)
    same = prod(factorial(int(alike)) for alike in np.unique(table, axis=1, return_counts=True)[1])
    centred = shift(values)
    centred = centred - (centred @ comparison.nuisance) @ comparison.nuisance.T
    observed = _between(centred, comparison)
    exact = count <= MOST_ARRANGEMENTS
    looked_at = count if exact else max(199, min(DRAWS, MOST_NUMBERS // len(values)))
    orders = _all_orders(comparison) if exact else _drawn_orders(comparison, looked_at, seed)
    as_large = sum(
        int(np.sum(_between(centred[chunk], comparison) >= observed * (1 - TIE))) for chunk in orders
    )
    extra = 0 if exact else 1
    p_value = (as_large + extra) / (looked_at + extra)
    floor = max(same / count, extra / (looked_at + extra))
    return Permutation(min(1.0, p_value), min(1.0, floor), looked_at, exact)


def _table(comparison: Comparison) -> Codes:
    """Units of each block and level, shape (b, k)."""
    table = np.zeros((int(comparison.block.max()) + 1, comparison.levels), dtype=np.intp)
    np.add.at(table, (comparison.block, comparison.level), 1)
    return table


def _arrangements(row: Codes) -> int:
    return factorial(int(row.sum())) // prod(factorial(int(size)) for size in row)


def _between(centred: Array, comparison: Comparison) -> Array:
    """Sum of squares of the levels; without blocks their sums will do, however many levels there are."""
    if comparison.nuisance.shape[1] > 1:
        return np.sum((centred @ comparison.effect) ** 2, axis=-1)
    home = np.argsort(comparison.level, kind="stable")
    count = np.bincount(comparison.level)
    sums = np.add.reduceat(centred[..., home], np.cumsum(count) - count, axis=-1)
    return np.sum(sums**2 / count, axis=-1)


def _all_orders(comparison: Comparison) -> Iterator[Codes]:
    """Every distinct way to hand each block's units to its levels, as indices, shape (chunk, n)."""
    blocks = [np.flatnonzero(comparison.block == block) for block in range(int(comparison.block.max()) + 1)]
    choices = [list(_orders(units, comparison.level[units])) for units in blocks]
    order = np.concatenate(blocks)
    back = np.argsort(order)
    whole = np.array([np.concatenate(parts) for parts in product(*choices)], dtype=np.intp)
    yield whole[:, back]


def _orders(units: Codes, level: Codes) -> Iterator[Codes]:
    """Each assignment of `units` to the places of `level`, those within a level not told apart."""
    present = np.unique(level)
    places = [np.flatnonzero(level == one) for one in present]
    for parts in _splits(tuple(units), [len(place) for place in places]):
        found = np.empty(len(units), dtype=np.intp)
        for place, part in zip(places, parts, strict=True):
            found[place] = part
        yield found


def _splits(units: tuple[int, ...], sizes: list[int]) -> Iterator[list[tuple[int, ...]]]:
    if len(sizes) == 1:
        yield [units]
        return
    for first in combinations(units, sizes[0]):
        rest = tuple(unit for unit in units if unit not in first)
        for others in _splits(rest, sizes[1:]):
            yield [first, *others]


def _drawn_orders(comparison: Comparison, count: int, seed: int) -> Iterator[Codes]:
    rng = np.random.default_rng(seed)
    n = len(comparison.block)
    home = np.argsort(comparison.block, kind="stable")
    back = np.argsort(home)
    size = max(1, CHUNK // n)
    for begin in range(0, count, size):
        keys = rng.random((min(size, count - begin), n)) + comparison.block[home]
        yield home[np.argsort(keys, axis=1)][:, back]
