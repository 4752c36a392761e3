"""select_causes: forward selection of causes, and the set of causes that the data cannot separate.

Order: estimate the noise, test for outlying counts, then test the residuals and add the best cause
until the p-value is above its share of the false-alarm rate. Afterwards each cause is selected again with
all others in the law. The p-value of the search is the smaller of those of outliers and misfit, each
divided by its share of the rate (`misfit`). A cause set holds every cause with a log Bayes factor above -3
relative to the best. Causes whose largest plausible effect would not be detectable are untestable; logs
with few traverses are not tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.cause_set import CauseSet, form_cause_set
from stickslip_fit.diagnosis.combinations import first_of_pair, refit_likeliest, revise_causes
from stickslip_fit.diagnosis.extension import (
    OUTLIER_ALPHA_SHARE,
    SelectedCause,
    assess_residuals,
    compute_evidence,
    extend_problem,
    fit_causes,
    law_causes,
    make_selected,
)
from stickslip_fit.diagnosis.hypotheses import (
    FiniteEffects,
    compute_finite_effects,
)
from stickslip_fit.diagnosis.influence import assess_support
from stickslip_fit.diagnosis.linearized import ExtendedFit, LinearizedFit
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, remove_structure
from stickslip_fit.diagnosis.noise import find_outliers
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.proposed_term import propose_term

MAX_CAUSES = 4
MAX_EXCEEDANCES = 50  # bootstrap samples above the statistic, after which a second cause is ruled out


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
        return law_causes(self.selected)

    @property
    def slices(self) -> list[slice]:
        """Where the parameters of each of `law_causes` stand in `fit.values`."""
        ends = np.cumsum([0, *(len(selected.start) for selected in self.law_causes)]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]


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
        last, starts = refit_likeliest(problem, selected, last)
        following = make_selected(last, form_cause_set(last), starts)
        if following.cause == UNKNOWN:
            following = first_of_pair(problem, selected, last) or following
        support = assess_support(linearized, last, following.cause)
        if support.too_narrow:
            influential = support.outlying
            following = make_selected(last, form_cause_set(last, UNKNOWN))
        selected.append(following)
        if following.cause == UNKNOWN:
            break
        problem, fit, linearized = extend_problem(problem, selected)
        last = assess_residuals(
            linearized, problem, n_bootstrap, rng, [one.cause for one in selected], MAX_EXCEEDANCES
        )
    causes = law_causes(selected)
    if len(causes) > 1:
        revised = revise_causes(problem, causes)
        if [one.cause for one in revised] != [one.cause for one in causes]:
            problem, fit, linearized = extend_problem(problem, revised)
        selected = [*revised, *(one for one in selected if one.version is None)]
    if selected and selected[-1].cause == UNKNOWN:
        selected = propose_term(linearized, selected, rng)
        if selected[-1].version is not None:
            fit = fit_causes(problem, selected)
            linearized = problem.linearize_extended(fit)
    everything = (*misfires, *selected)
    return Selection(problem, outliers, everything, first, last, p_value, fit, linearized, influential)


def select_outliers(problem: DiagnosisProblem, p_value: float) -> SelectedCause:
    """Outlying rows as a selected cause, which has no shape."""
    name = problem.outlier_cause
    return SelectedCause(name, None, np.zeros(0), CauseSet(name, (), {}), None, p_value)


def allocate_alpha(alpha: float) -> float:
    """The share of a false-alarm rate that is left for the misfit test."""
    return min((1.0 - OUTLIER_ALPHA_SHARE) * alpha, 1.0)


def settle_noise(selection: Selection) -> Selection:
    """The selection with its estimate of the noise's autocorrelation, if there is any, final."""
    noise = selection.problem.autocorrelation
    if noise is None:
        return selection
    return replace(selection, problem=replace(selection.problem, autocorrelation=noise.settle()))


def refit_selection(selection: Selection, selected: tuple[SelectedCause, ...]) -> Selection:
    """The selection with other causes, its noise, fit and residuals those of the law with them."""
    if law_causes(selected):
        problem, fit, linearized = extend_problem(selection.problem, selected)
    else:
        problem, linearized, _ = _reestimate_noise(selection.problem)
        fit = problem.fit_extended()
    return replace(selection, problem=problem, selected=selected, fit=fit, linearized=linearized)


def _reestimate_noise(
    problem: DiagnosisProblem, effects: Sequence[FiniteEffects] | None = None
) -> tuple[DiagnosisProblem, LinearizedFit, Array]:
    """The problem with re-estimated noise, its fit, and its residuals without structure.

    The residuals are in units of the largest noise that their configuration may have. `effects` are as of
    `assess_residuals`.
    """
    linearized = problem.linearize()
    misfit = compute_evidence(linearized, problem, effects=effects)
    left = remove_structure(linearized.residual, misfit.hypotheses, misfit.log_evidence)
    noise = problem.estimate_noise(linearized, left)
    problem = problem.with_noise(noise)
    max_ratio = noise.heteroscedasticity.max_ratio / problem.noise_ratio
    return problem, problem.linearize(), left.residual * linearized.scale / problem.scale / max_ratio


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
