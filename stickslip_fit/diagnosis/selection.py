"""select_causes: forward selection of causes, and the set of causes that the data cannot separate.

Order: estimate the noise, test for outlying counts, then test the residuals and add the best cause
until the p-value is above its share of the false-alarm rate. Afterwards each cause is chosen again with
all others in the law. The p-value of the search is the smaller of those of outliers and misfit, each
divided by its share of the rate. A cause set holds every cause with a log Bayes factor above -3
relative to the best. Causes whose largest plausible effect would not be detectable are untestable; logs
with few traverses are not tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.hypotheses import (
    EFFECT_TOL,
    Hypothesis,
    SessionFit,
    build_candidates,
    compute_changes,
    compute_effects,
    compute_session_effects,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import ExtendedFit, LinearizedFit, linearize_fit
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, StructureRemoved, compute_misfit, remove_structure
from stickslip_fit.diagnosis.noise import find_outliers
from stickslip_fit.diagnosis.problem import DiagnosisProblem

# A cause this much less likely than the best (in nats) is out of the running in 95 of 100 logs.
CAUSE_SET_LOG_BAYES_FACTOR = 3.0
PRIOR_NULL = 0.5
# Structure without a name has to be this much likelier than the best cause (nats): any cause's form may be
# a little other than nature's, and what is left of it looks like structure.
UNKNOWN_LOG_BAYES_FACTOR = 0.0


@dataclass(frozen=True)
class CauseSet:
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


def form_cause_set(found: Misfit, cause: str | None = None) -> CauseSet:
    """Name what a misfit shows.

    Parameters
    ----------
    found : Misfit
    cause : str, optional
        Where something else than this look decides.
    """
    evidence = found.log_evidence_by_cause
    causes = {cause: value for cause, value in evidence.items() if cause != UNKNOWN}
    best = max(causes, key=lambda cause: causes[cause]) if causes else UNKNOWN
    if causes and evidence.get(UNKNOWN, -np.inf) > causes[best] + UNKNOWN_LOG_BAYES_FACTOR:
        best = UNKNOWN
    best = cause or best
    rivals: tuple[str, ...] = ()
    if best != UNKNOWN:
        floor = causes[best] - CAUSE_SET_LOG_BAYES_FACTOR
        close = [cause for cause, value in causes.items() if cause != best and value > floor]
        rivals = tuple(sorted(close, key=lambda cause: -causes[cause]))
    probability = cause_probabilities(evidence)
    if cause is not None:
        probability = {each: value * (each in (best, *rivals)) for each, value in probability.items()}
        known = sum(probability.values())
        probability = {each: value / known if known > 0 else 0.0 for each, value in probability.items()}
    return CauseSet(best, rivals, probability)


def cause_probabilities(evidence: dict[str, float], nothing: float = PRIOR_NULL) -> dict[str, float]:
    """Probability of each cause if at most one is at work; nothing is as likely beforehand as something."""
    each = (1.0 - nothing) / max(len(evidence), 1)
    logs = np.array([*evidence.values(), 0.0]) + np.log([each] * len(evidence) + [nothing])
    weights = np.exp(logs - logs.max())
    return dict(zip(evidence, map(float, (weights / weights.sum())[:-1]), strict=True))


MISFIRE = "end-stop-misfire"
# Two looks, one for wild counts and one for all else, share the false-alarm rate. Wild counts are rarely near
# the limit, faint effects often.
# Which configurations are noisy is told by how alike the residuals within each are: so weighed, chance looks
# like structure about twice as often as in logs of flipped signs (`benchmarks/README.md`).
SELECTION_FACTOR = 2
OUTLIER_ALPHA_SHARE = 0.25
MAX_CAUSES = 4
MAX_EXCEEDANCES = 50  # flipped logs that look worse than what is left: no second alarm, whatever others say
MIN_FORM_SHARE, MAX_FORMS = 0.003, 8
# Nats: by how much a cause that may be one of two must be likelier than nothing, and two causes than
# structure without a name; and how many first ones are tried.
PAIR_MIN_LOG_BAYES_FACTOR, PAIR_LOG_PENALTY, MAX_PAIR_TRIALS = 3.0, 3.0, 3


@dataclass(frozen=True, eq=False)
class SelectedCause:
    """A cause, or unknown structure, and the look at the residuals that showed it.

    Attributes
    ----------
    cause : str
    version : object or None
        As it acts in this log; None for unknown structure and misfires.
    start : array, shape (q,)
        Its parameters at the likeliest shape.
    naming : Naming
    misfit : Misfit or None
        None for misfires, which have no shape.
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
    """What a search found.

    Attributes
    ----------
    bench : Bench
        Without misfired rows, the repeatability estimated anew.
    misfired : array of int
        Rows of the bench that was given.
    found : tuple of Found
        In the order found.
    first, last : Misfit
        The looks at the residuals of the baseline, and of all that was found.
    p_value : float
        Of anything at all.
    fit : Refit
        The baseline with all causes found in it.
    study : Study
        What is left under `fit`.
    """

    problem: DiagnosisProblem
    outliers: IntArray
    found: tuple[SelectedCause, ...]
    first: Misfit
    last: Misfit
    p_value: float
    fit: ExtendedFit
    study: LinearizedFit

    @property
    def versions(self) -> list[Any]:
        """The causes in `fit`, in its order."""
        return [each.version for each in self.found if each.version is not None]


