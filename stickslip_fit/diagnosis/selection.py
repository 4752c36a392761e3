"""select_causes: forward selection of causes, and the set of causes that the data cannot separate.

Order: estimate the noise, test for outlying counts, then test the residuals and add the best cause
until the p-value is above its share of the false-alarm rate. Afterwards each cause is selected again with
all others in the law. The p-value of the search is the smaller of those of outliers and misfit, each
divided by its share of the rate (`misfit`). A cause set holds every cause with a log Bayes factor above -3
relative to the best. Causes whose largest plausible effect would not be detectable are untestable; logs
with few traverses are not tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.hypotheses import (
    EFFECT_TOL,
    FiniteEffects,
    Hypothesis,
    SessionFit,
    build_candidates,
    compute_changes,
    compute_effects,
    compute_finite_effects,
    compute_session_effects,
    split_sessions,
)
from stickslip_fit.diagnosis.influence import assess_support
from stickslip_fit.diagnosis.linearized import ExtendedFit, LinearizedFit
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, StructureRemoved, compute_misfit, remove_structure
from stickslip_fit.diagnosis.noise import find_outliers
from stickslip_fit.diagnosis.problem import MISFIRE as MISFIRE
from stickslip_fit.diagnosis.problem import DiagnosisProblem

CAUSE_SET_LOG_BAYES_FACTOR = 3.0  # nats below the best; the set holds the true cause in 95 of 100 logs
PRIOR_NULL = 0.5
# Share of the false-alarm rate for outlying counts: their p-values are rarely close to it, those of faint
# effects often are.
OUTLIER_ALPHA_SHARE = 0.25
# Noisy configurations and gross errors are chosen by the same residuals; the misfit test then rejects about
# twice as often (`benchmarks/README.md`).
SELECTION_FACTOR = 2
MAX_CAUSES = 4
MAX_EXCEEDANCES = 50  # bootstrap samples above the statistic, after which a second cause is ruled out
MIN_FORM_SHARE, MAX_FORMS = 0.003, 8  # of the square of all alternative forms; their number
# Nats: evidence of a cause to be tried as the first of a pair, and by how much a pair must be likelier than
# unknown structure; the number of causes that are tried.
PAIR_MIN_LOG_BAYES_FACTOR, PAIR_LOG_PENALTY, MAX_PAIR_TRIALS = 3.0, 3.0, 3
# Nats of a cause that is refitted before one is named, and the share of the largest evidence that it has.
MIN_REFIT_LOG_BAYES_FACTOR, MIN_REFIT_SHARE = 10.0, 0.3
MIN_TESTABLE_STRENGTH = 3.0  # whitened norm of the effect at the largest plausible size
MIN_DF = 10
EXACT_TOL = 1e-3  # standard deviations


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


@dataclass(frozen=True, eq=False)
class SelectedCause:
    """A selected cause, or unknown structure, and the test that selected it.

    Attributes
    ----------
    cause : str
    version : object or None
        As it acts in this log; None for unknown structure and outlying counts.
    start : array, shape (q,)
        Start values of its parameters.
    cause_set : CauseSet
    misfit : Misfit or None
        None for outlying counts, which have no shape.
    p_value : float
    """

    cause: str
    version: Any
    start: Array
    cause_set: CauseSet
    misfit: Misfit | None
    p_value: float


@dataclass(frozen=True, eq=False)
class Selection:
    """The result of the selection.

    Attributes
    ----------
    problem : DiagnosisProblem
        Without outlying counts, the noise estimated under `fit`.
    outliers : array of int
        Outlying rows of the problem that was given.
    selected : tuple of SelectedCause
        In the order of selection.
    first_misfit, last_misfit : Misfit
        Tests of the baseline, and of the law with all selected causes.
    p_value : float
        Of the whole search.
    fit : ExtendedFit
        The baseline with `law_causes` in it.
    linearized : LinearizedFit
        The residuals under `fit`.
    influential : array of int
        Rows of `problem`, outliers each, without which there is no evidence of the cause that the search
        would have selected next.
    """

    problem: DiagnosisProblem
    outliers: IntArray
    selected: tuple[SelectedCause, ...]
    first_misfit: Misfit
    last_misfit: Misfit
    p_value: float
    fit: ExtendedFit
    linearized: LinearizedFit
    influential: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def law_causes(self) -> list[SelectedCause]:
        """The causes in `fit`, in its order."""
        return _law_causes(self.selected)

    @property
    def slices(self) -> list[slice]:
        """Where the parameters of each of `law_causes` stand in `fit.values`."""
        ends = np.cumsum([0, *(len(selected.start) for selected in self.law_causes)]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]


def _law_causes(selected: Sequence[SelectedCause]) -> list[SelectedCause]:
    return [one for one in selected if one.version is not None]


def select_causes(
    problem: DiagnosisProblem, alpha: float, n_bootstrap: int, rng: np.random.Generator
) -> Selection:
    """Select the causes that a log shows, at a false-alarm rate `alpha` of the whole search.

    `n_bootstrap` is the number of samples of noise alone for each test.
    """
    effects = compute_finite_effects(problem.linearize(), problem.causes)
    problem, linearized, residual = _reestimate_noise(problem, effects)
    test = find_outliers(linearized, residual, problem.noise_group, n_bootstrap, rng)
    outlier_p_value = min(1.0, test.p_value / OUTLIER_ALPHA_SHARE)
    outliers = np.zeros(0, dtype=np.intp)
    misfires: list[SelectedCause] = []
    if test.p_value < OUTLIER_ALPHA_SHARE * alpha and len(test.rows):
        outliers = test.rows
        problem = problem.without_rows(outliers).with_autocorrelation()
        effects = compute_finite_effects(problem.linearize(), problem.causes)
        problem, linearized, _ = _reestimate_noise(problem, effects)
        misfires = [select_outliers(problem, outlier_p_value)]
    first = last = assess_residuals(linearized, problem, n_bootstrap, rng, effects=effects)
    del effects  # of the baseline's laws; as large as all hypotheses
    p_value = min(outlier_p_value, first.p_value / (1.0 - OUTLIER_ALPHA_SHARE))
    fit, level = problem.fit_extended(), allocate_alpha(alpha)
    selected: list[SelectedCause] = []
    influential = outliers[:0]
    while last.p_value < level and len(selected) < MAX_CAUSES:
        last, starts = _refit_likeliest(problem, selected, last)
        following = _make_selected(last, form_cause_set(last), starts)
        if following.cause == UNKNOWN:
            following = _first_of_pair(problem, selected, last) or following
        support = assess_support(linearized, last, following.cause)
        if support.too_narrow:
            influential = support.outlying
            following = _make_selected(last, form_cause_set(last, UNKNOWN))
        selected.append(following)
        if following.cause == UNKNOWN:
            break
        problem, fit, linearized = extend_problem(problem, selected)
        last = assess_residuals(
            linearized, problem, n_bootstrap, rng, [one.cause for one in selected], MAX_EXCEEDANCES
        )
    causes = _law_causes(selected)
    if len(causes) > 1:
        revised = _revise_causes(problem, causes)
        if [one.cause for one in revised] != [one.cause for one in causes]:
            problem, fit, linearized = extend_problem(problem, revised)
        selected = [*revised, *(one for one in selected if one.version is None)]
    everything = (*misfires, *selected)
    return Selection(problem, outliers, everything, first, last, p_value, fit, linearized, influential)


def select_outliers(problem: DiagnosisProblem, p_value: float) -> SelectedCause:
    """Outlying rows as a selected cause, which has no shape."""
    name = problem.outlier_cause
    return SelectedCause(name, None, np.zeros(0), CauseSet(name, (), {}), None, p_value)


def allocate_alpha(alpha: float) -> float:
    """The share of a false-alarm rate that is left for the misfit test."""
    return min((1.0 - OUTLIER_ALPHA_SHARE) * alpha, 1.0)


def assess_residuals(
    linearized: LinearizedFit,
    problem: DiagnosisProblem,
    n_bootstrap: int,
    rng: np.random.Generator,
    without: Sequence[str] = (),
    max_exceedances: int | None = None,
    effects: Sequence[FiniteEffects] | None = None,
) -> Misfit:
    """The misfit test over every cause except some, and over the unstructured alternatives.

    `effects` are those of the causes, if they are known already from another fit with the same laws and rows.
    """
    if effects is None:
        causes = [cause for cause in problem.causes if cause.name not in without]
        effects = compute_finite_effects(linearized, causes)
    factor = SELECTION_FACTOR if problem.trimmed or np.any(problem.noise_ratio != 1) else 1
    hypotheses = [*build_candidates(linearized, effects), *problem.alternatives(linearized)]
    return compute_misfit(linearized, hypotheses, factor * n_bootstrap, rng, max_exceedances, factor)


def extend_problem(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause]
) -> tuple[DiagnosisProblem, ExtendedFit, LinearizedFit]:
    """The problem with causes in its laws: noise re-estimated, the fit, and its residuals."""
    causes = _law_causes(selected)
    start = np.concatenate([np.zeros(0), *(one.start for one in causes)])
    versions = [one.version for one in causes]
    fit = problem.fit_extended(versions, start)
    correlated = problem.with_autocorrelation(fit)
    if correlated is not problem:
        problem, fit = correlated, correlated.fit_extended(versions, fit.values)

    def linearize(problem: DiagnosisProblem) -> LinearizedFit:
        plain = problem.linearize_extended(fit)
        forms = [alternative_forms(plain, one) for one in causes]
        return problem.linearize_extended(fit, np.concatenate(forms, axis=1)) if forms else plain

    linearized = linearize(problem)
    left = StructureRemoved(linearized.residual, np.zeros(len(problem)))
    problem = problem.with_noise(problem.estimate_noise(linearized, left))
    if problem.autocorrelation is not None:  # the noise of a signal changes much once its cause is in the law
        fit = problem.fit_extended(versions, fit.values)
    return problem, fit, linearize(problem)


def settle_noise(selection: Selection) -> Selection:
    """The selection with its estimate of the noise's autocorrelation, if there is any, final."""
    noise = selection.problem.autocorrelation
    if noise is None:
        return selection
    return replace(selection, problem=replace(selection.problem, autocorrelation=noise.settle()))


