"""Counts wildly off, found by a fit that doubts every count by its own residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.bayes.expansion import expand
from stickslip_fit.fit.bayes.priors import Prior
from stickslip_fit.fit.bayes.traverses import Traverses

Array = npt.NDArray[np.float64]

WILD = 10.0  # robust standard deviations; heavy tails that are nothing wrong do not reach so far
SUSPECT = 5.0  # in a fit that a wild count may have pulled towards it
NORMAL_OVER_MEDIAN = 1.4826
FREEDOM = 5.0
PASSES = 5


def wild_counts(traverses: Traverses, prior: Prior, residual: Array) -> dict[int, float]:
    """Rows whose counts are wildly off, and by how much.

    Parameters
    ----------
    traverses : Traverses
    prior : Prior
    residual : array, shape (n,)
        Of the posterior means.

    Returns
    -------
    dict of int to float
        Position of each such row, and log(steps) seen over what the other counts lead one to expect.
    """
    if np.all(np.abs(residual) < SUSPECT * prior.repeatability):
        return {}
    doubted = _doubting(traverses, prior)
    # How large a residual is nothing special: as most are, and no less than is believed beforehand.
    size = max(NORMAL_OVER_MEDIAN * float(np.median(np.abs(doubted))), prior.repeatability)
    return {int(index): float(doubted[index]) for index in np.flatnonzero(np.abs(doubted) > WILD * size)}


def _doubting(traverses: Traverses, prior: Prior) -> Array:
    """Residuals, shape (n,), of a fit whose weights fall off as under Student's t; see `StudentT`.

    A wild count pulls its session's parameters so far that its own residual no longer stands out, or that
    its neighbours' do.
    """
    residual, doubt = np.zeros_like(traverses.y), np.zeros_like(traverses.y)
    there = traverses.place >= 0
    for _ in range(PASSES):
        marginal, x, _ = expand(replace(traverses, rounding=traverses.rounding + doubt), prior)
        given = marginal.conditional(x[None])
        z = given.sessions(given.centre)[:, :, 0].T
        residual[traverses.place[there]] = (marginal.response - np.vecdot(marginal.slopes, z[:, None]))[there]
        doubt = residual**2 / FREEDOM
    return residual
