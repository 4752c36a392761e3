"""The gain of a diagnosis: rms error on held-out traverses, without and with each finding in the law.

`measure_gain` makes the splits (`cross_validation`) and repeats the selection in each of them. A cause that
is withdrawn for its gain changes no search, so that `FoldSearches` keeps them for the next time. The interval
of the gain comes from `gain_interval`, for which `_linearize_campaign` prepares the fit.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, pairwise
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._rows import unique_rows
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.function_of_cause import FunctionOfCause
from stickslip_fit.diagnosis.autocorrelation import variance_over_innovations
from stickslip_fit.diagnosis.cross_validation import (
    Selector,
    Split,
    confirm_selection,
    hold_out_sessions,
    make_folds,
    match_findings,
    predict_held_out,
    select_from_training,
)
from stickslip_fit.diagnosis.evidence import log_likelihood_ratio
from stickslip_fit.diagnosis.extension import SelectedCause, fit_causes
from stickslip_fit.diagnosis.finding import Finding, Gain
from stickslip_fit.diagnosis.fold_selection import OpenSelection, prepare_looks
from stickslip_fit.diagnosis.gain_interval import (
    CompetingCauses,
    LinearizedCampaign,
    Recolouring,
    keep_columns,
    prepare_calibration,
    simulate_gain_intervals,
)
from stickslip_fit.diagnosis.hypotheses import Hypothesis, compute_changes
from stickslip_fit.diagnosis.linearized import MAX_LEVERAGE, LinearizedFit, cause_jacobian
from stickslip_fit.diagnosis.misfit import UNKNOWN, detection_length
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.selection import Selection, allocate_alpha, select_causes
from stickslip_fit.logs.log import number_configurations
from stickslip_fit.machine import Machine

MIN_SQUARE = 1e-300
CLEAR_DISTANCE = 3.0  # standard errors between two laws, by which rows tell one from the other
MIN_JOINT_STRENGTH = 1.0  # of an effect in a joint, in standard errors; less is not seen in all rows either
FOLD_SEED = 0  # the same for all logs: folds follow from the design, so that a replicate has the same
MAX_SERIAL_ROWS = 2000  # above, processes share the splits
MIN_SAVED_SECONDS = 25.0  # for which they share them, too; each takes some 4 s of CPU to begin
PROGRESS_START, PROGRESS_END = 0.2, 0.95  # shares of a diagnosis's work
PROGRESS_STEP = "predicting held-out traverses"

SplitProgress = Callable[[int, int], None]
Prediction = Callable[..., Array]
Confirmation = Callable[[Split], Selection | OpenSelection | None]


@dataclass(frozen=True, eq=False)
class FoldSearches:
    """The search of a diagnosis, repeated without the rows that are held out.

    Attributes
    ----------
    selection : Selection
        Of the whole data, as it was before any of its causes was withdrawn.
    alpha, seed : float, int
        Of the diagnosis.
    findings : tuple of Finding
        Of the whole data, before any was withdrawn. What stands for one that was is left out in all splits.
    select : callable or None
        From a problem and a generator to a selection; None for `select_in_fold`.
    known : dict
        What was selected, by the training rows and the number of a split.
    """

    selection: Selection
    alpha: float
    seed: int = 0
    findings: tuple[Finding, ...] = ()
    select: Selector | None = None
    known: dict[tuple[bytes, int], Selection] = field(default_factory=dict)

    @property
    def selector(self) -> Selector:
        """The search of a part of the data."""
        return self.select or partial(select_in_fold, alpha=self.alpha)


def measure_gain(
    selection: Selection,
    findings: tuple[Finding, ...],
    machine: Machine | None,
    searches: FoldSearches,
    *,
    workers: int = -1,
    progress: ProgressCallback = ignore_progress,
) -> tuple[Gain | None, Gain | None, tuple[Finding, ...]]:
    """Measure what each finding, and all of them together, gain on held-out traverses.

    Without a machine, whose calibration traverses a new session has, no gain there is measured. `workers` are
    processes, -1 for all cores; more than one take part where they save `MIN_SAVED_SECONDS`.

    Returns
    -------
    gain, gain_new_session : Gain or None
        None where nothing can be held out.
    findings : tuple of Finding
        The same, each with its own gain.
    """
    problem = selection.problem
    if not len(problem):
        return None, None, findings
    folds = hold_out_configurations(selection)
    sessions = hold_out_sessions(problem, machine) if machine is not None else []
    if not (sets := [one for one in (folds, sessions) if one]):
        return None, None, findings
    looks = prepare_looks(searches.selection, searches.alpha) if searches.selection.law_causes else None
    first, last = PROGRESS_START, PROGRESS_END
    estimates = estimate_gains(
        selection,
        findings,
        sets,
        searches,
        workers=workers,
        progress=lambda done, number: progress(PROGRESS_STEP, first + (last - first) * done / number),
        confirm=partial(confirm_selection, looks) if looks is not None else None,
    )
    gain, own = estimates[0] if folds else (None, findings)
    return gain, estimates[-1][0] if sessions else None, own


def estimate_gains(
    selection: Selection,
    findings: Sequence[Finding],
    sets: Sequence[Sequence[Split]],
    searches: FoldSearches,
    *,
    workers: int = -1,
    progress: SplitProgress | None = None,
    predict: Prediction = predict_held_out,
    confirm: Confirmation | None = None,
    recolour: Recolouring = keep_columns,
    beyond: Callable[[Sequence[Finding], Split], Array] | None = None,
) -> list[tuple[Gain, tuple[Finding, ...]]]:
    """Repeat the selection in each split, and compare its predictions of the held-out rows.

    Campaigns are simulated once for all sets of splits.

    Parameters
    ----------
    selection : Selection
        Of the whole log; outlying counts take no part.
    findings : sequence of Finding
        Of the whole log. Those that extend no law gain nothing.
    sets : sequence of sequence of Split
        Of the rows of `selection.problem`; at least one in each set.
    searches : FoldSearches
    workers : int, optional
        Processes; all cores without it, one for what takes little. No number depends on it.
    progress : callable, optional
        Called with the number of splits that are done, and of all.
    predict : callable, optional
        As `predict_held_out`; a table's laws are calibrated in another way.
    confirm : callable, optional
        From a split to its selection, as far as it is clear; None where the search has to be repeated.
    recolour : callable, optional
        Of `LinearizedCampaign`.
    beyond : callable, optional
        From findings and a split to what `simulate_gain_intervals` has of it.

    Returns
    -------
    list of (Gain, tuple of Finding)
        Of each set the gain, and the same findings, each with its own gain.
    """
    extending = [finding for finding in findings if finding.version is not None]
    if extending:
        ends, numbered = np.cumsum([len(splits) for splits in sets]), list(chain(*map(enumerate, sets)))
        first = [finding for finding in searches.findings if finding.version is not None] or extending
        named = {k for k, one in enumerate(first) if any(one.version is own.version for own in extending)}
        predict_from = partial(_predict_kept, first, named, predict, selection.problem, extending)
        errors = _collect_errors(predict_from, confirm, searches, numbered, workers, progress)
        held_out = [
            _leave_out_stalls(splits, np.concatenate(errors[end - len(splits) : end], axis=1))
            for splits, end in zip(sets, ends, strict=True)
        ]
        rms = [np.sqrt(np.mean(own**2, axis=1)) for _, own in held_out]
        rng = np.random.default_rng([searches.seed, 1])
        campaign = replace(_linearize_campaign(selection, extending, searches.alpha), recolour=recolour)
        kept = [splits for splits, _ in held_out]
        less = None
        if beyond:
            less = [[beyond(extending, split) for split in splits] for splits in kept]
        else:
            campaign = campaign.by_seen_directions()
        limits = simulate_gain_intervals(campaign, kept, np.stack(rms), rng, beyond=less)
    else:
        held_out = [(splits, _baseline_errors(selection, splits, recolour)[None]) for splits in sets]
        limits = np.zeros((len(sets), 2, 1))
    estimates = []
    for splits, (kept_splits, own), its_limits in zip(sets, held_out, limits, strict=True):
        gain, with_gains = _compare_errors(selection, findings, kept_splits, own, its_limits)
        stalled = sum(len(one.held_out) for one in splits) - sum(len(one.held_out) for one in kept_splits)
        estimates.append((replace(gain, stalled=stalled), with_gains))
    return estimates


def _compare_errors(
    selection: Selection, findings: Sequence[Finding], splits: Sequence[Split], errors: Array, limits: Array
) -> tuple[Gain, tuple[Finding, ...]]:
    """The gain of all findings and of each, from errors of shape (k + 1, number held out)."""
    steps = np.cumsum([0, *(finding.version is not None for finding in findings)])
    gains = [
        _make_gain(selection, splits, errors[[before, after]], (after > before) * limits[:, before])
        for before, after in pairwise(steps)
    ]
    own = tuple(replace(finding, gain=gain) for finding, gain in zip(findings, gains, strict=True))
    return _make_gain(selection, splits, errors[[0, -1]], limits[:, -1]), own


def _predict_kept(
    first: Sequence[Finding],
    kept: Collection[int],
    predict: Prediction,
    problem: DiagnosisProblem,
    findings: Sequence[Finding],
    split: Split,
    selection: Selection,
) -> Array:
    """Errors with what was selected from the training rows, as far as it stands for a finding that is kept.

    `kept` are places among the `first` findings. Else what a split has in the place of a withdrawn one would
    count as part of the others.
    """
    places = zip(selection.law_causes, match_findings(selection.law_causes, first), strict=True)
    if gone := [one for one, place in places if place not in kept]:
        selected = tuple(one for one in selection.selected if one not in gone)
        selection = replace(selection, selected=selected, fit=fit_causes(selection.problem, selected))
    return predict(problem, split, findings, selection)


def _search_split(
    predict: Callable[..., Array],
    problem: DiagnosisProblem,
    selector: Selector,
    seed: tuple[int, int],
    split: Split,
    begun: OpenSelection | None,
) -> tuple[Selection, Array]:
    """What is selected from the training rows of a split, as `begun` if possible, and the errors with it."""
    selection = None if begun is None else begun.settle(np.random.default_rng(seed))
    if selection is None:
        selection = select_from_training(problem, split, selector, seed)
    selection = selection.without_tests
    return selection, predict(split, selection)


def _collect_errors(
    predict: Callable[..., Array],
    confirm: Confirmation | None,
    searches: FoldSearches,
    splits: Sequence[tuple[int, Split]],
    workers: int,
    progress: SplitProgress | None,
) -> list[Array]:
    """The errors in each split, given with its number in its set."""
    known, problem = searches.known, searches.selection.problem
    keys = [(split.train.tobytes(), number) for number, split in splits]
    begun: dict[tuple[bytes, int], OpenSelection] = {}
    for key, (_, split) in zip(keys, splits, strict=True):
        confirmed = confirm(split) if confirm is not None and key not in known else None
        if isinstance(confirmed, OpenSelection):
            begun[key] = confirmed
        elif confirmed is not None:
            known[key] = confirmed.without_tests
    open_splits = [place for place, key in enumerate(keys) if key not in known]
    errors = {
        place: predict(split, known[key])
        for place, (key, (_, split)) in enumerate(zip(keys, splits, strict=True))
        if key in known
    }
    search = partial(_search_split, predict, problem, searches.selector)
    tasks = [
        partial(search, (searches.seed, splits[k][0]), splits[k][1], begun.get(keys[k])) for k in open_splits
    ]
    results = _run_tasks(tasks, workers, at_once=len(problem) > MAX_SERIAL_ROWS)
    for done, (place, result) in enumerate(zip(open_splits, results, strict=True), start=1):
        known[keys[place]], errors[place] = result
        if progress is not None:
            progress(len(splits) - len(open_splits) + done, len(splits))
    return [errors[place] for place in range(len(splits))]


def _run_tasks[T](tasks: Sequence[Callable[[], T]], workers: int, at_once: bool) -> Iterator[T]:
    """Their results, in order.

    Starting processes takes as long as the selection in several folds of a small log: if not `at_once`, they
    share the tasks after the first if that one took long.
    """
    if not at_once and tasks:
        began = perf_counter()
        result, tasks = tasks[0](), tasks[1:]
        at_once = _save_enough((perf_counter() - began) * len(tasks), len(tasks), workers)
        yield result
    if at_once and len(tasks) > 1:
        from joblib import Parallel, delayed

        with warnings.catch_warnings():
            # Processes that have grown are replaced, which is nothing to be told.
            warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given")
            yield from Parallel(n_jobs=workers, return_as="generator")(delayed(task)() for task in tasks)
    else:
        yield from (task() for task in tasks)


def _save_enough(alone: float, tasks: int, workers: int) -> bool:
    """Whether processes that share tasks save enough of the seconds that one alone would take."""
    if alone <= MIN_SAVED_SECONDS:
        return False
    from joblib import effective_n_jobs

    return alone * (1.0 - 1.0 / min(effective_n_jobs(workers), tasks)) > MIN_SAVED_SECONDS


def _leave_out_stalls(splits: Sequence[Split], errors: Array) -> tuple[Sequence[Split], Array]:
    """Without the rows on which a joint stalls under the laws without causes; errors of shape (k, held out).

    Where it stalls with causes only, these err by all of the step size. Calibrated by few configurations, a
    law may have steps of no size in another.
    """
    moves = np.isfinite(errors[0])
    if not moves.any():
        return splits, errors
    ends = np.cumsum([len(split.held_out) for split in splits])[:-1]
    parts = zip(splits, np.split(moves, ends), strict=True)
    kept = [replace(split, held_out=split.held_out[own]) for split, own in parts if own.any()]
    return kept, np.where(np.isfinite(errors), errors, 1.0)[:, moves]


def _baseline_errors(selection: Selection, splits: Sequence[Split], recolour: Recolouring) -> Array:
    """By linear algebra: where nothing extends the law, the selection need not be repeated."""
    linearized = selection.problem.with_laws_as_chosen.linearize()
    residual = linearized.residual[:, None]
    errors = [
        prepare_calibration(linearized.basis, split.calibration, split.held_out, recolour).subtract(residual)[
            :, 0
        ]
        for split in splits
    ]
    return np.concatenate(errors) * linearized.scale[np.concatenate([split.held_out for split in splits])]


def _make_gain(selection: Selection, splits: Sequence[Split], errors: Array, limits: Array) -> Gain:
    """From the errors before and after, shape (2, number held out)."""
    held = np.concatenate([split.held_out for split in splits])
    before, after = np.sqrt(np.mean(errors**2, axis=1))
    floor = np.sqrt(np.mean(selection.problem.scale[held] ** 2))
    keys = [name for name in ("session", "joint", "direction") if name in selection.problem.rows]
    squares = selection.problem.rows[keys].iloc[held].astype(object)
    squares = squares.assign(baseline=errors[0] ** 2, extended=errors[1] ** 2)
    return Gain(
        float(before),
        float(after),
        float(floor),
        float(limits[0]),
        float(limits[1]),
        _root_mean_squares(squares, ["session"]),
        by_joint=_root_mean_squares(squares, keys[1:]).sort_values(keys[1:], ignore_index=True),
        given_before=_rms_innovations(selection.problem, splits, errors),
    )


def _rms_innovations(problem: DiagnosisProblem, splits: Sequence[Split], errors: Array) -> tuple[float, ...]:
    """As of `Gain.given_before`, of errors of shape (2, number held out)."""
    noise = problem.autocorrelation
    if noise is None or not len(noise.coefficients):
        return ()
    squares, first = np.zeros(2), 0
    for split in splits:
        own = errors[:, first : (first := first + len(split.held_out))] / problem.scale[split.held_out]
        squares += np.sum(noise.select(split.held_out).whiten(own.T) ** 2, axis=0)
    sd = np.sqrt(np.mean(problem.scale**2) / variance_over_innovations(noise.coefficients))
    return tuple((sd * np.sqrt(squares / errors.shape[1])).tolist())


def _root_mean_squares(squares: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Of `baseline` and `extended` in each group, and how many traverses it has."""
    grouped = squares.groupby(by, sort=False)
    table = np.sqrt(grouped[["baseline", "extended"]].mean()).reset_index()
    return table.assign(traverses=grouped.size().to_numpy())