def refit_selection(selection: Selection, selected: tuple[SelectedCause, ...]) -> Selection:
    """The selection with other causes, its noise, fit and residuals those of the law with them."""
    if _law_causes(selected):
        problem, fit, linearized = extend_problem(selection.problem, selected)
    else:
        problem, linearized, _ = _reestimate_noise(selection.problem)
        fit = problem.fit_extended()
    return replace(selection, problem=problem, selected=selected, fit=fit, linearized=linearized)


def _first_of_pair(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], misfit: Misfit
) -> SelectedCause | None:
    """The first of two causes that together are likelier than unknown structure, if there are two.

    The sum of two effects is in the span of neither, so that alone each loses to unknown structure.
    """
    evidence = misfit.log_evidence_by_cause
    causes = [cause for cause in evidence if cause != UNKNOWN and evidence[cause] > PAIR_MIN_LOG_BAYES_FACTOR]
    best, highest = None, evidence[UNKNOWN] + PAIR_LOG_PENALTY
    for cause in sorted(causes, key=lambda cause: -evidence[cause])[:MAX_PAIR_TRIALS]:
        first = _make_selected(misfit, form_cause_set(misfit, cause))
        trial, _, linearized = extend_problem(problem, [*selected, first])
        without = [cause, *(one.cause for one in selected)]
        left = _compute_evidence(linearized, trial, without).log_evidence_by_cause
        second = max((name for name in left if name != UNKNOWN), key=lambda name: left[name], default=UNKNOWN)
        pair = evidence[cause] + left[second]
        if left[second] > left.get(UNKNOWN, -np.inf) and pair > highest:
            best, highest = first, pair
    return best


