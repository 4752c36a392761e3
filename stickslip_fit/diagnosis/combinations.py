"""Combinations: causes that show only together, and causes revised with the others in the law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.extension import (
    SelectedCause,
    compute_evidence,
    extend_problem,
    fit_causes,
    make_selected,
)
from stickslip_fit.diagnosis.hypotheses import (
    Hypothesis,
)
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnosis.problem import DiagnosisProblem

# Nats: evidence of a cause to be tried as the first of a pair, and by how much a pair must be likelier than
# unknown structure; the number of causes that are tried.
PAIR_MIN_LOG_BAYES_FACTOR, PAIR_LOG_PENALTY, MAX_PAIR_TRIALS = 3.0, 3.0, 3
# Nats of a cause that is refitted before one is named, and the share of the largest evidence that it has.
MIN_REFIT_LOG_BAYES_FACTOR, MIN_REFIT_SHARE = 10.0, 0.3


def first_of_pair(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], misfit: Misfit
) -> SelectedCause | None:
    """The first of two causes that together are likelier than unknown structure, if there are two.

    The sum of two effects is in the span of neither, so that alone each loses to unknown structure.
    """
    evidence = misfit.log_evidence_by_cause
    causes = [cause for cause in evidence if cause != UNKNOWN and evidence[cause] > PAIR_MIN_LOG_BAYES_FACTOR]
    best, highest = None, evidence[UNKNOWN] + PAIR_LOG_PENALTY
    for cause in sorted(causes, key=lambda cause: -evidence[cause])[:MAX_PAIR_TRIALS]:
        first = make_selected(misfit, form_cause_set(misfit, cause))
        trial, _, linearized = extend_problem(problem, [*selected, first])
        without = [cause, *(one.cause for one in selected)]
        left = compute_evidence(linearized, trial, without).log_evidence_by_cause
        second = max((name for name in left if name != UNKNOWN), key=lambda name: left[name], default=UNKNOWN)
        pair = evidence[cause] + left[second]
        if left[second] > left.get(UNKNOWN, -np.inf) and pair > highest:
            best, highest = first, pair
    return best


def revise_causes(problem: DiagnosisProblem, causes: Sequence[SelectedCause]) -> list[SelectedCause]:
    """Each cause selected again with all the others in the law."""
    revised = list(causes)
    for place in range(len(revised)):
        others = [one for k, one in enumerate(revised) if k != place]
        trial, _, linearized = extend_problem(problem, others)
        misfit = compute_evidence(linearized, trial, [one.cause for one in others])
        misfit, starts = refit_likeliest(trial, others, misfit)
        cause_set = form_cause_set(misfit)
        if cause_set.cause != UNKNOWN:
            revised[place] = replace(make_selected(misfit, cause_set, starts), p_value=causes[place].p_value)
    return revised


def refit_likeliest(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], misfit: Misfit
) -> tuple[Misfit, dict[str, Array]]:
    """The test with the evidence of its likeliest causes after a refit of each, and the values then.

    The squared residuals that a refit leaves take the place of those that the best trial would leave, at the
    price of the parameters that are no longer the trial's (`_refit_gain`). In a sampled signal the likelihoods
    decide between causes that are refitted, each under the autocorrelation of the noise that it leaves.
    """
    evidence, starts = dict(misfit.log_evidence_by_cause), dict[str, Array]()
    least = max(MIN_REFIT_SHARE * max(evidence.values()), MIN_REFIT_LOG_BAYES_FACTOR)
    strong = [cause for cause in evidence if evidence[cause] > least]
    known = sorted((cause for cause in strong if cause != UNKNOWN), key=lambda cause: -evidence[cause])
    likeliest = known[: problem.n_refits] if len(strong) > 1 else []
    if not likeliest:
        return misfit, starts
    before, likelihoods = problem.linearize_extended(fit_causes(problem, selected)), dict[str, float]()
    for cause in likeliest:
        one = make_selected(misfit, form_cause_set(misfit, cause))
        fit = fit_causes(problem, [*selected, one])
        after = problem.linearize_extended(fit)
        left = (after.residual @ after.residual) / (before.residual @ before.residual)
        gain = _refit_gain(misfit, cause, left, before.df)
        if gain > 0:
            evidence[cause] += gain
            starts[cause] = fit.values[len(fit.values) - len(one.start) :]
        if problem.autocorrelation is not None and len(likeliest) > 1:
            one = replace(one, start=starts.get(cause, one.start))
            trial, fit, _ = extend_problem(problem, [*selected, one])
            # Less what the Bayesian information criterion takes for its parameters.
            likelihoods[cause] = trial.log_likelihood(fit) - 0.5 * len(one.start) * np.log(before.df)
    if likelihoods:
        highest, best = max(evidence[cause] for cause in likelihoods), max(likelihoods.values())
        evidence |= {cause: highest + likelihoods[cause] - best for cause in likelihoods}
    return replace(misfit, log_evidence_by_cause=evidence), starts


def _refit_gain(misfit: Misfit, cause: str, left: float, df: int) -> float:
    """By how many nats a refit that leaves this share of the squared residuals is likelier than the best trial.

    Each parameter that the trials had on a grid is now known more closely than the grid's spacing: a gain of
    2 x per parameter means that the spacing is sqrt(2 x) standard errors, of which the prior takes its share.
    """
    shape = misfit.best_hypothesis(cause)
    assert isinstance(shape, Hypothesis)
    whole = misfit.residual @ misfit.residual
    explained = float(np.sum(shape.coefficients(misfit.residual) ** 2) / whole)
    if not (np.isfinite(left) and 0.0 < left < 1.0 - explained):
        return 0.0
    gain = 0.5 * df * float(np.log((1.0 - explained) / left))
    on_grid = max(len(shape.version.start_values) - len(shape.prior_share), 0)
    return gain - 0.5 * on_grid * float(np.log1p(2.0 * gain / max(on_grid, 1)))
