"""Tests of residuals from the cells' means: normality (Shapiro-Francia), equal variances (Brown-Forsythe)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.comparison import Codes, shift

Array = npt.NDArray[np.float64]
Statistic = Callable[[Array, Codes], Array]
"""Of readings, shape (..., n), and the cell of each; the larger, the less the assumption holds."""

DRAWS, MOST_NUMBERS = 999, 500_000


def monte_carlo_p(statistic: Statistic, values: Array, cell: Codes) -> float:
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
        n_resamples=max(199, min(DRAWS, MOST_NUMBERS // len(cell))),
        alternative="greater",
    )
    return float(tested.pvalue)


def shapiro_francia(values: Array, cell: Codes) -> Array:
    """1 - W', of ordered residuals from the cells' means and normal scores."""
    from scipy.special import ndtri

    n = values.shape[-1]
    scores = ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    ordered = np.sort(residual(values, cell), axis=-1)
    return 1.0 - (ordered @ scores) / np.sqrt(np.sum(ordered**2, axis=-1) * np.sum(scores**2))


def brown_forsythe(values: Array, cell: Codes) -> Array:
    """F of the distances from each cell's median, between cells."""
    from scipy.stats import levene

    samples = [values[..., cell == one] for one in np.unique(cell)]
    return np.asarray(levene(*samples, center="median", axis=-1).statistic)


def residual(values: Array, cell: Codes) -> Array:
    """Values less the mean of their cell, shape (..., n)."""
    values = shift(values)
    share = (cell[:, None] == np.unique(cell)).astype(float)
    return values - (values @ share / share.sum(axis=0)) @ share.T