def hold_out_configurations(selection: Selection) -> list[Split]:
    """Hold out configurations, keeping the selected causes determined.

    Rows count alike: a replicate, in which other configurations seem noisier, should have the same folds.
    """
    problem, values = selection.problem, selection.fit.values
    linearized = replace(problem, noise_ratio=np.ones(len(problem))).linearize()
    changes = []
    for selected, place in zip(selection.law_causes, selection.slices, strict=True):
        change = compute_changes(linearized, selected.version, values[None, place])
        # Of structure without a name the rows of each joint tell whether it acts on that one, too.
        changes += _split_by_joint(change, problem.rows) if selected.cause == UNKNOWN else [change]
    effects = None
    if changes:
        effects = linearized.project(linearized.whiten(np.concatenate(changes, axis=1)))
        effects = effects[:, np.sum(effects**2, axis=0) > MIN_JOINT_STRENGTH**2]
    kinds, rng = number_session_configurations(problem.rows), np.random.default_rng(FOLD_SEED)
    needed = _locate_changes(selection, linearized, kinds)
    return make_folds(linearized, kinds, rng, effects, needed=needed)


def _split_by_joint(change: Array, rows: pd.DataFrame) -> list[Array]:
    """What a change of the step size, shape (n, 1), is of each joint that it acts on."""
    joint = rows["joint"].to_numpy()[:, None]
    parts = [np.where(joint == number, change, 0.0) for number in np.unique(joint)]
    return [part for part in parts if part.any()]


