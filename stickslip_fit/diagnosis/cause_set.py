"""CauseSet: the causes that one test of the residuals leaves."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, log_ndtr

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit

CAUSE_SET_LOG_BAYES_FACTOR = 3.0  # nats below the best; the set holds the true cause in 95 of 100 logs
# A special case of a cause is named if no more than so many times less likely, since its evidence is averaged
# over single joints, too; it alone if so many times likelier.
SPECIAL_CASE_ODDS = 3.0
PRIOR_NULL = 0.5
# Of sessions if one of two causes is right, below which neither counts as that; squared distance, in units of
# the noise, below which two fits are the same in a session.
MAX_INCONSISTENCY_P_VALUE, MIN_DISTANCE = 0.05, 1e-6


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
    by_refit : tuple of str
        The rivals that are as likely by a refit, however different their effects: sessions contradict each
        other on which of the two is right, or another cause makes up for the difference.
    """

    cause: str
    rivals: tuple[str, ...]
    probability: dict[str, float]
    by_refit: tuple[str, ...] = ()

    def with_rivals(self, rivals: Sequence[str]) -> CauseSet:
        """The set with more rivals, as likely by a refit, which share the probability."""
        new = [rival for rival in rivals if rival not in self.rivals]
        share = self.probability.get(self.cause, 0.0) / (1 + len(new))
        return replace(
            self,
            rivals=(*self.rivals, *new),
            probability=self.probability | dict.fromkeys((self.cause, *new), share),
            by_refit=tuple(dict.fromkeys((*self.by_refit, *rivals))),
        )

    def without_rivals(self, names: Collection[str]) -> CauseSet:
        """The set without some rivals, whose probability is the cause's."""
        gone = [rival for rival in self.rivals if rival in names]
        taken = sum(self.probability.get(one, 0.0) for one in (self.cause, *gone))
        return replace(
            self,
            rivals=tuple(rival for rival in self.rivals if rival not in gone),
            probability=self.probability | dict.fromkeys(gone, 0.0) | {self.cause: taken},
            by_refit=tuple(rival for rival in self.by_refit if rival not in gone),
        )


def form_cause_set(misfit: Misfit, chosen: str | None = None) -> CauseSet:
    """The best cause, or the `chosen` one, and its rivals."""
    evidence = misfit.log_evidence_by_cause
    best = chosen or _likeliest_cause(misfit)
    rivals: tuple[str, ...] = ()
    if best != UNKNOWN:
        floor = evidence[best] - CAUSE_SET_LOG_BAYES_FACTOR
        rivals = tuple(misfit.rank_causes(floor, [best]))
    probability = cause_probabilities(evidence)
    if chosen is not None:
        probability = {cause: p * (cause in (best, *rivals)) for cause, p in probability.items()}
        total = sum(probability.values())
        probability = {cause: p / total if total > 0 else 0.0 for cause, p in probability.items()}
    inconsistent = tuple(cause for cause in rivals if cause in misfit.inconsistent)
    return CauseSet(best, rivals, probability, inconsistent)


def _likeliest_cause(misfit: Misfit) -> str:
    """The likeliest cause, or a special case of it that suffices; ``unknown`` where that is likelier."""
    evidence = misfit.log_evidence_by_cause
    ranked = misfit.rank_causes(evidence.get(UNKNOWN, -np.inf))
    if not ranked:
        return UNKNOWN
    least = evidence[ranked[0]] - np.log(SPECIAL_CASE_ODDS)
    special = [one for one in ranked if evidence[one] > least and misfit.special_case_of(one) == ranked[0]]
    return special[0] if special else ranked[0]


def limit_evidence(ahead: float, likelier: Array, other: Array, session: IntArray) -> float:
    """Nats by which one of two fitted causes is likelier, where sessions may show that neither is right.

    If the likelier one is right, the log likelihood ratio of each session has the mean delta^2 / 2 and the
    variance delta^2, delta being the distance between what the two predict there (D. R. Cox, J. R. Stat. Soc.
    B 24:406, 1962). Where sessions contradict that, one of the two may still be nearer to the truth. The odds
    of that follow from the ratio over its standard deviation, which sessions tell by their scatter (Q. H.
    Vuong, Econometrica 57:307, 1989).

    Parameters
    ----------
    ahead : float
        Log likelihood ratio, both penalised.
    likelier, other : array, shape (n,)
        Residuals with either cause in the law, whitened by the same noise.
    session : array of int, shape (n,)
    """
    ratio = np.bincount(session, (other**2 - likelier**2) / 2.0)
    distance = np.bincount(session, (other - likelier) ** 2)
    ratio, distance = ratio[distance > MIN_DISTANCE], distance[distance > MIN_DISTANCE]
    score = float(np.sum((ratio - distance / 2.0) ** 2 / distance))
    if not len(distance) or score <= chdtri(len(distance), MAX_INCONSISTENCY_P_VALUE):
        return ahead
    share = distance / distance.sum()
    variance = max(float(distance.sum()), float(np.sum((ratio - share * ratio.sum()) ** 2)))
    # A form of the other one that the data may bend is nearer than its fit, of which the scatter is known.
    z = max(ahead, float(ratio.sum())) / np.sqrt(variance)
    return min(ahead, float(log_ndtr(z) - log_ndtr(-z)))


def cause_probabilities(evidence: dict[str, float]) -> dict[str, float]:
    """Posterior of each cause if at most one is at work."""
    prior = (1.0 - PRIOR_NULL) / max(len(evidence), 1)
    logs = np.array([*evidence.values(), 0.0]) + np.log([prior] * len(evidence) + [PRIOR_NULL])
    weights = np.exp(logs - logs.max())
    return dict(zip(evidence, map(float, (weights / weights.sum())[:-1]), strict=True))
