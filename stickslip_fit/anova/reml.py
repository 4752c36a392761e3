"""Restricted maximum likelihood for sessions drawn at random, with a fixed difference between directions.

A reading is ``mean[direction] + day[session] + day_direction[session, direction] + replicate``, the last
three random. Counts, means and the scatter within cells are all that the likelihood needs, and each
session's covariance has a closed inverse, so that cost grows linearly with sessions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class CellStatistics:
    """Readings by session and direction.

    Attributes
    ----------
    count, mean : array, shape (sessions, directions)
        The mean is 0 where the count is.
    within : float
        Sum of squares about the cells' means.
    """

    count: Array
    mean: Array
    within: float

    @property
    def complete(self) -> npt.NDArray[np.bool_]:
        """Sessions in which every direction was read, shape (sessions,)."""
        return np.all(self.count > 0, axis=1)

    @property
    def within_freedom(self) -> int:
        """Degrees of freedom of `within`."""
        return int(self.count.sum() - (self.count > 0).sum())


@dataclass(frozen=True)
class Variances:
    """Of day, of day by direction, and of a replicate."""

    day: float
    day_direction: float
    replicate: float


def reml(cells: CellStatistics) -> Variances:
    """Variances at the maximum of the restricted likelihood, each at least 0.

    The maximum may lie where a variance is 0. Each such face is searched by itself, on a logarithmic
    scale, and the best of all is taken, so that no search has to crawl along a bound.

    Parameters
    ----------
    cells : CellStatistics
        With one direction only, day by direction is part of day.

    Examples
    --------
    >>> cells = CellStatistics(np.array([[3.0], [3.0]]), np.array([[0.0], [2.0]]), 4.0)
    >>> found = reml(cells)  # balanced: (MS between - MS within) / 3
    >>> round(found.day, 6), round(found.replicate, 6)
    (1.666667, 1.0)
    """
    faces = ([], [0], [1], [0, 1]) if cells.count.shape[1] > 1 else ([], [0])
    candidates = [ratios for free in faces for ratios in _lowest(cells, free)]
    best = min(candidates, key=lambda ratios: _profile(cells, ratios)[0])
    replicate = _profile(cells, best)[1]
    return Variances(float(best[0] * replicate), float(best[1] * replicate), replicate)


def _lowest(cells: CellStatistics, free: list[int]) -> list[Array]:
    """Where the deviance is lowest with the other ratios 0, from a start on either side."""
    from scipy.optimize import minimize

    def ratios(logarithms: Array) -> Array:
        found = np.zeros(2)
        found[free] = np.exp(np.clip(logarithms, -60.0, 60.0))
        return found

    def deviance(logarithms: Array) -> float:
        return _profile(cells, ratios(logarithms))[0]

    if not free:
        return [np.zeros(2)]
    found = [
        minimize(
            deviance,
            np.full(len(free), start),
            method="Nelder-Mead",
            options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 4000},
        )
        for start in (-1.0, 4.0)
    ]
    return [ratios(each.x) for each in found]


def _profile(cells: CellStatistics, ratios: Array) -> tuple[float, float]:
    """Deviance at ratios of variances to the replicate's, and the replicate's variance that goes with it."""
    present = cells.count > 0
    own = np.where(present, ratios[1] + 1.0 / np.where(present, cells.count, 1.0), 1.0)
    weight = np.where(present, 1.0 / own, 0.0)
    total = 1.0 + ratios[0] * weight.sum(axis=1)
    shared = ratios[0] / total

    information = np.diag(weight.sum(axis=0)) - np.einsum("s,si,sj->ij", shared, weight, weight)
    score = (weight * cells.mean).sum(axis=0) - np.einsum(
        "s,si,s->i", shared, weight, (weight * cells.mean).sum(axis=1)
    )
    residual = np.where(present, cells.mean - np.linalg.solve(information, score), 0.0)
    between = np.sum(weight * residual**2) - np.sum(shared * (weight * residual).sum(axis=1) ** 2)

    freedom = cells.count.sum() - cells.count.shape[1]
    replicate = float((cells.within + between) / freedom)
    logarithm = np.sum(np.log(own[present])) + np.sum(np.log(total)) + np.linalg.slogdet(information)[1]
    return float(freedom * np.log(replicate) + logarithm), replicate
