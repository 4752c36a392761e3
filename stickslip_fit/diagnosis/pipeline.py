"""diagnose: the whole diagnosis of a log, in the order of the mathematics. Start reading here.

1. `problem`: the log becomes a `DiagnosisProblem`: rows with their laws, responses and noise. Any other table
   becomes one in `table`, whose autocorrelated noise `autocorrelation` estimates and removes.
2. `gross_errors`: counts that are set aside before anything is estimated, and tested again at the end.
3. `linearized`: whitened residuals and effects, the calibration parameters projected out.
4. `hypotheses`: what could be wrong, each as a subspace of effects; `alternatives` without a cause
   (`memory`, `smooth_alternatives`) stand for "unknown", and `testability` says what a log could show.
5. `noise`: repeatability, noisy configurations, outlying counts; `unevenness`: where noise is many times
   larger; `noise_shape`: skewed or coarsely rounded noise.
6. `misfit`: is anything wrong? Bayes factors (`evidence`) and the p-value.
7. `selection`: forward selection of causes, by `extension` of the laws and `refits`, with the causes that
   the data cannot separate (`cause_set`) and those that show only together (`combinations`); `influence`:
   none rests on one or two rows. `proposed_term`: a law for structure without a name.
8. `effect_size`: parameters and effects of the selected causes, with intervals (`finding`,
   `effect_interval`, `unknown_size`).
9. `cross_validation`, `gain`, `gain_interval`: the held-out error with the causes in the law;
   `withdrawal`: a cause that does not predict better is not named.
10. `candidate_traverses`, `experiments`: the traverses that separate what the log cannot.
11. `stage_change`: which change of friction, mass, voltage or ramp time the findings stand for
    (`stage_fingerprint`). After 7 it chooses the laws anew where the log itself chooses them.

`result` holds the `Diagnosis`; `separability` asks the same of a plan before any data; `residuals`
prepares the figures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._threads import one_blas_thread
from stickslip_fit.causes import Cause
from stickslip_fit.diagnosis.cause_set import cause_probabilities
from stickslip_fit.diagnosis.effect_size import size_findings
from stickslip_fit.diagnosis.experiments import next_experiment
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.gross_errors import (
    find_gross_errors,
    set_aside,
    with_gross_errors,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit, rms
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnosis.problem import DiagnosisProblem, problem_from_log
from stickslip_fit.diagnosis.result import Diagnosis, choose_verdict
from stickslip_fit.diagnosis.selection import (
    Selection,
    allocate_alpha,
    empty_selection,
    explain_outliers,
    select_causes,
    settle_noise,
    widen_selection,
)
from stickslip_fit.diagnosis.separability import find_aliased_causes
from stickslip_fit.diagnosis.stage_change import choose_laws_anew, read_stage
from stickslip_fit.diagnosis.testability import NO_TRIALS, explain_too_small, find_untestable, is_log
from stickslip_fit.errors import check_alpha, check_count
from stickslip_fit.laws import Laws
from stickslip_fit.logs import Log

SEARCH_STEP, SEARCH_START, SEARCH_END = "searching for causes", 0.05, 0.2  # shares of the work
GROSS_ALPHA_SHARE = 0.1  # of the false-alarm rate, for gross errors
MAX_SEARCHES = 4  # each with fewer rows, or with rows that came back
BOOTSTRAP_PER_ALARM = 20  # bootstrap samples for each expected false alarm
OUTLIER_INCLUSION = 0.99
NOISE_LEFT = 0.7  # of the noise, below which causes that were untestable in it are asked for again
MAX_INCLUSION_WITHOUT_ALARM = 0.5  # of all causes together, where the misfit is not significant

CheckedProblem = tuple[DiagnosisProblem, Mapping[str, str]]
"""A problem, and the causes for which the data lack a variable, with the reason."""


@one_blas_thread
def diagnose(
    log: Log,
    *,
    laws: Laws | None = None,
    causes: Iterable[Cause] | None = None,
    alpha: float = 0.01,
    seed: int = 0,
    gain: bool = True,
    progress: ProgressCallback = ignore_progress,
) -> Diagnosis:
    """Test the laws on a log, name the causes of a misfit, and measure what the causes gain.

    Parameters
    ----------
    log : Log
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    causes : iterable of Cause, optional
        Candidates; without it the library and the lab's own columns.
    alpha : float, optional
        False-alarm rate over all tests.
    seed : int, optional
    gain : bool, optional
        False only names the causes: no gain, no next experiment and no change of the stage, in a fraction of
        the time; `Diagnosis.measure_gain`, `next_experiment` and `read_stage` do the rest.
    progress : callable, optional
        Called with the step that begins and the share of the work that is done.

    Raises
    ------
    InputError
        If the log has no usable traverse, `alpha` is not between 0.001 and 0.2, or `seed` is negative.
    """
    began = time.perf_counter()
    check_alpha(alpha)
    check_count("seed", seed, least=0)
    progress("fitting the laws", 0.0)
    problem, missing = problem_from_log(log, causes, laws)

    def under_other_laws(selection: Selection) -> CheckedProblem | None:
        chosen = choose_laws_anew(log, selection, laws)
        return problem_from_log(log, causes, chosen) if chosen else None

    diagnosis = diagnose_problem(
        problem, missing, alpha=alpha, seed=seed, progress=progress, replace_problem=under_other_laws
    )
    diagnosis = replace(diagnosis, log=log, seconds=time.perf_counter() - began)
    if not gain:
        return diagnosis
    diagnosis = diagnosis.measure_gain(progress=progress)
    stage = read_stage(diagnosis.selection, diagnosis.findings, log.machine)
    return replace(diagnosis, next_experiment=next_experiment(diagnosis), stage=stage)


def diagnose_problem(
    problem: DiagnosisProblem,
    missing: Mapping[str, str],
    *,
    alpha: float,
    seed: int = 0,
    progress: ProgressCallback = ignore_progress,
    replace_problem: Callable[[Selection], CheckedProblem | None] = lambda selection: None,
) -> Diagnosis:
    """Name what is wrong with any laws, whatever machine they describe.

    Parameters
    ----------
    problem : DiagnosisProblem
    missing : mapping of str to str
        Causes for which the data lack a variable, with the reason.
    alpha, seed, progress
        As of `diagnose`.
    replace_problem : callable, optional
        Called with what was selected: another problem in the place of this one, and what is missing in it;
        None where it stays.

    Raises
    ------
    InputError
        As `diagnose`.
    """
    began = time.perf_counter()
    check_alpha(alpha)
    check_count("seed", seed, least=0)
    progress(SEARCH_STEP, SEARCH_START)
    rng = np.random.default_rng(seed)
    gross = find_gross_errors(problem, GROSS_ALPHA_SHARE * alpha)
    next_aside, p_value = gross.rows, max(gross.p_value, 1.0 / (1 + bootstrap_size(alpha)))

    def tell_found(number: int) -> None:
        share = number / problem.max_causes
        progress(f"{SEARCH_STEP}, {number} found", SEARCH_START + share * (SEARCH_END - SEARCH_START))

    for _ in range(MAX_SEARCHES):
        aside = next_aside  # the rows that the last search was made without, also if it asks for one more
        for search in _search(set_aside(problem, aside), missing, alpha, rng, tell_found):
            found = search.selection
            if other := replace_problem(with_gross_errors(found, len(problem), aside, p_value)):
                return diagnose_problem(*other, alpha=alpha, seed=seed, progress=progress)
        kept = np.setdiff1d(np.arange(len(problem)), aside)
        if len(found.influential):
            kept = np.delete(kept, found.outliers)
            next_aside = np.union1d(aside, kept[found.influential])
            p_value = min(p_value, found.p_value)
        elif len(back := explain_outliers(found, problem, aside)):
            next_aside = np.setdiff1d(aside, back)
        elif len(found.outliers):
            out = np.union1d(aside, kept[found.outliers])
            hidden = find_gross_errors(problem, GROSS_ALPHA_SHARE * alpha, out)
            if not len(hidden.rows):
                break
            next_aside, p_value = np.union1d(out, hidden.rows), min(p_value, found.p_value)
        else:
            break
    selection = settle_noise(with_gross_errors(found, len(problem), aside, p_value))
    findings = size_findings(selection, problem, alpha) if selection.p_value < alpha else ()
    searched = selection.problem
    return Diagnosis(
        verdict=choose_verdict(findings),
        findings=findings,
        p_value=selection.p_value,
        misfit=_rms_left(search),
        repeatability=np.nan if search.too_small else rms(searched.noise_sd),
        inclusion=_inclusion_probabilities(selection, search.problem, search.untestable, alpha),
        untestable=search.untestable,
        alpha=alpha,
        seed=seed,
        seconds=time.perf_counter() - began,
        selection=selection,
        aliased_causes=find_aliased_causes(selection.first_misfit),
        noise_properties=_noise_properties(selection, findings),
        notes=_search_notes(search.problem, selection.first_misfit),
    )


def _rms_left(search: _Search) -> float:
    """Rms that the baseline leaves of all rows that do not count as outliers."""
    linearized, outliers = search.linearized, search.selection.outliers
    if len(outliers):
        linearized = search.problem.without_rows(outliers).linearize()
    return rms(linearized.unwhiten(linearized.residual))


def _noise_properties(selection: Selection, findings: tuple[Finding, ...]) -> tuple[str, ...]:
    """In which the noise is not as assumed."""
    problem = selection.problem
    present = {
        "memory": any(
            one.cause == UNKNOWN
            and (one.carrier.startswith("memory") or selection.behind(one).resembles_memory)
            for one in findings
        ),
        "skewed": problem.skewness is not None,
        "rounded": problem.spacing is not None,
        "gross errors": any(one.cause == problem.outlier_cause for one in findings),
        "uneven": len(problem.uneven) > 0,
    }
    return tuple(name for name, is_present in present.items() if is_present)


def _search_notes(problem: DiagnosisProblem, misfit: Misfit) -> tuple[str, ...]:
    """What the search left out of the causes that it could look for."""
    lost = [
        f"{number:,} of the {tried:,} trials of {cause} are left out: their effects are no numbers, or their "
        "equations have no solution."
        for cause, (number, tried) in misfit.failed.items()
        if number < tried
    ]
    gaps = [str(getattr(cause, "search_note", "")) for cause in problem.causes]
    return (*lost, *filter(None, gaps))


NO_ALTERNATIVE = "the log has neither times nor enough repeated configurations, in which more could show"
NO_COLUMN = (
    "no column beside the response could explain it; name the time, or 'order' in its place where rows stand "
    "in the order of measurement"
)


@dataclass(frozen=True, eq=False)
class _Search:
    """A selection, the problem with the causes that were searched, and why the others were not."""

    selection: Selection
    problem: DiagnosisProblem
    linearized: LinearizedFit
    untestable: Mapping[str, str]
    too_small: str | None


def _search(
    problem: DiagnosisProblem,
    missing: Mapping[str, str],
    alpha: float,
    rng: np.random.Generator,
    tell_found: Callable[[int], None],
) -> Iterator[_Search]:
    """What is selected; then, if it is searched again in more causes, what is selected of all."""
    linearized = problem.linearize()
    too_small = explain_too_small(linearized)
    if not too_small and problem.autocorrelation is not None:
        problem = problem.with_autocorrelation()
        linearized = problem.linearize()
    if too_small:
        unable = dict.fromkeys([*(cause.name for cause in problem.causes), UNKNOWN], too_small)
    else:
        unable = find_untestable(problem, linearized)
        if next(iter(problem.alternatives(linearized)), None) is None:
            unable[UNKNOWN] = NO_ALTERNATIVE if is_log(linearized) else NO_COLUMN
    testable = _without(problem, unable)
    if UNKNOWN in unable and not any(cause.name != problem.outlier_cause for cause in testable.causes):
        too_small = too_small or unable[UNKNOWN]
    select = partial(
        select_causes, alpha=alpha, n_bootstrap=bootstrap_size(alpha), rng=rng, tell_found=tell_found
    )
    selection = empty_selection(testable) if too_small else select(testable)
    shown = _testable_beside(selection, problem, linearized, unable)
    wider = _without(problem, unable.keys() - shown)
    whole = widen_selection(selection, wider.causes, alpha) if shown else selection
    unable = {cause: reason for cause, reason in unable.items() if cause not in shown}

    def describe(found: Selection) -> _Search:
        failed = dict.fromkeys(found.failed, "it could not be fitted: with it the equations have no solution")
        trials = found.first_misfit.failed
        failed |= {cause: NO_TRIALS for cause, (number, tried) in trials.items() if number == tried}
        return _Search(found, wider, linearized, {**missing, **unable, **failed}, too_small)

    yield describe(whole or selection)
    if whole is None:
        yield describe(select(wider))


def _without(problem: DiagnosisProblem, names: Iterable[str]) -> DiagnosisProblem:
    """The problem without some of its causes."""
    return replace(problem, causes=tuple(cause for cause in problem.causes if cause.name not in names))


def _testable_beside(
    selection: Selection, problem: DiagnosisProblem, linearized: LinearizedFit, unable: Mapping[str, str]
) -> set[str]:
    """Causes, untestable in the noise of `problem`, that the log could show in the noise that is left.

    Without replicates, whatever the law does not describe counts as noise until its cause is in the law.
    """
    left = selection.problem
    if not selection.law_causes or rms(left.scale) > NOISE_LEFT * rms(linearized.scale):
        return set()
    asked = [cause.name for cause in problem.causes if unable.get(cause.name, NO_TRIALS) != NO_TRIALS]
    others = [cause.name for cause in problem.causes if cause.name not in asked]
    quieter = replace(_without(problem, others), repeatability=left.repeatability)
    return {*asked} - find_untestable(quieter, quieter.linearize()).keys()


def bootstrap_size(alpha: float) -> int:
    """Bootstrap samples for a false-alarm rate, of which the misfit test has a share of 3/4."""
    return int(np.ceil(1.5 * BOOTSTRAP_PER_ALARM / alpha))


def _inclusion_probabilities(
    selection: Selection, problem: DiagnosisProblem, untestable: Mapping[str, str], alpha: float
) -> dict[str, float | None]:
    """Probability of each cause: of a selected one when it was selected, of all others in the last test."""
    last = cause_probabilities(selection.last_misfit.log_evidence_by_cause)
    if not selection.last_misfit.p_value < allocate_alpha(alpha):
        # Without an alarm the evidence is within chance, so that all causes share at most one half.
        last = {
            cause: value * min(1.0, MAX_INCLUSION_WITHOUT_ALARM / max(sum(last.values()), 1e-300))
            for cause, value in last.items()
        }
    inclusion: dict[str, float | None] = dict.fromkeys([*(c.name for c in problem.causes), UNKNOWN], 0.0)
    inclusion |= last
    for selected in selection.selected:
        if selected.misfit is None:
            inclusion[selected.cause] = OUTLIER_INCLUSION
            continue
        for cause, probability in selected.cause_set.probability.items():
            if cause == selected.cause or cause in selected.cause_set.rivals:
                inclusion[cause] = max(probability, inclusion.get(cause) or 0.0)
    return inclusion | dict.fromkeys(untestable)
