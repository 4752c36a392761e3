"""CauseSet: the causes that one test of the residuals leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit

CAUSE_SET_LOG_BAYES_FACTOR = 3.0  # nats below the best; the set holds the true cause in 95 of 100 logs
PRIOR_NULL = 0.5


@dataclass(frozen=True)
class CauseSet:
    """The causes that one test of the residuals leaves.

    Attributes
    ----------
    cause : str
        Likeliest, or ``unknown``.
    rivals : tuple of str
        Other causes within `CAUSE_SET_LOG_BAYES_FACTOR` of it.
    probability : dict of str to float
        Of each cause and ``unknown``, if at most one is at work.
    """

    cause: str
    rivals: tuple[str, ...]
    probability: dict[str, float]


def form_cause_set(misfit: Misfit, chosen: str | None = None) -> CauseSet:
    """The best cause, or the `chosen` one, and its rivals."""
    evidence = misfit.log_evidence_by_cause
    known = {cause: value for cause, value in evidence.items() if cause != UNKNOWN}
    best = max(known, key=lambda cause: known[cause]) if known else UNKNOWN
    if known and evidence.get(UNKNOWN, -np.inf) > known[best]:
        best = UNKNOWN
    best = chosen or best
    rivals: tuple[str, ...] = ()
    if best != UNKNOWN:
        floor = known[best] - CAUSE_SET_LOG_BAYES_FACTOR
        close = [cause for cause, value in known.items() if cause != best and value > floor]
        rivals = tuple(sorted(close, key=lambda cause: -known[cause]))
    probability = cause_probabilities(evidence)
    if chosen is not None:
        probability = {cause: p * (cause in (best, *rivals)) for cause, p in probability.items()}
        total = sum(probability.values())
        probability = {cause: p / total if total > 0 else 0.0 for cause, p in probability.items()}
    return CauseSet(best, rivals, probability)


def cause_probabilities(evidence: dict[str, float], null: float = PRIOR_NULL) -> dict[str, float]:
    """Posterior of each cause if at most one is at work; `null` is the prior probability of none."""
    prior = (1.0 - null) / max(len(evidence), 1)
    logs = np.array([*evidence.values(), 0.0]) + np.log([prior] * len(evidence) + [null])
    weights = np.exp(logs - logs.max())
    return dict(zip(evidence, map(float, (weights / weights.sum())[:-1]), strict=True))
