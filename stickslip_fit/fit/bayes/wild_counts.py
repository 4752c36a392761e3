"""Counts wildly off, found by a fit that doubts every count by its own residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.bayes.expansion import expand
from stickslip_fit.fit.bayes.priors import Prior
from stickslip_fit.fit.bayes.traverses import Traverses
from stickslip_fit.fit.remark import Remark

Array = npt.NDArray[np.float64]

WILD = 10.0  # robust standard deviations; heavy tails that are nothing wrong do not reach so far
SUSPECT = 5.0  # in a fit that a wild count may have pulled towards it
NORMAL_OVER_MEDIAN = 1.4826
FREEDOM = 5.0
PASSES = 5


def wild_counts(traverses: Traverses, prior: Prior, residual: Array) -> list[Remark]:
    """Name every count that is wildly off, with what the others lead one to expect.

    Parameters
    ----------
    traverses : Traverses
    prior : Prior
    residual : array, shape (n,)
        Of any fit: where all are small, no count is off, and nothing needs to be done.

    Returns
    -------
    list of Remark
    """
    if _is_fine(residual, prior):
        return []
    doubted = _doubting(traverses, prior)
    # How large a residual is nothing special: as most are, and no less than is believed beforehand.
    size = max(NORMAL_OVER_MEDIAN * float(np.median(np.abs(doubted))), prior.repeatability)
    wild = np.abs(doubted) > WILD * size
    rows = traverses.rows[wild].assign(expected=np.exp(traverses.y - doubted)[wild])
    joint = traverses.law.joint
    return [
        Remark(
            "wild_count", joint, str(row.direction), str(row.session), prior.names,
            f"joint {joint}, direction {row.direction}, session {row.session}: the count {row.steps} of "
            f"{row.time} is wildly off, {row.expected:.0f} were to be expected; correct it, or exclude the "
            "traverse",
        )
        for row in rows.itertuples()
    ]  # fmt: skip


def _is_fine(residual: Array, prior: Prior) -> bool:
    return bool(np.all(np.abs(residual) < SUSPECT * prior.repeatability))


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
        if _is_fine(residual, prior):
            break
        doubt = residual**2 / FREEDOM
    return residual