def _revise_causes(problem: DiagnosisProblem, causes: Sequence[SelectedCause]) -> list[SelectedCause]:
    """Each cause selected again with all the others in the law."""
    revised = list(causes)
    for place in range(len(revised)):
        others = [one for k, one in enumerate(revised) if k != place]
        trial, _, linearized = extend_problem(problem, others)
        misfit = _compute_evidence(linearized, trial, [one.cause for one in others])
        misfit, starts = _refit_likeliest(trial, others, misfit)
        cause_set = form_cause_set(misfit)
        if cause_set.cause != UNKNOWN:
            revised[place] = replace(_make_selected(misfit, cause_set, starts), p_value=causes[place].p_value)
    return revised


def _reestimate_noise(
    problem: DiagnosisProblem, effects: Sequence[FiniteEffects] | None = None
) -> tuple[DiagnosisProblem, LinearizedFit, Array]:
    """The problem with re-estimated noise, its fit, and its residuals without structure.

    The residuals are in units of the largest noise that their configuration may have. `effects` are as of
    `assess_residuals`.
    """
    linearized = problem.linearize()
    misfit = _compute_evidence(linearized, problem, effects=effects)
    left = remove_structure(linearized.residual, misfit.hypotheses, misfit.log_evidence)
    noise = problem.estimate_noise(linearized, left)
    problem = problem.with_noise(noise)
    max_ratio = noise.heteroscedasticity.max_ratio / problem.noise_ratio
    return problem, problem.linearize(), left.residual * linearized.scale / problem.scale / max_ratio