def _locate_changes(selection: Selection, linearized: LinearizedFit, kinds: IntArray) -> IntArray:
    """The kinds of rows, (n,), each of which alone tells the moment of a change from another one.

    Without the traverse before or after a lasting change, whether it was before or after is anyone's guess.
    """
    needed = []
    for one, place in zip(selection.law_causes, selection.slices, strict=True):
        values = selection.fit.values[place]
        others = one.version.finer_trials(linearized.rows, values)
        if not len(others):
            continue
        effects = linearized.whiten(compute_changes(linearized, one.version, np.vstack([values, others])))
        squares = (effects[:, 1:] - effects[:, :1]) ** 2
        own = np.stack([np.bincount(kinds, column) for column in squares.T], axis=1)
        tells, left = own > CLEAR_DISTANCE**2, own.sum(axis=0) - own < CLEAR_DISTANCE**2
        needed.append(np.flatnonzero(np.any(tells & left, axis=1)))
    return np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *needed]))


def number_session_configurations(rows: pd.DataFrame) -> IntArray:
    """A number for each configuration of each session: what is held out together, shape (n,)."""
    session, _ = pd.factorize(rows["session"].astype(object))
    keys = np.column_stack([session, number_configurations(rows)])
    return unique_rows(keys)[1]


def select_in_fold(problem: DiagnosisProblem, rng: np.random.Generator, alpha: float) -> Selection:
    """Select causes from part of a log, with the fewest bootstrap samples that allow an alarm.

    These do not suffice for outlying counts; those of the whole log are removed already.
    """
    return select_causes(problem, alpha, int(np.ceil(2.0 / alpha)), rng)


