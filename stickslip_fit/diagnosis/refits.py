"""Refits: the evidence of the likeliest causes, each with its parameters fitted beside all others.

A test knows a cause at few values of its parameters, and the linear part of its effect alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.cause_set import CAUSE_SET_LOG_BAYES_FACTOR, form_cause_set, limit_evidence
from stickslip_fit.diagnosis.extension import (
    Extension,
    SelectedCause,
    fit_causes,
    fit_trial,
    law_causes,
    make_selected,
    try_extension,
)
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL, compute_effects
from stickslip_fit.diagnosis.linearized import ExtendedFit, LinearizedFit
from stickslip_fit.diagnosis.misfit import Misfit
from stickslip_fit.diagnosis.problem import DiagnosisProblem

# Nats of a cause that is refitted before one is named, and the share of the largest evidence that it has.
MIN_REFIT_LOG_BAYES_FACTOR, MIN_REFIT_SHARE = 10.0, 0.3
# Nats that a refit adds to a cause: of 110 in 90 hidden logs two added more, most of them less than one.
MAX_REFIT_GAIN = 15.0
INSIDE_SET = 0.99  # of the nats within which causes make up a set


@dataclass(frozen=True, eq=False)
class Refits:
    """A test whose likeliest causes were refitted.

    Attributes
    ----------
    misfit : Misfit
        With their evidence after the refit.
    starts : dict of str to array
        Values of their parameters then.
    extensions : dict of str to Extension
        Where the noise was re-estimated as well.
    failed : tuple of str
        Causes whose fit failed; the test no longer has them.
    """

    misfit: Misfit
    starts: dict[str, Array]
    extensions: dict[str, Extension]
    failed: tuple[str, ...] = ()

    def extension_with(self, selected: Sequence[SelectedCause]) -> Extension | None:
        """The one with the last of some selected causes, if a refit of it in this form was extended."""
        if getattr(selected[-1].version, "is_restricted", False):
            return None  # of which no refit was made
        known = self.extensions.get(selected[-1].cause)
        n_values = sum(len(one.start) for one in law_causes(selected))
        return known if known is not None and len(known.fit.values) == n_values else None


def refit_likeliest(problem: DiagnosisProblem, selected: Sequence[SelectedCause], misfit: Misfit) -> Refits:
    """The test with the evidence of its likeliest causes after a refit of each.

    The squared residuals that a refit leaves take the place of those that the best trial would leave, at the
    price of the parameters that are no longer the trial's (`_refit_gain`). In a sampled signal the
    likelihoods decide between causes that are refitted, each under the autocorrelation of the noise that it
    leaves.
    """
    evidence, starts = dict(misfit.log_evidence_by_cause), dict[str, Array]()
    extensions: dict[str, Extension] = {}
    failed: list[str] = []
    least = max(MIN_REFIT_SHARE * max(evidence.values(), default=0.0), MIN_REFIT_LOG_BAYES_FACTOR)
    likeliest = misfit.rank_causes(least)[: problem.n_refits]
    # A weak one, whose form hardly matters, is limited to what it can reach within its bounds.
    if not (tried := likeliest or misfit.rank_causes(0.0)[:1]):
        return Refits(misfit, starts, extensions)
    before = problem.linearize_extended(fit_causes(problem, selected))
    of_moments: dict[str, float] = {}
    residuals: dict[str, Array] = {}
    for cause in tried:
        trial = make_selected(misfit, form_cause_set(misfit, cause))
        one = refine_trial(trial, before)
        try:
            fit = fit_trial(problem, [*selected, one])
            after = problem.linearize_extended(fit)
        except np.linalg.LinAlgError:
            failed.append(cause)
            continue
        residuals[cause] = after.residual
        # Not `after.residual`: slopes would take what no value of a parameter within its bounds does.
        left, df = _share_left(misfit, before, after.whiten(fit.residual[:, None])[:, 0])
        gain = _refit_gain(misfit, cause, left, df)
        shape = misfit.best_subspace(cause)
        has_more_forms = len(shape.prior_share) > len(one.start)
        is_penalised = np.isfinite(fit.prior_sd[len(fit.values) - len(one.start) :]).any()
        if left > 0 and not has_more_forms and not is_penalised:
            # No more than the best fit within the bounds; of a smooth cause this one is penalised.
            evidence[cause] = min(evidence[cause], max(-0.5 * df * float(np.log(left)), 0.0))
        if cause not in likeliest:
            continue
        evidence[cause] += gain
        if gain > 0 or one is not trial:
            starts[cause] = fit.values[len(fit.values) - len(one.start) :]
        if problem.autocorrelation is not None and len(likeliest) > 1:
            one = replace(one, start=fit.values[len(fit.values) - len(one.start) :])
            extension = try_extension(problem, [*selected, one], fit)
            if extension is None:
                failed.append(cause)
                continue
            extensions[cause] = extension
            of_moments[cause] = price_moments(extension.fit)
    if extensions:
        noises = [one.problem for one in extensions.values()]
        likelihoods = {cause: penalised_likelihood(one, *noises) for cause, one in extensions.items()}
        highest, best = max(evidence[cause] for cause in likelihoods), max(likelihoods.values())
        # A moment where something else changes, too, is one of fewer: its price alone excludes no cause.
        inside = best - INSIDE_SET * CAUSE_SET_LOG_BAYES_FACTOR
        for cause, value in likelihoods.items():
            likelihoods[cause] = max(value, min(value + of_moments[cause], inside))
        evidence |= {cause: highest + likelihoods[cause] - best for cause in likelihoods}
    evidence = {cause: value for cause, value in evidence.items() if cause not in failed}
    evidence, inconsistent = _compare_sessions(problem, evidence, residuals, extensions)
    left_over = replace(misfit, log_evidence_by_cause=evidence, inconsistent=inconsistent)
    return Refits(left_over, starts, extensions, tuple(failed))


def _compare_sessions(
    problem: DiagnosisProblem,
    evidence: dict[str, float],
    residuals: Mapping[str, Array],
    extensions: Mapping[str, Extension],
) -> tuple[dict[str, float], tuple[str, ...]]:
    """The evidence of causes, that of rivals limited where these are no less likely, neither being right.

    `residuals` are those that a refit of each leaves.
    """
    if len(residuals) < 2:
        return evidence, ()
    best = max(residuals, key=evidence.__getitem__)
    if best in extensions:  # in the noise that it leaves
        noise = extensions[best].problem
        residuals = {cause: noise.linearize_extended(one.fit).residual for cause, one in extensions.items()}
    session = pd.factorize(problem.rows["session"].astype(object))[0]
    ahead = {cause: evidence[best] - evidence[cause] for cause in residuals}
    limited = {
        cause: limit_evidence(ahead[cause], residuals[best], own, session)
        for cause, own in residuals.items()
        if ahead[cause] > 0
    }
    inconsistent = tuple(
        cause for cause in limited if limited[cause] < min(ahead[cause], CAUSE_SET_LOG_BAYES_FACTOR)
    )
    return evidence | {cause: evidence[best] - limited[cause] for cause in inconsistent}, inconsistent


def penalised_likelihood(law: Extension, *others: DiagnosisProblem) -> float:
    """Log likelihood of laws with causes, less what the Bayesian information criterion takes.

    It counts the causes' parameters, of those with a prior only what the data determine, and a moment of
    sudden change twice, which is one of as many as there are rows (N. R. Zhang and D. O. Siegmund, Biometrics
    63:22, 2007). The coefficients of the noise are no part of the law. The noise of a sampled signal is known
    less closely than laws differ: of its own and that of `others`, the likeliest counts.
    """
    problem, fit = law.problem, law.fit
    determined = 1.0 - np.diag(fit.covariance) / fit.prior_sd**2
    price = 0.5 * float(np.sum(determined)) * float(np.log(len(problem)))
    if problem.autocorrelation is None:
        likelihood = problem.log_likelihood(fit)
    else:
        likelihood = max(_profile_likelihood(noise, fit) for noise in (problem, *others))
    return likelihood - price - price_moments(fit)


def advantage(one: Extension, other: Extension) -> float:
    """By how many nats the first of two laws of the same rows is likelier, both penalised."""
    return penalised_likelihood(one, other.problem) - penalised_likelihood(other, one.problem)


def _profile_likelihood(noise: DiagnosisProblem, fit: ExtendedFit) -> float:
    """Log likelihood of laws with causes in the noise of a problem, its size the likeliest."""
    assert noise.autocorrelation is not None
    whitened, n = noise.autocorrelation.whiten(fit.residual / noise.scale), len(fit.residual)
    mean_square = max(float(np.mean(whitened**2)), float(np.finfo(float).tiny))
    spread = float(np.sum(np.log(noise.scale))) + 0.5 * n * (1.0 + float(np.log(mean_square)))
    return noise.autocorrelation.log_determinant - spread


def price_moments(fit: ExtendedFit) -> float:
    """What moments of sudden changes take in a fit, beyond what any other parameter does."""
    causes = getattr(fit.parts[0].law, "causes", ())
    moments = sum(parameter.sudden for cause in causes for parameter in cause.parameters)
    return 0.5 * moments * float(np.log(len(fit.residual)))


def refine_trial(one: SelectedCause, before: LinearizedFit) -> SelectedCause:
    """A cause whose start values are the best of its finer trials, if it has any with one size."""
    if (
        not len(one.start)
        or one.version.combine_trials
        or not len(trials := one.version.finer_trials(before.rows, one.start))
    ):
        return one
    effects = compute_effects(before, one.version, trials)
    length = np.sqrt(np.sum(effects**2, axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        explained = np.where(length > EFFECT_TOL, before.residual @ effects / length, 0.0)
    return replace(one, start=trials[int(np.argmax(explained))])


def _share_left(misfit: Misfit, before: LinearizedFit, after: Array) -> tuple[float, int]:
    """Squared residuals after a refit, (n,), over those before it, and the degrees of freedom of the latter.

    Of both without the other forms of causes in the law, if the test was without them.
    """
    residuals, df = np.stack([before.residual, after], axis=1), before.df
    if misfit.basis is not None and misfit.basis.shape[1] > before.basis.shape[1]:
        residuals = residuals - misfit.basis @ (misfit.basis.T @ residuals)
        df = len(residuals) - misfit.basis.shape[1]
    first, last = np.sum(residuals**2, axis=0)
    return float(last / first), df


def _refit_gain(misfit: Misfit, cause: str, left: float, df: int) -> float:
    """By how many nats a refit that leaves this share of the squared residuals is likelier than a trial.

    Each parameter that the trials had on a grid is now known more closely than the grid's spacing: a gain of
    2 x per parameter means that the spacing is sqrt(2 x) standard errors, of which the prior takes its share.
    """
    shape = misfit.best_subspace(cause)
    whole = misfit.residual @ misfit.residual
    explained = float(np.sum(shape.coefficients(misfit.residual) ** 2) / whole)
    if not (np.isfinite(left) and 0.0 < left < 1.0 - explained):
        return 0.0
    gain = 0.5 * df * float(np.log((1.0 - explained) / left))
    on_grid = max(len(shape.version.start_values) - len(shape.prior_share), 0)
    return gain - 0.5 * on_grid * float(np.log1p(2.0 * gain / max(on_grid, 1)))