def _compute_evidence(
    linearized: LinearizedFit,
    problem: DiagnosisProblem,
    without: Sequence[str] = (),
    effects: Sequence[FiniteEffects] | None = None,
) -> Misfit:
    """As `assess_residuals`, without a p-value."""
    return assess_residuals(linearized, problem, 0, np.random.default_rng(0), without, effects=effects)


def _refit_likeliest(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], misfit: Misfit
) -> tuple[Misfit, dict[str, Array]]:
    """The test with the evidence of its likeliest causes after a refit of each, and the values then.

    The squared residuals that a refit leaves take the place of those that the best trial would leave. Between
    causes that are refitted the likelihoods decide, each under the noise that it leaves.
    """
    evidence, starts = dict(misfit.log_evidence_by_cause), dict[str, Array]()
    least = max(MIN_REFIT_SHARE * max(evidence.values()), MIN_REFIT_LOG_BAYES_FACTOR)
    strong = (cause for cause in evidence if cause != UNKNOWN and evidence[cause] > least)
    likeliest = sorted(strong, key=lambda cause: -evidence[cause])[: problem.n_refits]
    if not likeliest:
        return misfit, starts
    before, likelihoods = problem.linearize_extended(_fit_causes(problem, selected)), dict[str, float]()
    for cause in likeliest:
        shape = misfit.best_hypothesis(cause)
        assert isinstance(shape, Hypothesis)
        one = _make_selected(misfit, form_cause_set(misfit, cause))
        fit = _fit_causes(problem, [*selected, one])
        after = problem.linearize_extended(fit)
        left = (after.residual @ after.residual) / (before.residual @ before.residual)
        whole = misfit.residual @ misfit.residual
        explained = float(np.sum(shape.coefficients(misfit.residual) ** 2) / whole)
        if np.isfinite(left) and left < 1.0 - explained:
            evidence[cause] += 0.5 * before.df * float(np.log((1.0 - explained) / left))
            starts[cause] = fit.values[len(fit.values) - len(one.start) :]
        if len(likeliest) > 1:
            one = replace(one, start=starts.get(cause, one.start))
            trial, fit, _ = extend_problem(problem, [*selected, one])
            # Less what the Bayesian information criterion takes for its parameters.
            likelihoods[cause] = trial.log_likelihood(fit) - 0.5 * len(one.start) * np.log(before.df)
    if likelihoods:
        highest, best = max(evidence[cause] for cause in likelihoods), max(likelihoods.values())
        evidence |= {cause: highest + likelihoods[cause] - best for cause in likelihoods}
    return replace(misfit, log_evidence_by_cause=evidence), starts