def select_causes(
    problem: DiagnosisProblem, alpha: float, n_bootstrap: int, rng: np.random.Generator
) -> Selection:
    """Search a log for what its baseline leaves unexplained.

    Parameters
    ----------
    bench : Bench
    alpha : float
        False-alarm rate over everything that is searched.
    n_bootstrap : int
        Logs in which nothing is wrong, by which that is judged.
    rng : Generator
    """
    problem, linearized, residual = _reestimate_noise(problem)
    wild = find_outliers(linearized, residual, problem.drive, n_bootstrap, rng)
    level, outliers = allocate_alpha(alpha), np.zeros(0, dtype=np.intp)
    found: list[SelectedCause] = []
    if wild.p_value < OUTLIER_ALPHA_SHARE * alpha and len(wild.rows):
        outliers = wild.rows
        problem, linearized, _ = _reestimate_noise(problem.without(outliers))
        cause_set = CauseSet(MISFIRE, (), {})
        found.append(
            SelectedCause(
                MISFIRE, None, np.zeros(0), cause_set, None, min(1.0, wild.p_value / OUTLIER_ALPHA_SHARE)
            )
        )
    first = last = assess_residuals(linearized, problem, n_bootstrap, rng)
    p_value = min(1.0, wild.p_value / OUTLIER_ALPHA_SHARE, first.p_value / (1.0 - OUTLIER_ALPHA_SHARE))
    fit = problem.fit_extended()
    named: list[SelectedCause] = []
    while last.p_value < level and len(named) < MAX_CAUSES:
        following = _select_best(last)
        if following.cause == UNKNOWN:
            following = _first_of_pair(problem, named, last) or following
        named.append(following)
        if following.cause == UNKNOWN:
            break
        problem, fit, linearized = extend_problem(problem, named)
        last = assess_residuals(
            linearized, problem, n_bootstrap, rng, [each.cause for each in named], MAX_EXCEEDANCES
        )
    causes = [each for each in named if each.version is not None]
    if len(causes) > 1:
        again = _revise_causes(problem, causes)
        if [each.cause for each in again] != [each.cause for each in causes]:
            problem, fit, linearized = extend_problem(problem, again)
        named = [*again, *(each for each in named if each.version is None)]
    return Selection(problem, outliers, (*found, *named), first, last, p_value, fit, linearized)


def allocate_alpha(alpha: float) -> float:
    """What is left of a false-alarm rate for all but wild counts."""
    return min((1.0 - OUTLIER_ALPHA_SHARE) * alpha, 1.0)


def assess_residuals(
    linearized: LinearizedFit,
    problem: DiagnosisProblem,
    n_bootstrap: int,
    rng: np.random.Generator,
    without: Sequence[str] = (),
    enough: int | None = None,
) -> Misfit:
    """Judge residuals by every cause but some, and by structure that none of them has."""
    causes = [cause for cause in problem.causes if cause.name not in without]
    times = SELECTION_FACTOR if np.any(problem.uneven != 1) else 1
    shapes = [*build_candidates(linearized, causes), *problem.alternatives(linearized)]
    return compute_misfit(linearized, shapes, times * n_bootstrap, rng, enough, times)