def _linearize_campaign(
    selection: Selection, findings: Sequence[Finding], alpha: float
) -> LinearizedCampaign:
    """The fit with its causes, linearized, for simulated replicates; `findings` give the order."""
    linearized, fit = selection.problem.with_laws_as_chosen.linearize(), selection.fit
    selected = [selection.behind(finding) for finding in findings]
    places = [selection.place_of(one.version) for one in selected]
    changes = [
        compute_changes(linearized, one.version, fit.values[None, place])
        for one, place in zip(selected, places, strict=True)
    ]
    effects = linearized.whiten(np.concatenate(changes, axis=1))
    slopes = linearized.whiten(cause_jacobian(selection.problem.table, fit.parts, len(fit.values)))
    critical = selection.first_misfit.critical_value(allocate_alpha(alpha))
    thresholds = [
        detection_length(critical, one.misfit.n_shapes(one.cause), linearized.df)
        for one in selected
        if one.misfit is not None
    ]
    return LinearizedCampaign(
        linearized.basis,
        linearized.scale,
        selection.linearized.residual
        / np.sqrt(1.0 - np.minimum(selection.linearized.leverage, MAX_LEVERAGE)),
        effects,
        tuple(slopes[:, place] for place in places),
        tuple(1.0 / fit.prior_sd[place] for place in places),
        np.array(thresholds),
        tuple(
            _collect_competitors(one, effect, linearized.df)
            for one, effect in zip(selected, linearized.project(effects).T, strict=True)
        ),
    )