def _fit_causes(problem: DiagnosisProblem, selected: Sequence[SelectedCause]) -> ExtendedFit:
    causes = _law_causes(selected)
    start = np.concatenate([np.zeros(0), *(one.start for one in causes)])
    return problem.fit_extended([one.version for one in causes], start)


def _make_selected(
    misfit: Misfit, cause_set: CauseSet, starts: Mapping[str, Array] | None = None
) -> SelectedCause:
    shape = misfit.best_hypothesis(cause_set.cause)
    p_value = min(1.0, misfit.p_value / (1.0 - OUTLIER_ALPHA_SHARE))
    start = np.zeros(0)
    if isinstance(shape, Hypothesis) and shape.version is not None:
        start = np.array(shape.version.start_values)
        if shape.values is not None:
            # Of the estimated size and sign: a fit rarely crosses zero, where it has a local minimum.
            size = float(shape.coefficients(misfit.residual)[0]) / shape.length
            first = start[0] + (shape.values[0] - start[0]) * size
            start = np.concatenate([[first], shape.values[1:]])
    start = (starts or {}).get(cause_set.cause, start)
    return SelectedCause(cause_set.cause, shape.version, start, cause_set, misfit, p_value)


def alternative_forms(linearized: LinearizedFit, selected: SelectedCause) -> Array:
    """Effects of a selected cause in other forms than the one fitted, whitened, shape (n, m).

    These are its other shapes, and the square and the cube of its own effect, for a nonlinear dependence.
    """
    misfit = selected.misfit
    assert misfit is not None
    effect = compute_changes(linearized, selected.version, selected.start[None])
    powers = linearized.whiten(np.concatenate([effect**2, effect**3], axis=1))
    length = np.linalg.norm(powers, axis=0)
    shapes = _other_shapes(linearized, selected, misfit)
    columns = np.concatenate([*shapes, powers / np.where(length > 0, length, 1.0)], axis=1)
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, singular**2 > MIN_FORM_SHARE * np.sum(singular**2)][:, :MAX_FORMS]


def _other_shapes(linearized: LinearizedFit, selected: SelectedCause, misfit: Misfit) -> list[Array]:
    """Directions of all shapes of a selected cause's version; each shape (n, m)."""
    if linearized.noise_filter is None:
        return [
            one.directions
            for one in misfit.hypotheses
            if isinstance(one, Hypothesis) and one.cause == selected.cause and one.version == selected.version
        ]
    # The directions of the test are whitened by the filter that the noise had then.
    effects = [
        compute_effects(linearized, version, trials)
        for version, trials in selected.version.trials(linearized.rows)
        if version == selected.version
    ]
    lengths = [np.linalg.norm(columns, axis=0) for columns in effects]
    return [
        columns[:, length > EFFECT_TOL] / length[length > EFFECT_TOL]
        for columns, length in zip(effects, lengths, strict=True)
    ]


