"""Intervals of variances that hold whether a variance is 0 or not: generalised pivotal quantities.

Each sum of squares over its expectation is chi-square, so that dividing what was seen by draws of chi-square
gives values that its expectation may have; what a variance is of such expectations, it is of their draws
(Weerahandi 1993). A difference below 0 stands for 0, and an interval that begins there says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.reml import CellStatistics

Array = npt.NDArray[np.float64]

DRAWS = 40_000
TAILS = (0.025, 0.975)


@dataclass(frozen=True)
class VarianceIntervals:
    """95 % intervals of variances; `total` is day and day by direction together."""

    day: tuple[float, float]
    day_direction: tuple[float, float]
    replicate: tuple[float, float]
    total: tuple[float, float]


def generalized_pivotal_intervals(cells: CellStatistics, seed: int = 0) -> VarianceIntervals:
    """Intervals from the sessions in which every direction was read, two at least.

    A session's mean over its directions varies by ``day + V / 4`` and the difference between them by
    ``V = 2 day_direction + h replicate``, h being the sum of 1 / count over its cells, here its average.
    Both are exact where all cells have the same count.

    Parameters
    ----------
    cells : CellStatistics
    seed : int, optional
    """
    rng = np.random.default_rng(seed)
    count, mean = cells.count[cells.complete], cells.mean[cells.complete]
    freedom = len(mean) - 1
    replicate = cells.within / rng.chisquare(cells.within_freedom, DRAWS)
    h = float(np.mean(np.sum(1.0 / count, axis=1)))
    middle = _squares(mean.mean(axis=1)) / rng.chisquare(freedom, DRAWS)
    if mean.shape[1] == 1:
        day = _bounds(middle - h * replicate)
        return VarianceIntervals(day, (0.0, 0.0), _bounds(replicate), day)
    across = _squares(mean[:, 1] - mean[:, 0]) / rng.chisquare(freedom, DRAWS)
    return VarianceIntervals(
        _bounds(middle - across / 4),
        _bounds((across - h * replicate) / 2),
        _bounds(replicate),
        _bounds(middle + across / 4 - h * replicate / 2),
    )


def _squares(values: Array) -> float:
    return float(np.sum((values - values.mean()) ** 2))


def _bounds(draws: Array) -> tuple[float, float]:
    low, high = np.maximum(0.0, np.quantile(draws, TAILS))
    return float(low), float(high)