def extend_problem(
    problem: DiagnosisProblem, named: Sequence[SelectedCause]
) -> tuple[DiagnosisProblem, ExtendedFit, LinearizedFit]:
    """The bench with causes in its laws: the fit, what is left, and the repeatability by that."""
    versions = [each.version for each in named if each.version is not None]
    start = np.concatenate([np.zeros(0), *(each.start for each in named if each.version is not None)])
    fit = problem.fit_extended(versions, start)
    linearized = _linearize_extended(problem, fit, named)
    problem = problem.with_noise(
        problem.estimate_noise(linearized, StructureRemoved(linearized.residual, np.zeros(len(problem))))
    )
    return problem, fit, _linearize_extended(problem, fit, named)


def _first_of_pair(
    problem: DiagnosisProblem, named: Sequence[SelectedCause], misfit: Misfit
) -> SelectedCause | None:
    """The first of two causes that together are likelier than structure without a name, if there are two.

    Two causes at once look like neither, and so like nothing known.
    """
    evidence = misfit.log_evidence_by_cause
    causes = [cause for cause in evidence if cause != UNKNOWN and evidence[cause] > PAIR_MIN_LOG_BAYES_FACTOR]
    best, likeliest = None, evidence[UNKNOWN] + PAIR_LOG_PENALTY
    for cause in sorted(causes, key=lambda cause: -evidence[cause])[:MAX_PAIR_TRIALS]:
        first = _make_selected(misfit, form_cause_set(misfit, cause))
        trial, _, linearized = extend_problem(problem, [*named, first])
        without = [cause, *(each.cause for each in named)]
        left = assess_residuals(linearized, trial, 0, np.random.default_rng(0), without).log_evidence_by_cause
        second = max((each for each in left if each != UNKNOWN), key=lambda each: left[each], default=UNKNOWN)
        together = evidence[cause] + left[second]
        if left[second] > left.get(UNKNOWN, -np.inf) and together > likeliest:
            best, likeliest = first, together
    return best


def _revise_causes(problem: DiagnosisProblem, causes: Sequence[SelectedCause]) -> list[SelectedCause]:
    """Each cause once more, with all the others in the law: it may be another, or have other rivals."""
    again = list(causes)
    for place in range(len(again)):
        others = [each for k, each in enumerate(again) if k != place]
        trial, _, linearized = extend_problem(problem, others)
        misfit = assess_residuals(
            linearized, trial, 0, np.random.default_rng(0), [each.cause for each in others]
        )
        cause_set = form_cause_set(misfit)
        if cause_set.cause != UNKNOWN:
            again[place] = replace(_make_selected(misfit, cause_set), p_value=causes[place].p_value)
    return again


def _reestimate_noise(problem: DiagnosisProblem) -> tuple[DiagnosisProblem, LinearizedFit, Array]:
    """The bench with its repeatability estimated anew; its study, and residuals without structure.

    These are in units of the largest noise that their configuration may have.
    """
    linearized = problem.study()
    misfit = assess_residuals(linearized, problem, 0, np.random.default_rng(0))
    left = remove_structure(linearized.residual, misfit.hypotheses, misfit.log_evidence)
    noise = problem.estimate_noise(linearized, left)
    settled = problem.with_noise(noise)
    cautious = noise.uneven.max_ratio / settled.uneven
    return settled, settled.study(), left.residual * linearized.scale / settled.scale / cautious


def _select_best(misfit: Misfit) -> SelectedCause:
    return _make_selected(misfit, form_cause_set(misfit))


def _make_selected(misfit: Misfit, cause_set: CauseSet) -> SelectedCause:
    shape = misfit.best_hypothesis(cause_set.cause)
    p_value = min(1.0, misfit.p_value / (1.0 - OUTLIER_ALPHA_SHARE))
    start = np.zeros(0)
    if isinstance(shape, Hypothesis) and shape.version is not None:
        start = np.array(shape.version.absent)
        if shape.values is not None:
            # As large as it looks, and of that sign: from the other side a fit may not find back.
            seen = float(shape.along(misfit.residual)[0]) / shape.length
            grown = start[0] + (shape.values[0] - start[0]) * seen
            start = np.concatenate([[grown], shape.values[1:]])
    return SelectedCause(cause_set.cause, shape.version, start, cause_set, misfit, p_value)


