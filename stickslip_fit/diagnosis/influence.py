"""Influence: whether the evidence of a hypothesis rests on one or two rows.

The most influential rows are left out exactly: an indicator of each is projected out, as if it had a
parameter of its own (R. D. Cook and S. Weisberg, Residuals and Influence in Regression, 1982, ch. 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.evidence import batch_hypotheses
from stickslip_fit.diagnosis.hypotheses import Hypothesis, make_hypothesis
from stickslip_fit.diagnosis.linearized import MAX_LEVERAGE, LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import Misfit
from stickslip_fit.estimation.result import OUTLYING_SD

MAX_INFLUENTIAL = 2  # rows
MIN_SHARE_LEFT = 0.2  # of the log Bayes factor, without the influential rows


@dataclass(frozen=True, eq=False)
class Support:
    """What the evidence of a cause rests on.

    Attributes
    ----------
    too_narrow : bool
        Whether the evidence vanishes without its most influential rows.
    outlying : array of int
        Those of them that are outliers, where it does.
    """

    too_narrow: bool
    outlying: IntArray


def assess_support(linearized: LinearizedFit, misfit: Misfit, cause: str) -> Support:
    """The evidence of a cause with and without its `MAX_INFLUENTIAL` most influential rows."""
    enough = Support(False, np.zeros(0, dtype=np.intp))
    best = misfit.best_hypothesis(cause)
    if not isinstance(best, Hypothesis):
        return enough
    places = [k for k, one in enumerate(misfit.hypotheses) if one.cause == best.cause]
    before = _mean_evidence(misfit.log_evidence[places])
    residual = misfit.residual
    free = np.maximum(1.0 - linearized.leverage, 1.0 - MAX_LEVERAGE)
    influence = best.explain(residual) * residual / free
    rows = np.argsort(-influence)[:MAX_INFLUENTIAL]
    indicators = np.zeros((len(linearized), len(rows)))
    indicators[rows, np.arange(len(rows))] = 1.0
    left, singular, right = svd(linearized.project(indicators))
    known = singular > 1.0 - MAX_LEVERAGE
    basis = left[:, known]
    smaller = [_leave_out(misfit.hypotheses[k], basis) for k in places]
    remaining, after = [one for one in smaller if one is not None], -np.inf
    if remaining:
        without = (residual - basis @ (basis.T @ residual))[:, None]
        evidence = batch_hypotheses(remaining, linearized.df - basis.shape[1]).log_evidence(without)
        after = _mean_evidence(evidence[:, 0])
    if after >= MIN_SHARE_LEFT * before:
        return enough
    departure = right[known].T @ ((basis.T @ residual) / singular[known])
    return Support(True, rows[np.abs(departure) > OUTLYING_SD])


def _leave_out(hypothesis: Hypothesis | AR1, basis: Array) -> Hypothesis | None:
    """The hypothesis with some further directions, shape (n, k), projected out."""
    assert isinstance(hypothesis, Hypothesis)
    effects = hypothesis.directions * np.sqrt(hypothesis.prior_share)
    return make_hypothesis(hypothesis.cause, hypothesis.version, None, effects - basis @ (basis.T @ effects))


def _mean_evidence(log_evidence: Array) -> float:
    return float(logsumexp(log_evidence)) - float(np.log(len(log_evidence)))
