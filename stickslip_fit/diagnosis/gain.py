"""The gain of a diagnosis: rms error on held-out traverses, without and with each finding in the law.

`measure_gain` makes the splits, repeats the selection in each of them and adds the gains to the
diagnosis. The interval of the gain comes from `gain_interval`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._io import ProgressCallback, ignore_progress
from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.cross_validation import (
    Selector,
    Split,
    compute_held_out_errors,
    hold_out_sessions,
    make_folds,
)
from stickslip_fit.diagnosis.gain_interval import (
    MAX_LEVERAGE,
    CompetingCauses,
    LinearizedCampaign,
    log_likelihood_ratio,
    simulate_gain_interval,
    subtract_calibration,
)
from stickslip_fit.diagnosis.hypotheses import Hypothesis, compute_changes, number_configurations
from stickslip_fit.diagnosis.intervals import threshold_length
from stickslip_fit.diagnosis.misfit import STRENGTHS, UNKNOWN, Misfit
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.result import Diagnosis, Finding, Gain
from stickslip_fit.diagnosis.selection import SelectedCause, Selection, allocate_alpha, select_causes
from stickslip_fit.machine import Machine

SplitProgress = Callable[[int, int], None]


def estimate_gain(
    selection: Selection,
    findings: Sequence[Finding],
    splits: Sequence[Split],
    selector: Selector,
    *,
    others: Sequence[Sequence[Split]] = (),
    alpha: float,
    seed: int = 0,
    workers: int = -1,
    progress: SplitProgress | None = None,
) -> tuple[Gain, tuple[Finding, ...]]:
    """Repeat the search in each split and see how much better it predicts what was held out.

    Parameters
    ----------
    searched : Search
        Of the whole log; what it called misfires takes no part.
    findings : sequence of Finding
        Of the whole log. Those that extend no law gain nothing.
    splits : sequence of Split
        Of the rows of `searched.bench`; at least one.
    seek : callable
        The search, from a bench and a generator.
    others : sequence of sequence of Split, optional
        As the splits of a fresh replicate may be; the same without them.
    alpha : float
        Of that search.
    seed : int, optional
    workers : int, optional
        Processes; all cores without it. The answer is the same.
    progress : callable, optional
        Told how many splits are done, and of how many.

    Returns
    -------
    gain : Gain
    findings : tuple of Finding
        The same, each with its own gain.
    """
    extending = [each for each in findings if each.version is not None]
    if extending:
        off = _collect_errors(selection, extending, splits, selector, seed, workers, progress)
        found = [_find_selected(selection, each) for each in extending]
        rms, rng = np.sqrt(np.mean(off**2, axis=1)), np.random.default_rng([seed, 1])
        limits = simulate_gain_interval(
            _linearize_campaign(selection, found, alpha), splits, others or (splits,), rms, rng
        )
    else:
        off, limits = _baseline_errors(selection, splits)[None], np.zeros((2, 1))
    steps = np.cumsum([0, *(each.version is not None for each in findings)])
    gains = [
        _make_gain(selection, splits, off[[before, after]], (after > before) * limits[:, before])
        for before, after in pairwise(steps)
    ]
    own = tuple(replace(each, gain=one) for each, one in zip(findings, gains, strict=True))
    return _make_gain(selection, splits, off[[0, -1]], limits[:, -1]), own


def _collect_errors(
    selection: Selection,
    findings: Sequence[Finding],
    splits: Sequence[Split],
    selector: Selector,
    seed: int,
    workers: int,
    progress: SplitProgress | None,
) -> Array:
    from joblib import Parallel, delayed

    tasks = (
        delayed(compute_held_out_errors)(selection.problem, split, findings, selector, (seed, number))
        for number, split in enumerate(splits)
    )
    done = []
    for each in Parallel(n_jobs=workers, return_as="generator")(tasks):
        done.append(each)
        if progress is not None:
            progress(len(done), len(splits))
    return np.concatenate(done, axis=1)


def _baseline_errors(selection: Selection, splits: Sequence[Split]) -> Array:
    """By linear algebra: no fold is searched where there is nothing to extend."""
    linearized = selection.problem.study()
    residual = linearized.residual[:, None]
    off = [
        subtract_calibration(linearized.basis, each.calibration, each.held, residual)[:, 0] for each in splits
    ]
    return np.concatenate(off) * linearized.scale[np.concatenate([each.held for each in splits])]


def _linearize_campaign(
    selection: Selection, found: Sequence[SelectedCause], alpha: float
) -> LinearizedCampaign:
    linearized, fit = selection.problem.study(), selection.fit
    sizes = [len(each.start) for each in _extending_causes(selection)]
    places = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    own = [places[[each is one for one in _extending_causes(selection)].index(True)] for each in found]
    made = [
        compute_changes(linearized, each.version, fit.values[None, at])
        for each, at in zip(found, own, strict=True)
    ]
    effects, slopes = np.concatenate(made, axis=1) / linearized.scale[:, None], _cause_jacobian(selection)
    leverage = np.minimum(selection.study.leverage, MAX_LEVERAGE)
    return LinearizedCampaign(
        linearized.basis,
        linearized.scale,
        selection.study.residual / np.sqrt(1.0 - leverage),
        effects,
        tuple(slopes[:, at] / linearized.scale[:, None] for at in own),
        np.array([_detection_length(selection, each, alpha) for each in found]),
        tuple(_collect_competitors(each, linearized.df) for each in found),
    )


def _collect_competitors(found: SelectedCause, df: int) -> CompetingCauses:
    misfit = found.misfit
    assert misfit is not None
    others = [
        cause
        for cause in misfit.log_evidence_by_cause
        if cause != found.cause and isinstance(misfit.best_hypothesis(cause), Hypothesis)
    ]
    _, own = _explained_shape(misfit, found.cause, df)
    explained = [_explained_shape(misfit, cause, df) for cause in others]
    shapes = [np.zeros((len(misfit.residual), 0)), *(shape[:, None] for shape, _ in explained)]
    return CompetingCauses(
        np.concatenate(shapes, axis=1),
        np.array([ahead - own for _, ahead in explained]),
        np.array([cause != UNKNOWN for cause in others], dtype=bool),
    )


def _explained_shape(misfit: Misfit, cause: str, df: int) -> tuple[Array, float]:
    """What a cause makes of the residuals, (n,), and its log evidence beyond the best likelihood ratio."""
    best = misfit.best_hypothesis(cause)
    assert isinstance(best, Hypothesis)
    along = best.along(misfit.residual)
    share = float(along @ along) / float(misfit.residual @ misfit.residual)
    return best.combine(along), misfit.log_evidence_by_cause[cause] - float(log_likelihood_ratio(share, df))


def _extending_causes(selection: Selection) -> list[SelectedCause]:
    return [each for each in selection.found if each.version is not None]


def _find_selected(selection: Selection, finding: Finding) -> SelectedCause:
    return next(each for each in _extending_causes(selection) if each.cause == finding.cause)


def _cause_jacobian(selection: Selection) -> Array:
    """Change of every response with each parameter of the causes found, shape (n, q)."""
    problem, shared = selection.problem, len(selection.fit.values)
    slopes = np.zeros((len(problem), shared))
    for part in selection.fit.parts:
        slopes[part.rows] = part.law.jacobian(problem.rows.iloc[part.rows], part.values)[:, -shared:]
    return slopes


def _detection_length(selection: Selection, found: SelectedCause, alpha: float) -> float:
    """Length of an effect that makes the search find it."""
    misfit = found.misfit
    assert misfit is not None
    shapes = max(sum(each.cause == found.cause for each in misfit.hypotheses), 1)
    critical, df = selection.first.critical_value(allocate_alpha(alpha)), selection.problem.study().df
    return threshold_length(critical, shapes, df, STRENGTHS)


def _make_gain(selection: Selection, splits: Sequence[Split], off: Array, limits: Array) -> Gain:
    """From the errors before to those after, shape (2, number held out)."""
    held = np.concatenate([split.held for split in splits])
    before, after = np.sqrt(np.mean(off**2, axis=1))
    floor = np.sqrt(np.mean(selection.problem.scale[held] ** 2))
    session = selection.problem.rows["session"].to_numpy(object)[held]
    squares = pd.DataFrame({"session": session, "baseline": off[0] ** 2, "extended": off[1] ** 2})
    grouped = squares.groupby("session", sort=False)
    table = np.sqrt(grouped[["baseline", "extended"]].mean()).reset_index()
    table = table.assign(traverses=grouped.size().to_numpy())
    return Gain(float(before), float(after), float(floor), float(limits[0]), float(limits[1]), table)


N_REPLICATE_SPLITS = 4  # ways in which a fresh replicate may hold configurations out
PROGRESS_START, PROGRESS_FOLDS, PROGRESS_END = 0.2, 0.7, 0.95  # shares of a diagnosis's work


def measure_gain(
    diagnosis: Diagnosis, machine: Machine, *, workers: int = -1, progress: ProgressCallback = ignore_progress
) -> Diagnosis:
    """Measure what each finding, and all of them together, gain on traverses held out.

    Parameters
    ----------
    diagnosis : Diagnosis
    machine : Machine
        Whose calibration traverses a new session would have.
    workers : int, optional
        Processes; all cores without it.
    progress : callable, optional
    """
    began, selection = time.perf_counter(), diagnosis.search
    if not len(selection.problem):
        return diagnosis
    within, *others = (
        hold_out_configurations(selection, np.random.default_rng([diagnosis.seed, k]))
        for k in range(1 + N_REPLICATE_SPLITS)
    )
    between = hold_out_sessions(selection.problem, machine)
    told = partial(
        _report_progress, progress, "predicting held-out traverses", PROGRESS_START, PROGRESS_FOLDS
    )
    whole, findings = _estimate_split_gain(diagnosis, within, others, workers, told)
    told = partial(_report_progress, progress, "predicting new sessions", PROGRESS_FOLDS, PROGRESS_END)
    new, _ = _estimate_split_gain(diagnosis, between, (), workers, told)
    return replace(
        diagnosis,
        findings=findings,
        gain=whole,
        gain_new_session=new,
        seconds=diagnosis.seconds + time.perf_counter() - began,
    )


def hold_out_configurations(selection: Selection, rng: np.random.Generator) -> list[Split]:
    """Hold out configurations of what was searched."""
    linearized, fit = selection.problem.study(), selection.fit
    sizes = np.cumsum([len(each.start) for each in selection.found if each.version is not None])[:-1]
    values = np.split(fit.values, sizes) if len(fit.values) else []
    made = [
        compute_changes(linearized, version, own[None])
        for version, own in zip(selection.versions, values, strict=True)
    ]
    effects = linearized.project(np.concatenate(made, axis=1) / linearized.scale[:, None]) if made else None
    return make_folds(linearized, number_session_configurations(selection.problem.rows), rng, effects)


def number_session_configurations(rows: pd.DataFrame) -> npt.NDArray[np.intp]:
    """A number for each session's each configuration: what is held out together, shape (n,)."""
    session, _ = pd.factorize(rows["session"].astype(object))
    return np.unique(np.column_stack([session, number_configurations(rows)]), axis=0, return_inverse=True)[
        1
    ].ravel()


def select_in_fold(problem: DiagnosisProblem, rng: np.random.Generator, alpha: float) -> Selection:
    """Search part of a log, by as few logs in which nothing is wrong as let it raise an alarm.

    Wild counts would take more; those of the whole log are out already.
    """
    return select_causes(problem, alpha, int(np.ceil(2.0 / alpha)), rng)


def _estimate_split_gain(
    diagnosis: Diagnosis,
    splits: Sequence[Split],
    others: Sequence[Sequence[Split]],
    workers: int,
    told: partial[None],
) -> tuple[Gain | None, tuple[Finding, ...]]:
    if not splits:
        return None, diagnosis.findings
    return estimate_gain(
        diagnosis.search,
        diagnosis.findings,
        splits,
        partial(select_in_fold, alpha=diagnosis.alpha),
        others=others,
        alpha=diagnosis.alpha,
        seed=diagnosis.seed,
        workers=workers,
        progress=told,
    )


def _report_progress(
    progress: ProgressCallback, step: str, begun: float, ended: float, done: int, number: int
) -> None:
    progress(step, begun + (ended - begun) * done / number)