def _is_same_function(rival: Any, version: Any) -> bool:
    """Whether a rival's law would be the same smooth function, under another name."""
    return isinstance(version, FunctionOfCause) and getattr(rival, "carriers", ()) == version.carriers


def _collect_competitors(selected: SelectedCause, effect: Array, df: int) -> CompetingCauses:
    """Rivals of a selected cause, whose fitted effect is given, whitened and projected, shape (n,)."""
    misfit = selected.test
    others = [
        cause
        for cause in misfit.log_evidence_by_cause
        if cause != selected.cause
        and isinstance(shape := misfit.best_hypothesis(cause), Hypothesis)
        and not _is_same_function(shape.version, selected.version)
    ]
    residual = misfit.residual
    shapes = [effect, *(misfit.best_subspace(cause).explain(residual) for cause in others)]
    columns = np.stack(shapes, axis=1)
    squares = (residual @ columns) ** 2 / np.maximum(np.sum(columns**2, axis=0), MIN_SQUARE)
    evidence = np.array([misfit.log_evidence_by_cause[cause] for cause in (selected.cause, *others)])
    ahead = evidence - log_likelihood_ratio(squares / (residual @ residual), df)
    return CompetingCauses(
        columns[:, 1:], ahead[1:] - ahead[0], np.array([cause != UNKNOWN for cause in others], dtype=bool)
    )
