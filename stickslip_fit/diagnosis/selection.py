"""select_causes: forward selection of causes, and the set of causes that the data cannot separate.

Order: estimate the noise, test for outlying counts, then test the residuals and add the best cause until the
p-value is above its share of the false-alarm rate, or structure without a name was selected for which there
is no law, one of what carries over, or one with many parameters of each session. Each cause is selected
again with all others in the law, and at the end dropped if the law does as well without it. The p-value of
the search is the smaller of those of outliers and misfit, each divided by its share of the rate (`misfit`).
A cause set holds every cause with a log Bayes factor above -3 relative to the best. Causes whose largest
plausible effect would not be detectable are untestable; logs with few traverses are not tested.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.proposed import CarryOverTerm
from stickslip_fit.diagnosis.baseline import reduce_noise, reestimate_noise
from stickslip_fit.diagnosis.cause_set import CauseSet, form_cause_set
from stickslip_fit.diagnosis.column_pairs import find_new_column
from stickslip_fit.diagnosis.combinations import (
    PAIR_MIN_LOG_BAYES_FACTOR,
    find_beside_unknown,
    find_exchange,
    find_in_part,
    find_needless,
    first_of_pair,
    revise_causes,
)
from stickslip_fit.diagnosis.covered_causes import find_covered, is_collinear, is_open
from stickslip_fit.diagnosis.extension import (
    OUTLIER_ALPHA_SHARE,
    Extension,
    SelectedCause,
    absorb_unknown,
    add_candidates,
    assess_evidence,
    assess_residuals,
    compute_evidence,
    expect_noise,
    extend_problem,
    law_causes,
    make_selected,
    name_combinations,
    name_explained,
    try_extension,
    weigh_causes,
)
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.function_law import follow_function
from stickslip_fit.diagnosis.hypotheses import (
    compute_changes,
    compute_finite_effects,
)
from stickslip_fit.diagnosis.influence import assess_support
from stickslip_fit.diagnosis.linearized import (
    MAX_LEVERAGE,
    ExtendedFit,
    LinearizedFit,
    rms,
)
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnosis.noise import find_outliers, find_runs
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.proposed_term import propose_term
from stickslip_fit.diagnosis.refits import Refits, refit_likeliest
from stickslip_fit.estimation.result import OUTLYING_SD
from stickslip_fit.units import Z_95

# Of functions of sessions, and rows for each of them: beside more, too little is left to tell causes by.
MAX_OWN_PARAMETERS, ROWS_PER_PARAMETER = 24, 6
# Bootstrap samples above the statistic, after which a test ends: where a diagnosis's p-value is below its
# share of the rate, at most 22 lie above, so that no decision depends on the rest.
MAX_EXCEEDANCES = 50
SWOLLEN_NOISE_LEFT = 0.1  # of the noise, without gross errors that were taken for it
MAX_LEFT_OF_BOTH = 0.5  # of a cause and of a function without a name that cancel each other
MIN_FREE = 1e-3  # of a row, one less its leverage
CLEARLY_ABOVE = 1.0  # nats that a test's statistic is above its critical value
MIN_EVIDENCE_SHARE = 0.5  # of a cause's evidence, without which another cannot take its place
NO_ROWS: IntArray = np.zeros(0, dtype=np.intp)


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
    failed : tuple of str
        Causes that were dropped since a fit with them failed.
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
    failed: tuple[str, ...] = ()
    influential: IntArray = field(default_factory=NO_ROWS.copy)

    @cached_property
    def expected(self) -> DiagnosisProblem:
        """The problem with the expected variances of its noise."""
        return expect_noise(self.problem, self.linearized)

    @property
    def law_causes(self) -> list[SelectedCause]:
        """The causes in `fit`, in its order."""
        return law_causes(self.selected)

    @property
    def slices(self) -> list[slice]:
        """Where the parameters of each of `law_causes` stand in `fit.values`."""
        ends = np.cumsum([0, *(len(selected.start) for selected in self.law_causes)]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]

    @property
    def without_tests(self) -> Selection:
        """What a prediction needs of it; tests are as large as all hypotheses."""
        nothing = Misfit(np.zeros(0), (), np.zeros(0), {}, 1.0, np.zeros(0))
        selected = tuple(replace(one, misfit=None, naming=None, tested=None) for one in self.selected)
        tests: Any = {"selected": selected, "first_misfit": nothing, "last_misfit": nothing}
        return replace(self, problem=replace(self.problem), **tests)

    def place_of(self, version: object) -> slice:
        """Where the parameters of one of `law_causes`, given as its version, stand in `fit.values`."""
        versions = [one.version for one in self.law_causes]
        return self.slices[next(k for k, one in enumerate(versions) if one is version)]

    def behind(self, finding: Finding) -> SelectedCause:
        """The selected cause, or unknown structure, that a finding is of."""
        named = [one for one in self.selected if one.cause == finding.cause]
        same = [one for one in named if one.version is finding.version]
        carriers = [one for one in same if follows(one, finding.carrier)]
        return [*carriers, *same, *named][0]


def select_causes(
    problem: DiagnosisProblem,
    alpha: float,
    n_bootstrap: int,
    rng: np.random.Generator,
    trusted: IntArray = NO_ROWS,
    tell_found: Callable[[int], None] = lambda number: None,
) -> Selection:
    """Select the causes that a log shows, at a false-alarm rate `alpha` of the whole search.

    `n_bootstrap` is the number of samples of noise alone for each test. Rows that are `trusted` are no
    outliers. `tell_found` is called with the number of causes found so far, as it grows.
    """
    offered = problem.causes
    while True:
        selection = _select(problem, alpha, n_bootstrap, rng, trusted, tell_found)
        # Beside an effect far above the noise, of which the test knows the linear part alone, rows look
        # outlying that the law with its cause explains.
        explained = explain_outliers(selection, problem, selection.outliers)
        trusted = np.union1d(trusted, explained)
        cancelled = find_cancelled(selection)
        if not len(explained) and not cancelled:
            return replace(selection, problem=replace(selection.problem, causes=offered))
        problem = replace(problem, causes=tuple(one for one in problem.causes if one.name not in cancelled))


def _select(
    problem: DiagnosisProblem,
    alpha: float,
    n_bootstrap: int,
    rng: np.random.Generator,
    trusted: IntArray,
    tell_found: Callable[[int], None],
) -> Selection:
    baseline = reestimate_noise(problem)
    problem, linearized, residual = baseline.problem, baseline.linearized, baseline.residual
    test = find_outliers(linearized, residual, problem.noise_group, n_bootstrap, rng)
    beside = np.column_stack([residual, linearized.residual])
    alone = test.rows[~find_runs(test.rows, problem.smooth_columns, beside)]
    outlying, outliers = np.setdiff1d(alone, trusted), NO_ROWS
    # Rows that are trusted are no evidence that anything is wrong.
    outlier_p_value = min(1.0, test.p_value / OUTLIER_ALPHA_SHARE) if len(outlying) else 1.0
    misfires: list[SelectedCause] = []
    if len(outlying) and test.p_value < OUTLIER_ALPHA_SHARE * alpha:
        outliers = outlying
        baseline = reestimate_noise(_in_noise_left(problem.without_rows(outliers)).with_autocorrelation())
        problem, linearized = baseline.problem, baseline.linearized
        misfires = [select_outliers(problem, outlier_p_value)]
    first = assess_evidence(baseline.weigh(), linearized, problem, n_bootstrap, rng, MAX_EXCEEDANCES)
    del baseline  # as large as all hypotheses
    p_value = min(outlier_p_value, first.p_value / (1.0 - OUTLIER_ALPHA_SHARE))
    search = _ForwardSelection(Extension(problem, problem.fit_extended()), first, alpha, n_bootstrap, rng)
    search.add_causes(tell_found)
    search.drop_needless(first.critical_value(search.level))
    selected = (*misfires, *name_combinations(search.selected, search.combinations))
    results = first, search.last, p_value, search.extension.fit, search.extension.linearized
    failed = tuple(sorted(search.failed))
    return Selection(search.extension.problem, outliers, selected, *results, failed, search.influential)


def _in_noise_left(problem: DiagnosisProblem) -> DiagnosisProblem:
    """The problem, in noise as small as what the laws leave, if that is far smaller than taken for the noise.

    In noise that gross errors have swelled no effect is worth a trial.
    """
    left = rms(problem.linearize().residual)
    if left > SWOLLEN_NOISE_LEFT:
        return problem
    return replace(problem, repeatability=np.maximum(left * problem.repeatability, problem.least_sd))


class _ForwardSelection:
    """The search for causes, one after the other: what is selected, the laws with it, and their last test."""

    def __init__(
        self, extension: Extension, last: Misfit, alpha: float, n_bootstrap: int, rng: np.random.Generator
    ) -> None:
        self.extension, self.last, self.level = extension, last, allocate_alpha(alpha)
        self.n_bootstrap, self.rng = n_bootstrap, rng
        self.selected: list[SelectedCause] = []
        self.combinations: list[tuple[str, ...]] = []
        self.influential, self.failed = NO_ROWS, set[str]()

    def assess(self, extension: Extension, selected: Sequence[SelectedCause]) -> Misfit:
        """The test of the laws with some causes."""
        searched, names = absorb_unknown(extension, selected), name_explained(selected)
        return assess_residuals(
            searched, extension.problem, self.n_bootstrap, self.rng, names, MAX_EXCEEDANCES
        )

    def assess_in_less_noise(
        self, extension: Extension, selected: Sequence[SelectedCause]
    ) -> tuple[Extension, Misfit]:
        """An extension and its test, in the noise without the structure that this finds."""
        test = self.assess(extension, selected)
        if test.p_value < self.level and (quieter := reduce_noise(extension, selected, test)):
            return quieter, self.assess(quieter, selected)
        return extension, test

    def add_causes(self, tell_found: Callable[[int], None]) -> None:
        """Add causes until nothing is left to be found."""
        most = self.extension.problem.max_causes
        while self.last.p_value < self.level and len(self.selected) < most and self.add_cause():
            tell_found(len(self.selected))

    def add_covered(self) -> bool:
        """Add a cause that other forms of the selected ones cover in the last test; whether there is one."""
        if self.last.p_value < self.level or len(self.selected) == self.extension.problem.max_causes:
            return False
        if (found := find_covered(self.extension, self.level)) is None:
            return False
        chosen = [*self.selected, found[0]]
        self.selected, extension = revise_causes(found[1], chosen, self.level, self.rng, n_last=1)
        self.extension, self.last = self.assess_in_less_noise(extension, self.selected)
        return True

    def add_cause(self) -> bool:
        """Add the cause that the last test shows; whether others may follow."""
        problem = self.extension.problem
        refits = refit_likeliest(problem, self.selected, self.last)
        self.last = refits.misfit
        self.failed.update(refits.failed)
        searched = absorb_unknown(self.extension, self.selected)
        chosen = self.choose_cause(refits, searched)
        if chosen[-1].version is None:
            self.selected = chosen
            return False
        extension = refits.extension_with(chosen) or extend_problem(problem, chosen)
        chosen, extension = follow_function(chosen, extension)
        if chosen[-1].cause == UNKNOWN and is_collinear(self.extension, extension):
            self.selected = [*chosen[:-1], replace(chosen[-1], version=None, start=np.zeros(0))]
            return False
        if self.selected and chosen[-1].cause != UNKNOWN:
            chosen, extension = revise_causes(extension, chosen, self.level, self.rng)
        elif any(one.cause == UNKNOWN for one in self.selected):
            # Of two effects that no cause describes, one may have been a cause's, which the other one hid.
            kinds = list(map(_kind, chosen))
            chosen, extension = revise_causes(extension, chosen, self.level, self.rng, n_last=1)
            if list(map(_kind, chosen)) != kinds:
                chosen, extension = revise_causes(extension, chosen, self.level, self.rng)
                searched = absorb_unknown(extend_problem(problem, chosen[:-1]), chosen[:-1])
        if is_open(extension):
            return False
        if _ends_search(chosen[-1], len(problem)):
            # The tests that would follow carry-over are for independent noise.
            if self.selected and not isinstance(chosen[-1].version, CarryOverTerm):
                self.last = self.assess(extension, chosen)  # something else may be needless
            self.selected, self.extension = chosen, extension
            return False
        extension, last = self.assess_in_less_noise(extension, chosen)
        if chosen[-1].cause == UNKNOWN and last.p_value >= self.level:
            chosen = self.replace_unknown(chosen, searched)
            if chosen[-1].cause != UNKNOWN:
                extension, last = self.assess_in_less_noise(extend_problem(problem, chosen), chosen)
        self.selected, self.extension, self.last = chosen, extension, last
        if chosen[-1].cause != UNKNOWN and not self.add_covered():
            self.exchange(problem, refits)
        return True

    def choose_cause(self, refits: Refits, searched: LinearizedFit) -> list[SelectedCause]:
        """The selected causes and the next one; unknown structure with a law for it where there is one."""
        problem, last, ahead_of_pairs = self.extension.problem, self.last, np.inf
        following = make_selected(last, form_cause_set(last), refits.starts)
        single = find_in_part(problem, searched, last, following.cause)
        if single.found is not None:
            self.last = last = single.found
            following = make_selected(last, form_cause_set(last))
        if following.cause == UNKNOWN and (new := find_new_column(last, self.selected)) is not None:
            following = make_selected(last, form_cause_set(last, new))
        if following.cause == UNKNOWN:
            pairs = first_of_pair(problem, self.selected, last)
            ahead_of_pairs = min(single.behind, pairs.behind)
            if pairs.found is not None:
                following = pairs.found.first
                self.combinations.append((following.cause, *pairs.found.others))
        support = assess_support(searched, last, following.cause)
        if support.too_narrow:
            broad = find_broad_cause(searched, last, following.cause)
            if broad == UNKNOWN and problem.skewness is None:
                self.influential = support.outlying
            following = make_selected(last, form_cause_set(last, broad), refits.starts)
        if following.cause != UNKNOWN:
            return [*self.selected, following]
        chosen = [*self.selected, replace(following, ahead_of_pairs=ahead_of_pairs)]
        chosen = propose_term(searched, chosen, problem.expressions, self.rng)
        return self.replace_unknown(chosen, searched) if _ends_search(chosen[-1], len(problem)) else chosen

    def replace_unknown(
        self, chosen: Sequence[SelectedCause], searched: LinearizedFit
    ) -> list[SelectedCause]:
        """A cause in the place of unknown structure that would end the search, if likelier beside such."""
        *others, unknown = chosen
        beside = find_beside_unknown(self.extension.problem, searched, unknown, self.level)
        if beside.found is not None:
            self.combinations.append((beside.found.first.cause, *beside.found.others))
            return [*others, beside.found.first]
        return [*others, replace(unknown, ahead_of_pairs=min(unknown.ahead_of_pairs, beside.behind))]

    def exchange(self, problem: DiagnosisProblem, refits: Refits) -> None:
        """Give the last cause its rivals, or one of these in its place if likelier with another cause.

        The `problem` is the one before it was selected.
        """
        exchange = find_exchange(problem, self.selected, self.extension, self.last, refits, self.level)
        *others, current = self.selected
        self.selected = [*others, replace(current, cause_set=current.cause_set.with_rivals(exchange.rivals))]
        if exchange.found is None:
            return
        first = exchange.found.first
        trial = [*others, replace(first, cause_set=first.cause_set.with_rivals([current.cause]))]
        other = refits.extension_with(trial) or try_extension(problem, trial)
        if other is not None and (test := self.assess(other, trial)).p_value < self.level:
            self.combinations.append((trial[-1].cause, *exchange.found.others))
            self.selected, self.extension, self.last = trial, other, test

    def drop_needless(self, most: float) -> None:
        """Drop causes without which nothing is found, and the law is less likely by at most `most` nats."""
        while len(self.selected) > 1 and self.last.p_value >= self.level:
            needed = self.find_needed(most + CLEARLY_ABOVE)
            for others, extension in find_needless(self.extension, self.selected, most, needed):
                if (without := self.assess(extension, others)).p_value >= self.level:
                    self.selected, self.extension, self.last = others, extension, without
                    break
            else:
                break

    def find_needed(self, least: float) -> list[int]:
        """Places of causes that a test with all others in the law showed, by at least so many nats.

        Of the last one it is that which selected it, unless another one has been selected again since.
        """
        as_found = all(one.naming is None for one in self.selected)
        places = [k for k, one in enumerate(self.selected) if one.naming is not None]
        places += [len(self.selected) - 1] if as_found else []
        tests = {k: self.selected[k].misfit for k in places}
        return [k for k, test in tests.items() if test is not None and test.statistic > least]


def select_last(
    extension: Extension, selected: Sequence[SelectedCause], alpha: float, rng: np.random.Generator
) -> SelectedCause:
    """What a search selects after some causes, whose law is the extension, where nothing follows that."""
    searched = absorb_unknown(extension, selected)
    test = compute_evidence(searched, extension.problem, name_explained(selected))
    refits = refit_likeliest(extension.problem, selected, test)
    search = _ForwardSelection(extension, refits.misfit, alpha, 0, rng)
    search.selected = list(selected)
    chosen = search.choose_cause(refits, searched)
    if chosen[-1].cause == UNKNOWN and not _ends_search(chosen[-1], len(extension.problem)):
        chosen = search.replace_unknown(chosen, searched)
    return chosen[-1]


def widen_selection(selection: Selection, causes: Sequence[Any], alpha: float) -> Selection | None:
    """The selection as one from more causes; None where one of these could have been selected.

    Beside the one selected cause they would be found in what it leaves. In its place they would need its
    evidence, of which a refit changes less than half. With several causes each may make room for others.
    """
    problem, last, baseline = selection.problem, selection.last_misfit, selection.problem.linearize()
    names = {one.cause for one in selection.law_causes}
    if len(selection.law_causes) != 1 or UNKNOWN in names:
        return None
    known = {one.name for one in problem.causes}
    more = [one for one in causes if one.name not in known]
    extension = Extension(problem, selection.fit, tuple(selection.law_causes))
    searched = absorb_unknown(extension, selection.selected)
    beside = add_candidates(last, searched, compute_finite_effects(searched, more))
    either = [one for one in causes if one.name not in known - names]
    alone = weigh_causes(baseline, compute_finite_effects(baseline, either))
    most = max((value for name, value in alone.items() if name not in known), default=-np.inf)
    left = max((beside.log_evidence_by_cause.get(one.name, -np.inf) for one in more), default=-np.inf)
    enough = MIN_EVIDENCE_SHARE * max(alone.get(name, -np.inf) for name in names)
    if not (most < enough and left < last.critical_value(allocate_alpha(alpha))):
        return None
    last = replace(
        last,
        hypotheses=beside.hypotheses,
        log_evidence=beside.log_evidence,
        log_evidence_by_cause=beside.log_evidence_by_cause,
    )
    return replace(selection, problem=replace(problem, causes=tuple(causes)), last_misfit=last)


def _ends_search(selected: SelectedCause, n: int) -> bool:
    """Whether nothing can be found beside unknown structure, among n rows.

    There is no law for it, or one of what carries over, or with many parameters of each session.
    """
    version: Any = selected.version
    if version is None or isinstance(version, CarryOverTerm):
        return True
    most = min(MAX_OWN_PARAMETERS, n // ROWS_PER_PARAMETER) if getattr(version, "sessions", ()) else np.inf
    return selected.cause == UNKNOWN and len(version.parameters) > most


def _kind(selected: SelectedCause) -> tuple[str, type, tuple[str, ...]]:
    """What a selected cause, or a law for unknown structure, is, whatever its size or form."""
    return selected.cause, type(selected.version), getattr(selected.version, "carriers", ())


def follows(selected: SelectedCause, carrier: str) -> bool:
    """Whether a carrier is that of the unknown structure that was selected."""
    if selected.cause != UNKNOWN or selected.misfit is None:
        return False
    return selected.misfit.best_hypothesis(UNKNOWN).cause == f"{UNKNOWN}:{carrier}"


def find_broad_cause(linearized: LinearizedFit, misfit: Misfit, narrow: str) -> str:
    """The likeliest cause after one that rests on few rows, likelier than `UNKNOWN`, that does not."""
    least = misfit.log_evidence_by_cause.get(UNKNOWN, 0.0) + PAIR_MIN_LOG_BAYES_FACTOR
    others = misfit.rank_causes(least, [narrow])
    broad = (cause for cause in others if not assess_support(linearized, misfit, cause).too_narrow)
    return next(broad, UNKNOWN)


def find_cancelled(selection: Selection) -> set[str]:
    """Causes most of which a function without a name beside them takes back.

    Such a function bends as the data ask and is expected to be as large as what it was found in, which was
    larger with the cause in the law: the two say no more than the function alone.
    """
    named = [one for one in selection.law_causes if one.cause != UNKNOWN]
    unnamed = [one for one in selection.law_causes if one.cause == UNKNOWN]
    if not named or not unnamed:
        return set()
    linearized = selection.problem.linearize()

    def effect(one: SelectedCause) -> Array:
        values = selection.fit.values[selection.place_of(one.version)]
        change = compute_changes(linearized, one.version, values[None])
        return linearized.project(linearized.whiten(change))[:, 0]

    size = np.linalg.norm
    effects, functions = {one.cause: effect(one) for one in named}, [effect(one) for one in unnamed]
    return {
        cause
        for cause, own in effects.items()
        for function in functions
        if size(own + function) < MAX_LEFT_OF_BOTH * min(size(own), size(function))
    }


def explain_outliers(selection: Selection, problem: DiagnosisProblem, outliers: IntArray) -> IntArray:
    """Which of the rows that took no part in a selection its law explains after all.

    `outliers` are positions in `problem`; a law without causes explains none. A law with functions that bend
    as the data ask leaves them less than it errs where they are not fitted: what is no farther off is no
    gross error.
    """
    if not selection.law_causes or not len(outliers):
        return outliers[:0]
    departure = predict_departures(selection, problem, outliers)
    # Of a joint and direction with few rows the repeatability may be far too small.
    noise = selection.expected.repeatability[problem.noise_group[outliers]]
    noise = noise * np.broadcast_to(problem.relative_sd, len(problem))[outliers]
    free = 1.0 - np.minimum(problem.linearize().leverage[outliers], MAX_LEVERAGE)
    sd = np.sqrt((noise**2 + problem.rounding[outliers]) / free)  # of predictions by the other rows
    sd *= max(_leave_one_out_scale(selection), 1.0)
    return outliers[(departure != 0) & (np.abs(departure) < OUTLYING_SD * sd)]


def _leave_one_out_scale(selection: Selection) -> float:
    """Standard deviation of the rows' departures from the law fitted without each, in units of the noise.

    By what 5 % of them exceed: a function may fit most of a travel closely, and fail where it is rough. Of a
    penalised fit they are its residuals over one less the leverage (G. Wahba, Spline Models for Observational
    Data, 1990, Theorem 4.2.1).
    """
    fit = selection.fit
    linearized, slopes = selection.problem.linearize_causes(fit)
    information = slopes.T @ slopes + np.diag(1.0 / np.square(fit.prior_sd))
    leverage = linearized.leverage + np.sum(slopes * (slopes @ np.linalg.pinv(information)), axis=1)
    departures = linearized.residual / np.maximum(1.0 - leverage, MIN_FREE)
    return float(np.quantile(np.abs(departures), 0.95)) / Z_95


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
        extension = extend_problem(selection.problem, selected)
        problem, fit, linearized = extension.problem, extension.fit, extension.linearized
    else:
        baseline = reestimate_noise(selection.problem)
        problem, linearized = baseline.problem, baseline.linearized
        fit = problem.fit_extended()
    return replace(selection, problem=problem, selected=selected, fit=fit, linearized=linearized)


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
    fit = problem.fit_extended()
    return Selection(problem, NO_ROWS, (), misfit, misfit, 1.0, fit, problem.linearize())
