"""diagnose: the whole diagnosis of a log, step by step. Start reading here.

The log becomes a `DiagnosisProblem` (`problem`): rows with their laws, responses and noise, linearized
by `linearized`. `hypotheses` lists what could be wrong, `misfit` tests whether anything is, `selection`
names causes one by one, `effect_size` estimates them and `gain` measures the held-out error with them
in the law (`cross_validation`). `experiments` proposes the traverse that separates causes the log
cannot separate.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from stickslip_fit._io import ProgressCallback, ignore_progress
from stickslip_fit.causes import Cause
from stickslip_fit.diagnosis.effect_size import size_findings
from stickslip_fit.diagnosis.gain import measure_gain
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.problem import DiagnosisProblem, problem_from_log
from stickslip_fit.diagnosis.result import Diagnosis, Finding, Verdict
from stickslip_fit.diagnosis.selection import (
    Selection,
    cause_probabilities,
    empty_selection,
    explain_too_small,
    find_untestable,
    select_causes,
)
from stickslip_fit.diagnosis.separability import find_aliased_causes
from stickslip_fit.logs import Log

# Logs in which nothing is wrong, for each false alarm that may be raised.
BOOTSTRAP_PER_ALARM = 20
OUTLIER_INCLUSION = 0.99
MAX_INCLUSION_WITHOUT_ALARM = 0.5  # where nothing raised an alarm, something is at most as likely as nothing


def diagnose(
    log: Log,
    *,
    causes: Iterable[Cause] | None = None,
    alpha: float = 0.01,
    seed: int = 0,
    progress: ProgressCallback = ignore_progress,
) -> Diagnosis:
    """Find out what the published laws get wrong in a log, why, and what knowing it gains.

    Parameters, result and errors are those of `decide`.
    """
    diagnosis = find_causes(log, causes=causes, alpha=alpha, seed=seed, progress=progress)
    if any(finding.equivalent for finding in diagnosis.findings):
        from stickslip_fit.diagnosis.candidate_traverses import forecast_candidates
        from stickslip_fit.diagnosis.experiments import next_experiment

        forecasts = forecast_candidates(diagnosis.search.problem, log.machine)
        wanted = next_experiment(diagnosis.search, diagnosis.findings, forecasts)
        diagnosis = replace(diagnosis, next_experiment=wanted)
    return measure_gain(diagnosis, log.machine, progress=progress)


def find_causes(
    log: Log,
    *,
    causes: Iterable[Cause] | None = None,
    alpha: float = 0.01,
    seed: int = 0,
    progress: ProgressCallback = ignore_progress,
) -> Diagnosis:
    """Find out what the published laws get wrong in a log, and why; no gain, no next experiment.

    Parameters
    ----------
    log : Log
    causes : iterable of Cause, optional
        To choose from; the library and the lab's own columns without it.
    alpha : float, optional
        False-alarm rate.
    seed : int, optional
    progress : callable, optional
        Is told what begins, and the share of the work that is done.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        If the log has no usable traverse.
    """
    began = time.perf_counter()
    progress("fitting the published law", 0.0)
    diagnosis = diagnose_problem(*problem_from_log(log, causes), alpha=alpha, seed=seed, progress=progress)
    return replace(
        diagnosis,
        seconds=time.perf_counter() - began,
        log_file=log.sources[0][0] if log.sources else "",
        log_sha256=log.sha256,
    )


def diagnose_problem(
    given: DiagnosisProblem,
    missing: Mapping[str, str],
    *,
    alpha: float,
    seed: int = 0,
    progress: ProgressCallback = ignore_progress,
) -> Diagnosis:
    """Find out what is wrong with the laws on a bench, whatever they describe.

    Parameters
    ----------
    given : Bench
    missing : mapping of str to str
        Causes of which there is nothing to see, and why.
    alpha : float
        False-alarm rate.
    seed : int, optional
    progress : callable, optional

    Returns
    -------
    Diagnosis
        Of no file.
    """
    began = time.perf_counter()
    linearized = given.study()
    why = explain_too_small(linearized)
    unable = {**missing, **(_mark_untestable(given, why) if why else find_untestable(given, linearized))}
    problem = replace(given, causes=tuple(each for each in given.causes if each.name not in unable))
    progress("searching for causes", 0.05)
    rng = np.random.default_rng(seed)
    selection = empty_selection(problem) if why else select_causes(problem, alpha, bootstrap_size(alpha), rng)
    sized = size_findings(selection, problem, alpha) if selection.p_value < alpha else ()
    return Diagnosis(
        verdict=_choose_verdict(sized),
        findings=sized,
        p_value=selection.p_value,
        misfit=float(np.sqrt(np.mean((linearized.residual * given.scale) ** 2))),
        repeatability=np.nan if why else _pool_repeatability(selection.problem),
        inclusion=_inclusion_probabilities(selection, problem, unable),
        untestable=unable,
        gain=None,
        gain_new_session=None,
        next_experiment=(),
        alpha=alpha,
        seed=seed,
        seconds=time.perf_counter() - began,
        log_file="",
        log_sha256="",
        search=selection,
        aliased_causes=find_aliased_causes(selection.first),
    )


def bootstrap_size(alpha: float) -> int:
    """Logs in which nothing is wrong that an alarm rate needs; more than for one look, since two share it."""
    return int(np.ceil(1.5 * BOOTSTRAP_PER_ALARM / alpha))


def _mark_untestable(given: DiagnosisProblem, why: str) -> dict[str, str]:
    return dict.fromkeys([*(cause.name for cause in given.causes), UNKNOWN], why)


def _pool_repeatability(problem: DiagnosisProblem) -> float:
    return float(np.sqrt(np.mean((problem.repeatability[problem.drive] * problem.uneven) ** 2)))


def _choose_verdict(sized: tuple[Finding, ...]) -> Verdict:
    if not sized:
        return "nothing wrong"
    if sized[0].cause == UNKNOWN:
        return "unknown cause"
    return "cannot tell apart" if sized[0].equivalent else "cause named"


def _inclusion_probabilities(
    selection: Selection, problem: DiagnosisProblem, unable: dict[str, str]
) -> dict[str, float | None]:
    """Probability of each cause: of those found at the look that found them, of all others at the last."""
    last = cause_probabilities(selection.last.log_evidence_by_cause)
    if not selection.found:
        # What chance explains too is no evidence, however well some shape follows it.
        last = {
            cause: value * min(1.0, MAX_INCLUSION_WITHOUT_ALARM / sum(last.values()))
            for cause, value in last.items()
        }
    found: dict[str, float | None] = dict.fromkeys([*(cause.name for cause in problem.causes), UNKNOWN], 0.0)
    found |= last
    for each in selection.found:
        if each.misfit is not None:
            for cause, probability in each.cause_set.probability.items():
                if cause == each.cause or cause in each.cause_set.rivals:
                    found[cause] = max(probability, found.get(cause) or 0.0)
        else:
            found[each.cause] = OUTLIER_INCLUSION
    return found | dict.fromkeys(unable)
