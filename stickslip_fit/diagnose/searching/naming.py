"""Which cause it is, which others it might as well be, and how likely each is at work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit.diagnose.searching.misfit import UNKNOWN, Misfit

# A cause this much less likely than the best (in nats) is out of the running in 95 of 100 logs.
AS_LIKELY = 3.0
PRIOR_NOTHING = 0.5
# Structure without a name has to be this much likelier than the best cause (nats): any cause's form may be
# a little other than nature's, and what is left of it looks like structure.
IN_DOUBT = 0.0


@dataclass(frozen=True)
class Naming:
    """The verdict of one look at the residuals.

    Attributes
    ----------
    cause : str
        Likeliest, or ``unknown``.
    rivals : tuple of str
        Other causes nearly as likely.
    probability : dict of str to float
        Of each cause and ``unknown``, if one or nothing is at work.
    """

    cause: str
    rivals: tuple[str, ...]
    probability: dict[str, float]


def name(found: Misfit, cause: str | None = None) -> Naming:
    """Name what a misfit shows.

    Parameters
    ----------
    found : Misfit
    cause : str, optional
        Where something else than this look decides.
    """
    evidence = found.by_cause
    causes = {cause: value for cause, value in evidence.items() if cause != UNKNOWN}
    best = max(causes, key=lambda cause: causes[cause]) if causes else UNKNOWN
    if causes and evidence.get(UNKNOWN, -np.inf) > causes[best] + IN_DOUBT:
        best = UNKNOWN
    best = cause or best
    rivals: tuple[str, ...] = ()
    if best != UNKNOWN:
        floor = causes[best] - AS_LIKELY
        close = [cause for cause, value in causes.items() if cause != best and value > floor]
        rivals = tuple(sorted(close, key=lambda cause: -causes[cause]))
    probability = probabilities(evidence)
    if cause is not None:
        probability = {each: value * (each in (best, *rivals)) for each, value in probability.items()}
        known = sum(probability.values())
        probability = {each: value / known if known > 0 else 0.0 for each, value in probability.items()}
    return Naming(best, rivals, probability)


def probabilities(evidence: dict[str, float], nothing: float = PRIOR_NOTHING) -> dict[str, float]:
    """Probability of each cause if at most one is at work; nothing is as likely beforehand as something."""
    each = (1.0 - nothing) / max(len(evidence), 1)
    logs = np.array([*evidence.values(), 0.0]) + np.log([each] * len(evidence) + [nothing])
    weights = np.exp(logs - logs.max())
    return dict(zip(evidence, map(float, (weights / weights.sum())[:-1]), strict=True))
