"""The laws extended by selected causes: their fit, the noise it leaves, and the test of its residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array
from stickslip_fit.causes.friction import StageCause
from stickslip_fit.causes.periodic import PeriodicTime
from stickslip_fit.causes.proposed import CarryOverTerm, SmoothTerm
from stickslip_fit.causes.table_terms import PREDICTION
from stickslip_fit.diagnosis.alternatives import attribute_to_causes
from stickslip_fit.diagnosis.cause_set import CAUSE_SET_LOG_BAYES_FACTOR, CauseSet
from stickslip_fit.diagnosis.evidence import batch_hypotheses
from stickslip_fit.diagnosis.hypotheses import (
    EFFECT_TOL,
    FiniteEffects,
    Hypothesis,
    acts_on,
    build_candidates,
    compute_changes,
    compute_effects,
    compute_finite_effects,
    compute_version_effects,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import ExtendedFit, LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import (
    UNKNOWN,
    Misfit,
    StructureRemoved,
    compute_p_value,
    drop_single_rows,
    may_bend,
    remove_structure,
    weigh_evidence,
)
from stickslip_fit.diagnosis.noise import NoiseEstimate
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.logs.history import add_departures

# Share of the false-alarm rate for outlying counts: their p-values are rarely close to it, those of faint
# effects often are.
OUTLIER_ALPHA_SHARE = 0.25
# Noisy configurations and gross errors are chosen by the same residuals; the misfit test then rejects about
# twice as often (`benchmarks/README.md`).
SELECTION_FACTOR = 2
MIN_OPEN = 0.5  # whitened norm of what lambda leaves open in an effect
LOG_STRENGTHS = (0.0, 8.0)  # logarithm of the least and the greatest strength of a smooth effect
MIN_FINER = 10.0  # nats, of a cause that is looked at more closely
MIN_FORM_SHARE, MAX_FORMS = 0.003, 8  # of the square of all alternative forms; their number without ties
FORM_TIE = 0.01  # of a square, by which two that rounding or noise alone orders may differ
MAX_SHAPES = 300  # of one kind, whose neighbours resemble each other
# Of a proposal: singular values of effects of norm 1, and rows for each of them.
MIN_FORM_LENGTH, ROWS_PER_FORM = 0.03, 6
MAX_STRUCTURES = 3  # that are removed from residuals before their noise counts as uneven
DEPARTURE_PASSES = 6  # of departures and the laws that follow them
MAX_HARMONIC = 12  # of a strict period, near which nothing is another finding


@dataclass(frozen=True, eq=False)
class SelectedCause:
    """A selected cause, or unknown structure, and the test that selected it.

    Attributes
    ----------
    version : object or None
        As it acts in this log; None for outlying counts, and for unknown structure without a law.
    start : array, shape (q,)
        Start values of its parameters.
    misfit : Misfit or None
        None for outlying counts, which have no shape.
    together_with : tuple of str
        Causes without which it would not have been found.
    ahead_of_pairs : float
        Nats by which unknown structure is likelier than any combination of causes.
    naming : Misfit or None
        Where it was selected again with others in the law, the test that selected a cause in its place first.
    tested : LinearizedFit or None
        Of unknown structure with a law the residuals of `misfit`, from which that was proposed.
    """

    cause: str
    version: Any
    start: Array
    cause_set: CauseSet
    misfit: Misfit | None
    p_value: float
    together_with: tuple[str, ...] = ()
    ahead_of_pairs: float = np.inf
    naming: Misfit | None = None
    tested: LinearizedFit | None = None

    @property
    def test(self) -> Misfit:
        """As `misfit`, of what has a shape."""
        assert self.misfit is not None
        return self.misfit

    @property
    def resembles_memory(self) -> bool:
        """Whether noise with memory is about as likely as a proposed function of each session's time.

        The two describe one session about as well: only what comes back in a replicate is no noise.
        """
        of_time = getattr(self.version, "carriers", ()) == ("session_seconds",)
        of_sessions = of_time and getattr(self.version, "sessions", ())  # which a short expression has not
        if self.cause != UNKNOWN or self.misfit is None or not of_sessions:
            return False
        evidence = self.misfit.log_evidence
        of_memory = [
            own for own, one in zip(evidence, self.misfit.hypotheses, strict=True) if isinstance(one, AR1)
        ]
        return bool(max(of_memory, default=-np.inf) > evidence.max() - CAUSE_SET_LOG_BAYES_FACTOR)


def law_causes(selected: Sequence[SelectedCause]) -> list[SelectedCause]:
    """Those that extend the laws."""
    return [one for one in selected if one.version is not None]


def name_explained(selected: Sequence[SelectedCause]) -> list[str]:
    """The causes, and the alternatives without a cause, that some selected ones stand for."""
    names = []
    for one in selected:
        names.append(one.cause)
        if one.cause == UNKNOWN and one.version is not None and one.misfit is not None:
            names.append(f"{UNKNOWN}:{PREDICTION}")  # which is a function of the columns
            names += [
                one.misfit.best_subspace(UNKNOWN).cause,
                f"{UNKNOWN}:{' and '.join(one.version.carriers)}",
            ]
    return names


def name_combinations(
    selected: Sequence[SelectedCause], combinations: Sequence[Sequence[str]]
) -> list[SelectedCause]:
    """The selected causes, each with those of its combinations that were selected, which are no rivals of it.

    Structure without a name would have been found by itself.
    """
    names = [one.cause for one in selected]
    return [
        replace(
            one,
            cause_set=one.cause_set.without_rivals(names),
            together_with=tuple(
                name
                for name in names
                if name != one.cause != UNKNOWN and any({name, one.cause} <= {*some} for some in combinations)
            ),
        )
        for one in selected
    ]


def assess_residuals(
    linearized: LinearizedFit,
    problem: DiagnosisProblem,
    n_bootstrap: int,
    rng: np.random.Generator,
    without: Sequence[str] = (),
    max_exceedances: int | None = None,
) -> Misfit:
    """The misfit test over every cause except some, and over the unstructured alternatives."""
    misfit = compute_evidence(linearized, problem, without)
    return assess_evidence(misfit, linearized, problem, n_bootstrap, rng, max_exceedances)


def compute_evidence(
    linearized: LinearizedFit,
    problem: DiagnosisProblem,
    without: Sequence[str] = (),
    effects: Sequence[FiniteEffects] | None = None,
) -> Misfit:
    """As `assess_residuals`, without a p-value.

    `effects` are those of the causes, if they are known already from another fit with the same laws and rows.
    """
    if effects is None:
        causes = [cause for cause in problem.causes if cause.name not in without]
        effects = compute_finite_effects(linearized, causes)
    alternatives = attribute_to_causes(problem.alternatives(linearized), problem.causes, without)
    candidates = build_candidates(linearized, effects)
    misfit = weigh_evidence(linearized, drop_single_rows([*candidates.hypotheses, *alternatives]))
    return replace(misfit, failed=candidates.failed)


def assess_evidence(
    misfit: Misfit,
    linearized: LinearizedFit,
    problem: DiagnosisProblem,
    n_bootstrap: int,
    rng: np.random.Generator,
    max_exceedances: int | None = None,
) -> Misfit:
    """The `misfit` of a fit with its p-value, in noise as the problem has it."""
    chosen = problem.trimmed or problem.skewness is not None or np.any(problem.noise_ratio != 1)
    factor = SELECTION_FACTOR if chosen else 1
    return compute_p_value(
        misfit,
        linearized,
        factor * n_bootstrap,
        rng,
        max_exceedances,
        factor,
        skewed=problem.skewness is not None,
        quantization=problem.quantization(linearized),
    )


@dataclass(frozen=True, eq=False)
class Extension:
    """A problem with causes in its laws, the noise re-estimated, and the fit."""

    problem: DiagnosisProblem
    fit: ExtendedFit
    causes: tuple[SelectedCause, ...] = ()

    @cached_property
    def linearized(self) -> LinearizedFit:
        """What the laws leave, other forms that the causes may have counting as known."""
        return linearize_with_causes(self.problem, self.fit, self.causes)

    @cached_property
    def plain(self) -> LinearizedFit:
        """What the laws leave, in the form that was fitted."""
        return self.problem.linearize_extended(self.fit)


def extend_problem(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], tried: ExtendedFit | None = None
) -> Extension:
    """The problem with causes in its laws, the noise re-estimated, and the fit.

    A fit of these laws that was `tried` is not made again.
    """
    causes = law_causes(selected)
    start = np.concatenate([np.zeros(0), *(one.start for one in causes)])
    versions = [one.version for one in causes]
    if tried is None or any(isinstance(one, CarryOverTerm) for one in versions):
        problem, fit = _fit_with_departures(problem, versions, start)
    else:
        fit = tried
    correlated = problem.with_autocorrelation(fit)
    if correlated is not problem:
        problem, fit = correlated, correlated.refit_extended(versions, fit)
    linearized = linearize_with_causes(problem, fit, causes)
    left = StructureRemoved(linearized.residual, np.zeros(len(problem)))
    noise = problem.estimate_noise(linearized, left)
    if not set(noise.unevenness.carriers) <= set(problem.uneven):
        misfit = compute_evidence(linearized, problem, name_explained(causes))
        noise = explain_unevenness(problem, linearized, misfit, left, noise)
    problem = problem.with_noise(noise)
    if problem.autocorrelation is not None:  # the noise of a signal changes much once its cause is in the law
        fit = problem.refit_extended(versions, fit)
    return Extension(problem, fit, tuple(causes))


def try_extension(
    problem: DiagnosisProblem, selected: Sequence[SelectedCause], tried: ExtendedFit | None = None
) -> Extension | None:
    """The same of causes that are tried only; None where their laws have no finite fit."""
    try:
        return extend_problem(problem, selected, tried)
    except np.linalg.LinAlgError:
        return None


def explain_unevenness(
    problem: DiagnosisProblem,
    linearized: LinearizedFit,
    misfit: Misfit,
    left: StructureRemoved,
    noise: NoiseEstimate,
) -> NoiseEstimate:
    """The noise anew without further structure, as long as that is likelier than noise that is uneven.

    Beside something stronger, a jump in one session would else be a noisy session. `noise` is estimated from
    what is `left`.
    """
    batch = batch_hypotheses(misfit.hypotheses, linearized.df)
    for _ in range(MAX_STRUCTURES):
        if not noise.unevenness.carriers or not misfit.hypotheses:
            break
        evidence = batch.log_evidence(left.residual[:, None])[:, 0]
        more = remove_structure(left.residual, misfit.hypotheses, evidence, linearized.df)
        if more.log_evidence <= noise.unevenness.log_ratio:
            break
        leverage, log_evidence = left.leverage + more.leverage, left.log_evidence + more.log_evidence
        left = StructureRemoved(more.residual, leverage, log_evidence)
        noise = problem.estimate_noise(linearized, left)
    return noise


def expect_noise(
    problem: DiagnosisProblem, linearized: LinearizedFit, left: StructureRemoved | None = None
) -> DiagnosisProblem:
    """The problem with the expected variances of its noise.

    `linearized` are its residuals, and `left` those without structure, if any is in them.
    """
    left = StructureRemoved(linearized.residual, np.zeros(len(problem))) if left is None else left
    return problem.with_noise(problem.estimate_noise(linearized, left).expected())


def _fit_with_departures(
    problem: DiagnosisProblem, versions: Sequence[Any], start: Array
) -> tuple[DiagnosisProblem, ExtendedFit]:
    """The fit of the laws with causes, and the problem with the departures that these follow, if any do.

    Departures and parameters are estimated in turn, as by extended least squares (L. Ljung, System
    Identification, 2nd ed., 1999, sect. 10.3).
    """
    if not any(isinstance(one, CarryOverTerm) for one in versions):
        return problem, problem.fit_extended(versions, start)
    fit = problem.fit_extended()
    for _ in range(DEPARTURE_PASSES):
        problem = replace(problem, table=RowTable(add_departures(problem.rows, -fit.residual)))
        fit = problem.fit_extended(versions, start)
        start = fit.values
    return problem, fit


def linearize_with_causes(
    problem: DiagnosisProblem, fit: ExtendedFit, causes: Sequence[SelectedCause]
) -> LinearizedFit:
    """A fit with causes in its laws, linearized; other forms that the causes may have count as known."""
    plain = problem.linearize_extended(fit)
    # What is no evidence of another cause beside a selected one.
    forms = [form(plain, one) for one in causes for form in (alternative_forms, open_changes)]
    return plain.absorb(np.concatenate(forms, axis=1)) if forms else plain


def absorb_unknown(extension: Extension, selected: Sequence[SelectedCause]) -> LinearizedFit:
    """The residuals of an extension without all that proposals for unknown structure may still describe.

    A proposal is a guess at a form: whatever else follows the same carriers is no second finding. Nor is what
    a wave's harmonics have beside them, as its shape slowly changes.
    """
    linearized = extension.linearized
    unknown = [one for one in law_causes(selected) if one.cause == UNKNOWN]
    periods = [one.version.period for one in law_causes(selected) if isinstance(one.version, PeriodicTime)]
    effects = [_unknown_forms(linearized, one) for one in unknown]
    effects += [_beside_harmonics(linearized, period) for period in periods]
    return linearized.absorb(np.concatenate(effects, axis=1)) if effects else linearized


def _beside_harmonics(linearized: LinearizedFit, period: float) -> Array:
    """Waves at and beside the harmonics of a period, as near as the record's length resolves, whitened."""
    seconds = np.asarray(linearized.columns["session_seconds"], float)
    shifts = np.array([0.0, -1.0, 1.0, -0.5, 0.5]) / float(seconds.max())
    rates = np.concatenate([k / period + shifts for k in range(1, MAX_HARMONIC + 1)])
    angles = 2.0 * np.pi * seconds[:, None] * rates[: len(seconds) // (2 * ROWS_PER_FORM)]
    return linearized.whiten(np.concatenate([np.cos(angles), np.sin(angles)], axis=1))


def _unknown_forms(linearized: LinearizedFit, selected: SelectedCause) -> Array:
    """Effects of the carriers of a proposal, in its own form and in all others, whitened, (n, m)."""
    misfit, version = selected.test, selected.version
    carriers = set(version.carriers)
    others = [
        one.version
        for one in (misfit.best_subspace(UNKNOWN), *misfit.hypotheses)
        if carriers == set(getattr(one.version, "carriers", ())) and not hasattr(one.version, "period")
    ]
    columns, alike = [], dict[SmoothTerm, Array]()
    for one in dict.fromkeys([version, *others]):
        changes = (
            [_changes_of_smooth(linearized, one, alike)]
            if isinstance(one, SmoothTerm)
            else [compute_changes(linearized, one, trials) for _, trials in one.trials(linearized.rows)]
        )
        for effects in map(linearized.whiten, changes):
            columns.append(effects / np.maximum(np.linalg.norm(effects, axis=0), EFFECT_TOL))
    left, singular, _ = svd(np.concatenate(columns, axis=1))
    most = max(len(linearized) // ROWS_PER_FORM, 1)
    return left[:, singular > MIN_FORM_LENGTH][:, :most]


def _changes_of_smooth(linearized: LinearizedFit, term: SmoothTerm, alike: dict[SmoothTerm, Array]) -> Array:
    """Change of every response by each parameter, shape (n, q).

    Many terms differ in where they act only: `alike` keeps those of one function for all.
    """
    shared = replace(term.for_all, sds=(1.0,) * len(term.orders))
    if shared not in alike:
        alike[shared] = compute_changes(linearized, shared, np.eye(len(term.orders)))
    changes = np.zeros((len(linearized), len(term.parameters)))
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        if acts_on(term, part.law):
            changes[part.rows] = term.from_alike(part.law, table, alike[shared][part.rows])
    return changes


def add_candidates(misfit: Misfit, linearized: LinearizedFit, effects: Sequence[FiniteEffects]) -> Misfit:
    """A test of the residuals of a fit with the evidence of more effects of causes; no p-value."""
    added = build_candidates(linearized, effects).hypotheses
    return weigh_evidence(linearized, drop_single_rows([*misfit.hypotheses, *added]), misfit)


def weigh_causes(linearized: LinearizedFit, effects: Sequence[FiniteEffects]) -> dict[str, float]:
    """The evidence of causes, by their trials alone: far cheaper than that of all alternatives."""
    candidates = drop_single_rows(build_candidates(linearized, effects).hypotheses)
    return weigh_evidence(linearized, candidates).log_evidence_by_cause


def compute_finer_effects(linearized: LinearizedFit, misfit: Misfit) -> list[FiniteEffects]:
    """The effects of trials between those that a test found likely, of causes that choose among trials."""
    found = []
    for cause, evidence in misfit.log_evidence_by_cause.items():
        best = misfit.best_hypothesis(cause)
        finer = getattr(best.version, "finer_trials", None)
        if evidence < MIN_FINER or finer is None or best.values is None:
            continue
        trials = finer(linearized.rows, best.values)
        trials = trials[np.any(trials != best.values, axis=1)]
        if len(trials):
            session = best.version.session
            where = split_sessions(linearized)[session] if session else linearized
            found.append(compute_version_effects(where, cause, best.version, trials))
    return found


def fit_causes(problem: DiagnosisProblem, selected: Sequence[SelectedCause]) -> ExtendedFit:
    """The laws refitted with the selected causes in them."""
    causes = law_causes(selected)
    start = np.concatenate([np.zeros(0), *(one.start for one in causes)])
    return problem.fit_extended([one.version for one in causes], start)


def fit_trial(problem: DiagnosisProblem, selected: Sequence[SelectedCause]) -> ExtendedFit:
    """The laws refitted with the selected causes, the last of which starts from a trial of its parameters.

    Such a fit may end in a minimum that is not the lowest. In a table, whose causes may be anything, it is
    begun again with the causes that it found and the law as it is without them.
    """
    first = fit_causes(problem, selected)
    if not first.converged or any(hasattr(part.law, "joint") for part in problem.parts):
        return first
    again = problem.fit_extended([one.version for one in law_causes(selected)], first.values)
    return min(first, again, key=problem.chi_square)


def make_selected(
    misfit: Misfit, cause_set: CauseSet, starts: Mapping[str, Array] | None = None
) -> SelectedCause:
    """The cause that a test chose, with start values for its fit: `starts`, or of its estimated size.

    Unknown structure has no version yet, see `proposed_term`.
    """
    shape = misfit.best_equation(cause_set.cause)
    p_value = min(1.0, misfit.p_value / (1.0 - OUTLIER_ALPHA_SHARE))
    start = np.zeros(0)
    if cause_set.cause == UNKNOWN:
        return SelectedCause(UNKNOWN, None, start, cause_set, misfit, p_value)
    if isinstance(shape, Hypothesis) and shape.version is not None:
        start = np.array(shape.version.start_values)
        if shape.values is not None:
            # Of the estimated size and sign: a fit rarely crosses zero, where it has a local minimum.
            size = float(shape.coefficients(misfit.residual)[0]) / shape.length
            first = start[0] + (shape.values[0] - start[0]) * size
            start = np.concatenate([[first], shape.values[1:]])
    version: Any = shape.version
    if isinstance(shape, Hypothesis) and hasattr(version, "with_amplitude"):
        version = version.with_amplitude(estimate_strength(shape, misfit.residual) / shape.length)
    known = (starts or {}).get(cause_set.cause, start)
    if len(known) == len(start):  # else of another form, which another test has chosen
        start = known
    return SelectedCause(cause_set.cause, version, start, cause_set, misfit, p_value)


def estimate_strength(shape: Hypothesis, residual: Array) -> float:
    """The strength of an effect under which whitened residuals, shape (n,), are likeliest.

    It is the tau of `misfit`, the noise being 1: between strong shrinkage and none.
    """
    from scipy.optimize import minimize_scalar

    squares, share = shape.coefficients(residual) ** 2, shape.prior_share

    def deviance(log_tau: float) -> float:
        signal = np.exp(2.0 * log_tau) * share
        return float(np.sum(np.log1p(signal)) - np.sum(squares * signal / (1.0 + signal)))

    return float(np.exp(minimize_scalar(deviance, bounds=LOG_STRENGTHS, method="bounded").x))


def alternative_forms(linearized: LinearizedFit, selected: SelectedCause) -> Array:
    """Effects of a selected cause in other forms than the one fitted, whitened, shape (n, m).

    These are its other shapes, and the square and the cube of its own effect, for a nonlinear dependence.
    """
    effect = compute_changes(linearized, selected.version, selected.start[None])
    powers = linearized.whiten(np.concatenate([effect**2, effect**3], axis=1))
    length = np.linalg.norm(powers, axis=0)
    shapes = _other_shapes(linearized, selected)
    shapes = [one[:, :: -(-one.shape[1] // MAX_SHAPES)] for one in shapes if one.shape[1]]
    columns = np.concatenate([*shapes, powers / np.where(length > 0, length, 1.0)], axis=1)
    left, singular, _ = svd(columns)
    squares = singular**2
    # All that tie with the last one: any of them could else be left out.
    least = (1.0 - FORM_TIE) * squares[min(MAX_FORMS, len(squares)) - 1]
    return left[:, squares > max(MIN_FORM_SHARE * float(np.sum(squares)), least)]


def open_changes(linearized: LinearizedFit, selected: SelectedCause) -> Array:
    """What the choice of lambda leaves open in a selected cause's effect, whitened, shape (n, m).

    The differences from its effect with lambda well within either regime, of each joint and direction by
    itself: those may differ in what they are.
    """
    version = selected.version
    if not isinstance(version, StageCause):
        return np.zeros((len(linearized), 0))
    others = dict.fromkeys(
        one.version
        for one in selected.test.hypotheses
        if isinstance(one.version, StageCause) and replace(one.version, assumed=version.assumed) == version
    )
    own = compute_changes(linearized, version, selected.start[None])
    columns = [np.zeros((len(linearized), 0))]
    for other in others:
        difference = compute_changes(linearized, other, selected.start[None]) - own
        for part in linearized.parts:
            for sign in (1.0, -1.0):
                rows = part.rows[linearized.direction_sign[part.rows] == sign]
                column = np.zeros_like(difference)
                column[rows] = difference[rows]
                columns.append(column)
    changes = linearized.whiten(np.concatenate(columns, axis=1))
    left, singular, _ = svd(changes)
    return left[:, singular > MIN_OPEN]


def _other_shapes(linearized: LinearizedFit, selected: SelectedCause) -> list[Array]:
    """Directions of all shapes of a selected cause's version, and as the data may bend it; each (n, m)."""
    if linearized.noise_filter is None:
        return [
            one.directions
            for one in selected.test.hypotheses
            if isinstance(one, Hypothesis)
            and one.cause == selected.cause
            and (one.version == selected.version or may_bend(one))
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