def predict_departures(selection: Selection, problem: DiagnosisProblem, outliers: IntArray) -> Array:
    """Departure of outlying rows from the fit without them; 0 where that has no values for them."""
    departure = np.zeros(len(problem))
    for part, fitted in zip(problem.parts, selection.fit.parts, strict=True):
        blocks, first = np.unique(fitted.block, return_index=True)
        known = np.isin(part.rows, outliers) & np.isin(part.block, blocks)
        values = fitted.values[first[np.searchsorted(blocks, part.block[known])]]
        rows = part.rows[known]
        if len(rows):
            departure[rows] = problem.responses[rows] - fitted.law.predict(problem.rows.iloc[rows], values)
    return departure[outliers]


def find_untestable(problem: DiagnosisProblem, linearized: LinearizedFit) -> dict[str, str]:
    """Causes that would not be detectable even at their largest plausible size, with the reason."""
    untestable, sessions = {}, split_sessions(linearized)
    data = "log" if is_log(linearized) else "table"
    for cause in problem.causes:
        strength = largest_strength(cause, linearized, sessions, problem.outlier_cause)
        if strength < EFFECT_TOL:
            untestable[cause.name] = (
                "this log's traverses show nothing of it, once each session is recalibrated"
                if is_log(linearized)
                else "this table shows nothing of it, once the law is recalibrated to each session"
            )
        elif strength < MIN_TESTABLE_STRENGTH:
            shown = min(strength, MIN_TESTABLE_STRENGTH - 0.1)
            untestable[cause.name] = (
                f"even at its largest plausible size its strength in this {data} would be {shown:.1f}, "
                f"less than {MIN_TESTABLE_STRENGTH:.0f}"
            )
    return untestable


def largest_strength(
    cause: Any, linearized: LinearizedFit, sessions: Mapping[str, SessionFit], outlier_cause: str = MISFIRE
) -> float:
    """Whitened norm of a cause's largest plausible effect, beyond what calibration absorbs."""
    if cause.name == outlier_cause:
        return np.inf
    largest = cause.largest_plausible()
    strengths = [0.0]
    for version, values in [(cause, np.array(largest))] if largest else cause.trials(linearized.rows):
        sizes = values if largest else values * np.r_[cause.max_trial_factor, np.ones(values.shape[1] - 1)]
        if version.session:
            effects = compute_session_effects(sessions[version.session], version, sizes)
        else:
            effects = compute_effects(linearized, version, sizes)
        strengths.append(float(np.linalg.norm(effects, axis=0).max()))
    return max(strengths)


def explain_too_small(linearized: LinearizedFit) -> str | None:
    """Why a log is too small for a test, and what would suffice; None where it is not."""
    if linearized.df >= MIN_DF:
        if fits_exactly(linearized):
            return "the law fits every row to within rounding: there is no scatter to compare anything with"
        return None
    rows, parameters = len(linearized), linearized.basis.shape[1]
    if not is_log(linearized):
        return (
            f"too few rows to test: {rows} for the law's {parameters} parameters, and {MIN_DF} more than "
            f"those are needed; add {MIN_DF - linearized.df} in the same sessions"
        )
    return (
        f"too few traverses to test: {rows} for the baseline's {parameters} parameters, and {MIN_DF} more "
        f"than those are needed; add {MIN_DF - linearized.df} in the same sessions and directions, "
        "replicates or new configurations"
    )


def fits_exactly(linearized: LinearizedFit) -> bool:
    """Whether a law leaves next to nothing of its noise."""
    return len(linearized) > 0 and float(np.abs(linearized.residual).max()) < EXACT_TOL


def is_log(linearized: LinearizedFit) -> bool:
    """Whether the laws are of joints, and the rows traverses."""
    return any(hasattr(part.law, "joint") for part in linearized.parts)


def empty_selection(problem: DiagnosisProblem) -> Selection:
    """The selection of a log that is too small for a test."""
    misfit = Misfit(np.zeros(0), (), np.zeros(0), {}, 1.0, np.zeros(0))
    return Selection(
        problem,
        np.zeros(0, dtype=np.intp),
        (),
        misfit,
        misfit,
        1.0,
        problem.fit_extended(),
        problem.linearize(),
    )
