"""The whole of a diagnosis, step by step."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from stickslip_fit.causes import Cause
from stickslip_fit.diagnose.diagnosis import Diagnosis, Finding, Verdict
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.of_log import bench_of
from stickslip_fit.diagnose.progress import Progress, silent
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.diagnose.searching.naming import probabilities
from stickslip_fit.diagnose.searching.search import Search, search
from stickslip_fit.diagnose.searching.testable import untestable
from stickslip_fit.diagnose.searching.too_small import not_searched, too_small
from stickslip_fit.diagnose.shapes.alike import alike
from stickslip_fit.diagnose.sizes.findings import findings
from stickslip_fit.diagnose.worth.with_gain import with_gain
from stickslip_fit.logs import Log

# Logs in which nothing is wrong, for each false alarm that may be raised.
FLIPS_PER_ALARM = 20
CERTAIN = 0.99
WITHOUT_ALARM = 0.5  # where nothing raised an alarm, something is at most as likely as nothing


def diagnose(
    log: Log,
    *,
    causes: Iterable[Cause] | None = None,
    alpha: float = 0.01,
    seed: int = 0,
    progress: Progress = silent,
) -> Diagnosis:
    """Find out what the published laws get wrong in a log, why, and what knowing it gains.

    Parameters, result and errors are those of `decide`.
    """
    decided = decide(log, causes=causes, alpha=alpha, seed=seed, progress=progress)
    if any(finding.equivalent for finding in decided.findings):
        from stickslip_fit.diagnose.experiments.ahead import ahead
        from stickslip_fit.diagnose.experiments.next_experiment import next_experiment

        forecasts = ahead(decided.search.bench, log.machine)
        wanted = next_experiment(decided.search, decided.findings, forecasts)
        decided = replace(decided, next_experiment=wanted)
    return with_gain(decided, log.machine, progress=progress)


def decide(
    log: Log,
    *,
    causes: Iterable[Cause] | None = None,
    alpha: float = 0.01,
    seed: int = 0,
    progress: Progress = silent,
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
    decided = judge(*bench_of(log, causes), alpha=alpha, seed=seed, progress=progress)
    return replace(
        decided,
        seconds=time.perf_counter() - began,
        log_file=log.sources[0][0] if log.sources else "",
        log_sha256=log.sha256,
    )


def judge(
    given: Bench, missing: Mapping[str, str], *, alpha: float, seed: int = 0, progress: Progress = silent
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
    study = given.study()
    why = too_small(study)
    unable = {**missing, **(_all_of(given, why) if why else untestable(given, study))}
    bench = replace(given, causes=tuple(each for each in given.causes if each.name not in unable))
    progress("searching for causes", 0.05)
    rng = np.random.default_rng(seed)
    searched = not_searched(bench) if why else search(bench, alpha, flips(alpha), rng)
    sized = findings(searched, bench, alpha) if searched.p_value < alpha else ()
    return Diagnosis(
        verdict=_verdict(sized),
        findings=sized,
        p_value=searched.p_value,
        misfit=float(np.sqrt(np.mean((study.residual * given.scale) ** 2))),
        repeatability=np.nan if why else _pooled(searched.bench),
        inclusion=_inclusion(searched, bench, unable),
        untestable=unable,
        gain=None,
        gain_new_session=None,
        next_experiment=(),
        alpha=alpha,
        seed=seed,
        seconds=time.perf_counter() - began,
        log_file="",
        log_sha256="",
        search=searched,
        alike=alike(searched.first),
    )


def flips(alpha: float) -> int:
    """Logs in which nothing is wrong that an alarm rate needs; more than for one look, since two share it."""
    return int(np.ceil(1.5 * FLIPS_PER_ALARM / alpha))


def _all_of(given: Bench, why: str) -> dict[str, str]:
    return dict.fromkeys([*(cause.name for cause in given.causes), UNKNOWN], why)


def _pooled(bench: Bench) -> float:
    return float(np.sqrt(np.mean((bench.repeatability[bench.drive] * bench.uneven) ** 2)))


def _verdict(sized: tuple[Finding, ...]) -> Verdict:
    if not sized:
        return "nothing wrong"
    if sized[0].cause == UNKNOWN:
        return "unknown cause"
    return "cannot tell apart" if sized[0].equivalent else "cause named"


def _inclusion(searched: Search, bench: Bench, unable: dict[str, str]) -> dict[str, float | None]:
    """Probability of each cause: of those found at the look that found them, of all others at the last."""
    last = probabilities(searched.last.by_cause)
    if not searched.found:
        # What chance explains too is no evidence, however well some shape follows it.
        last = {cause: value * min(1.0, WITHOUT_ALARM / sum(last.values())) for cause, value in last.items()}
    found: dict[str, float | None] = dict.fromkeys([*(cause.name for cause in bench.causes), UNKNOWN], 0.0)
    found |= last
    for each in searched.found:
        if each.misfit is not None:
            for cause, probability in each.naming.probability.items():
                if cause == each.cause or cause in each.naming.rivals:
                    found[cause] = max(probability, found.get(cause) or 0.0)
        else:
            found[each.cause] = CERTAIN
    return found | dict.fromkeys(unable)