def _linearize_extended(
    problem: DiagnosisProblem, fit: ExtendedFit, named: Sequence[SelectedCause]
) -> LinearizedFit:
    plain = linearize_fit(problem.rows, fit.parts, problem.responses, problem.scale, shared=len(fit.values))
    own = [alternative_forms(plain, each) for each in named if each.version is not None]
    if not own:
        return plain
    absorbed = np.concatenate(own, axis=1)
    return linearize_fit(
        problem.rows, fit.parts, problem.responses, problem.scale, shared=len(fit.values), absorbed=absorbed
    )


def alternative_forms(linearized: LinearizedFit, found: SelectedCause) -> Array:
    """What a named cause can do in other forms than the one fitted, in units of the noise, shape (n, m).

    These are its other shapes, and the square and the cube of its own effect: a bend in whatever it follows.
    """
    misfit = found.misfit
    assert misfit is not None
    shapes = [
        each.directions
        for each in misfit.hypotheses
        if isinstance(each, Hypothesis) and is_same_version(each, found)
    ]
    effect = compute_changes(linearized, found.version, found.start[None])
    bent = np.concatenate([effect**2, effect**3], axis=1) / linearized.scale[:, None]
    length = np.linalg.norm(bent, axis=0)
    columns = np.concatenate([*shapes, bent / np.where(length > 0, length, 1.0)], axis=1)
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, singular**2 > MIN_FORM_SHARE * np.sum(singular**2)][:, :MAX_FORMS]


def is_same_version(hypothesis: Hypothesis, found: SelectedCause) -> bool:
    """Whether a hypothesis is a shape of what was found, in the same version."""
    return hypothesis.cause == found.cause and bool(hypothesis.version == found.version)


MIN_TESTABLE_STRENGTH = 3.0  # strength at the largest plausible size


def find_untestable(problem: DiagnosisProblem, linearized: LinearizedFit) -> dict[str, str]:
    """Causes that even at their largest plausible size would not show, and why."""
    found, every = {}, split_sessions(linearized)
    for cause in problem.causes:
        strength = largest_strength(cause, linearized, every)
        if strength < EFFECT_TOL:
            found[cause.name] = "this log's traverses show nothing of it, once each session is recalibrated"
        elif strength < MIN_TESTABLE_STRENGTH:
            found[cause.name] = (
                f"even at its largest plausible size its strength in this log would be {strength:.1f}, less "
                f"than {MIN_TESTABLE_STRENGTH:.0f}"
            )
    return found


def largest_strength(cause: Any, linearized: LinearizedFit, every: Mapping[str, SessionFit]) -> float:
    """Norm of a cause's largest plausible effect, in repeatabilities, recalibration taken out."""
    if cause.name == MISFIRE:
        return np.inf
    shapes = [(cause, np.array(cause.largest()))] if cause.largest() else cause.trials(linearized.rows)
    strengths = [0.0]
    for version, values in shapes:
        grown = values if cause.largest() else values * np.r_[cause.most, np.ones(values.shape[1] - 1)]
        if version.session:
            shown = compute_session_effects(linearized, every[version.session], version, grown)
        else:
            shown = compute_effects(linearized, version, grown)
        strengths.append(float(np.linalg.norm(shown, axis=0).max()))
    return max(strengths)


MIN_DF = 10  # degrees of freedom


def explain_too_small(linearized: LinearizedFit) -> str | None:
    """Why a log cannot be tested at all, and what would suffice; None where it can.

    Parameters
    ----------
    linearized : Study
        The log under its baseline.
    """
    if linearized.df >= MIN_DF:
        return None
    rows, parameters = len(linearized), linearized.basis.shape[1]
    return (
        f"too few traverses to test: {rows} for the baseline's {parameters} parameters, and {MIN_DF} more "
        f"than those are needed; add {MIN_DF - linearized.df} in the same sessions and directions, "
        "replicates or new configurations"
    )


def empty_selection(problem: DiagnosisProblem) -> Selection:
    """A search that found nothing because there is nothing to search."""
    misfit = Misfit(np.zeros(0), (), np.zeros(0), {}, 1.0, np.zeros(0))
    return Selection(
        problem, np.zeros(0, dtype=np.intp), (), misfit, misfit, 1.0, problem.fit_extended(), problem.study()
    )
