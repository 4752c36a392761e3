"""How readings scatter about the mean of their cell: normally, and alike in all cells."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.comparison import Codes, compare, shift, sums_of_squares

Array = npt.NDArray[np.float64]
Statistic = Callable[[Array, Codes], Array]
"""Readings, shape (..., n), and the cell of each; the larger, the less the premise holds."""

DRAWS, MOST_NUMBERS = 999, 500_000


def p_value(statistic: Statistic, values: Array, cell: Codes) -> float:
    """Share of normal readings of the same design that hold to the premise as little as these.

    Drawn, not looked up: cells of a few readings each are far from what tables of these statistics are for.
    """
    order = np.argsort(cell, kind="stable")
    null = _null(statistic, tuple(map(int, np.bincount(cell))))
    seen = statistic(values[None, order], cell[order])[0]
    return float((1 + np.sum(null >= seen)) / (1 + len(null)))


def crookedness(values: Array, cell: Codes) -> Array:
    """How far ordered residuals are from normal scores (after Shapiro and Francia)."""
    from scipy.special import ndtri

    n = values.shape[-1]
    scores = ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    ordered = np.sort(residual(values, cell), axis=-1)
    return 1.0 - (ordered @ scores) / np.sqrt(np.sum(ordered**2, axis=-1) * np.sum(scores**2))


def unevenness(values: Array, cell: Codes) -> Array:
    """F of the distances from each cell's median, between cells (Brown and Forsythe)."""
    distance = shift(values)
    for one in np.unique(cell):
        mine = distance[..., cell == one]
        distance[..., cell == one] = np.abs(mine - np.median(mine, axis=-1, keepdims=True))
    return sums_of_squares(distance, compare(cell)).statistic


def residual(values: Array, cell: Codes) -> Array:
    """Values less the mean of their cell, shape (..., n)."""
    values = shift(values)
    share = (cell[:, None] == np.unique(cell)).astype(float)
    return values - (values @ share / share.sum(axis=0)) @ share.T


@cache
def _null(statistic: Statistic, sizes: tuple[int, ...]) -> Array:
    cell = np.repeat(np.arange(len(sizes)), sizes)
    count = max(199, min(DRAWS, MOST_NUMBERS // len(cell)))
    return statistic(np.random.default_rng(0).standard_normal((count, len(cell))), cell)
