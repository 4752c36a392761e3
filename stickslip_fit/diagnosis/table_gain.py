"""The gain of a table's diagnosis: errors on rows, blocks of consecutive rows or whole groups held out.

Neighbouring values of a signal resemble each other, so that a held-out row between two that were kept
would measure the signal's smoothness, not the law: what is held out is long against the autocorrelation
time (J. Racine, J. Econometrics 99:39, 2000). Where no column is the time, the order of independent rows
means nothing and rows are held out at random: blocks of a sorted table would be half a group, or an end of
a column. A block without which a parameter or a cause would no longer
be determined stays in training; so does the last block of a label whose own offset or parameters are in the
law, as a law with values for each label is made for labels that are known. Whole groups or sessions are held
out with all their labels. Errors are those of the response, not of its innovations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.levels import LevelCause, name_levels
from stickslip_fit.causes.table_cause import ExtendedTableLaw
from stickslip_fit.diagnosis.cross_validation import (
    MAX_UNKNOWN_SHARE,
    MIN_KNOWN_STRENGTH,
    MIN_SESSIONS,
    N_FOLDS,
    Split,
    confirm_selection,
    deal_kinds,
    extend_by_steps,
)
from stickslip_fit.diagnosis.finding import Finding, Gain, TableInfo
from stickslip_fit.diagnosis.fold_selection import prepare_looks
from stickslip_fit.diagnosis.gain import FOLD_SEED, FoldSearches, estimate_gains
from stickslip_fit.diagnosis.hypotheses import compute_changes
from stickslip_fit.diagnosis.linearized import ExtendedFit, LinearizedFit, split_positions
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.selection import Selection

CORRELATION_TIMES = 10.0  # least length of a block
MIN_BLOCKS, MAX_BLOCKS = 10, 50  # over all rows
MIN_SEQUENCE_BLOCKS = 4  # of each sequence, whose own parameters the others tell
MAX_SETS = 500  # of rows at random; more would only take longer to deal


def measure_table_gain(
    selection: Selection,
    findings: tuple[Finding, ...],
    table: TableInfo,
    searches: FoldSearches,
    *,
    workers: int = -1,
    progress: ProgressCallback = ignore_progress,
) -> tuple[Gain | None, Gain | None, tuple[Finding, ...]]:
    """Measure what each finding, and all of them together, gain on held-out rows.

    Held out are whole groups, where the table has them and the law can be known without one; else blocks of
    consecutive rows, or rows at random where no column is the time. New sessions are held out where the law
    has no parameter of its own for each.

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
    linearized = problem.linearize()

    order = list(dict.fromkeys(problem.rows["session"].astype(object)))
    looks = prepare_looks(searches.selection, searches.alpha) if searches.selection.law_causes else None

    def estimate(
        kinds: IntArray, held_out: str, labels: Sequence[IntArray] = ()
    ) -> tuple[Gain, tuple[Finding, ...]] | None:
        folds = hold_out_kinds(selection, linearized, kinds, labels)
        if not folds:
            return None
        [(gain, own)] = estimate_gains(
            selection,
            findings,
            [folds],
            searches,
            workers=workers,
            progress=lambda done, number: progress("predicting held-out rows", 0.2 + 0.7 * done / number),
            predict=predict_held_out_rows,
            confirm=partial(confirm_selection, looks) if looks is not None else None,
            recolour=linearized.recolour,
            beyond=partial(slopes_beyond, selection),
        )
        named = [
            replace(finding, gain=finding.gain and _describe(finding.gain, held_out, order))
            for finding in own
        ]
        return _describe(gain, held_out, order), tuple(named)

    groups = table.roles.get("group", "")
    measured = new_session = None
    if groups:
        measured = estimate(pd.factorize(problem.rows[groups])[0], f"whole groups ({groups})")
    if measured is None:
        labels = _number_labels(selection)
        if table.roles.get("time") or table.is_correlated:
            measured = estimate(*number_time_blocks(problem.rows, table.correlation_rows, labels), labels)
        else:
            measured = estimate(*number_rows(len(problem)), labels)
    sessions = pd.factorize(problem.rows["session"].astype(object))[0]
    is_shared = all(part.values.shape[1] == problem.n_shared for part in problem.parts)
    if is_shared and groups != table.roles.get("session") and sessions.max() + 1 >= MIN_SESSIONS:
        new_session = estimate(sessions, "whole sessions")
    gain, own = measured or (None, findings)
    return gain, new_session[0] if new_session else None, own


def slopes_beyond(selection: Selection, findings: Sequence[Finding], split: Split) -> Array:
    """What slopes of causes are less in held-out rows, beyond what the training rows show; shape (h, q).

    In units of each row's noise. A row far out in a column would else be predicted by a curve that bends
    away from all others, which `predict_held_out_rows` does not do.
    """
    problem, shared = selection.problem, len(selection.fit.values)
    less = np.zeros((len(problem), shared))
    training = problem.rows.drop(index=problem.rows.index[split.held_out])
    for part in selection.fit.parts:
        inside = np.isin(part.rows, split.held_out)
        if inside.any() and isinstance(part.law, ExtendedTableLaw):
            rows, values = problem.rows.iloc[part.rows[inside]], part.values[inside]
            change = part.law.jacobian(rows, values) - part.law.fitted_to(training).jacobian(rows, values)
            less[part.rows[inside]] = change[:, -shared:]
    places = [selection.place_of(selection.behind(finding).version) for finding in findings]
    own = np.concatenate([np.arange(shared)[place] for place in places])
    return less[np.ix_(split.held_out, own)] / problem.scale[split.held_out, None]


def _describe(gain: Gain, held_out: str, sessions: Sequence[str]) -> Gain:
    """A table's gain: what was held out together, and the sessions in their order."""
    by_session = gain.by_session.set_index("session").reindex(sessions).dropna().reset_index()
    by_session = by_session.rename(columns={"traverses": "rows"}).astype({"rows": int})
    return replace(gain, by_session=by_session, held_out=held_out)


def _number_labels(selection: Selection) -> list[IntArray]:
    """A number for each label of the columns whose labels have values of their own in the law; each (n,)."""
    columns = [one.version.column for one in selection.law_causes if isinstance(one.version, LevelCause)]
    return [pd.factorize(name_levels(selection.problem.rows[column]))[0] for column in columns]


def number_rows(n: int) -> tuple[IntArray, str]:
    """A number for each row, shape (n,), or for sets of rows at random if there are many; and the words."""
    kinds = np.random.default_rng(FOLD_SEED).permutation(n) % min(n, MAX_SETS)
    return kinds, "single rows" if n <= MAX_SETS else "rows drawn at random"


def number_time_blocks(
    rows: pd.DataFrame, correlation_rows: float, labels: Sequence[IntArray] = ()
) -> tuple[IntArray, str]:
    """A number for each block of consecutive rows, shape (n,), and what a block is, in words.

    Each label stands in several blocks; `labels` are as of `hold_out_kinds`.
    """
    n = len(rows)
    sequence = pd.factorize(rows["sequence" if "sequence" in rows else "session"].astype(object))[0]
    longest = max(n // MIN_BLOCKS, 1)
    length = min(max(int(np.ceil(CORRELATION_TIMES * correlation_rows)), -(-n // MAX_BLOCKS)), longest)
    if correlation_rows <= 1.0:
        length = min(-(-n // MAX_BLOCKS), longest)
    place = pd.Series(np.arange(n)).groupby(sequence).cumcount().to_numpy()
    size = np.bincount(sequence)[sequence]
    # Blocks of one sequence are equally long, so that none is a remainder of a few rows.
    number = np.maximum(size // length, np.minimum(MIN_SEQUENCE_BLOCKS, size))
    keys = np.column_stack([sequence, place * number // size])
    kinds = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    for own in (inside for label in labels for inside in split_positions(label)):
        least = min(MIN_SEQUENCE_BLOCKS, len(own))
        if len(np.unique(kinds[own])) < least:
            kinds[own] = kinds.max() + 1 + np.arange(len(own)) * least // len(own)
    kinds = np.unique(kinds, return_inverse=True)[1]
    length = int(np.median(np.bincount(kinds)))
    return kinds, f"blocks of about {length:,} consecutive rows" if length > 1 else "single rows"


def hold_out_kinds(
    selection: Selection, linearized: LinearizedFit, kinds: IntArray, labels: Sequence[IntArray] = ()
) -> list[Split]:
    """Hold out every kind of row once, except those without which something is not determined.

    `linearized` is the baseline. Parameters may belong to a session or to the whole table, so that the
    information in the rows of a fold is one matrix over all of them. `labels`, each of shape (n,), are
    numbers all of which have to stay in training.
    """
    basis, effects = linearized.basis.toarray(), _effects(selection, linearized)
    whole = np.sum(effects**2, axis=0)
    least = np.minimum(MIN_KNOWN_STRENGTH**2, whole / 2)
    number = min(N_FOLDS, int(kinds.max()) + 1)
    held = [np.zeros(0, dtype=np.intp)] * number

    def try_add(fold: int, rows: IntArray) -> bool:
        together = np.concatenate([held[fold], rows])
        if any(len(np.unique(np.delete(own, together))) <= own.max() for own in labels):
            return False
        if not _is_determined(basis[together], effects[together], whole, least):
            return False
        held[fold] = together
        return True

    return deal_kinds(kinds, number, try_add, np.random.default_rng(FOLD_SEED))


def _effects(selection: Selection, linearized: LinearizedFit) -> Array:
    """Effects of the selected causes, whitened and projected, shape (n, k)."""
    changes = [
        compute_changes(linearized, one.version, selection.fit.values[None, place])
        for one, place in zip(selection.law_causes, selection.slices, strict=True)
    ]
    columns = np.concatenate([np.zeros((len(linearized), 0)), *changes], axis=1)
    return linearized.project(linearized.whiten(columns))


def _is_determined(basis: Array, effects: Array, whole: Array, least: Array) -> bool:
    """Whether parameters and causes stay known without these rows of the basis and the effects."""
    own, cross = basis.T @ basis, basis.T @ effects
    if np.linalg.eigvalsh(own).max(initial=0.0) >= MAX_UNKNOWN_SHARE:
        return False
    solved = np.linalg.solve(np.eye(len(own)) - own, cross)
    left = whole - np.sum(effects**2, axis=0) - np.sum(cross * solved, axis=0)
    return bool(np.all(left >= least))


def predict_held_out_rows(
    problem: DiagnosisProblem, split: Split, findings: Sequence[Finding], selection: Selection
) -> Array:
    """As `cross_validation.predict_held_out`, with laws that may share parameters over the whole table.

    These are fitted to the training rows together with all others. Shape (k + 1, number held out).
    """
    errors = [predict_from_fit(problem, split.held_out, selection.problem.fit_extended())]
    for _, fit in extend_by_steps(selection, findings):
        errors.append(predict_from_fit(problem, split.held_out, fit))
    return np.stack(errors)


def predict_from_fit(problem: DiagnosisProblem, held_out: IntArray, fit: ExtendedFit) -> Array:
    """Responses of held-out rows less their prediction by a fit of the other rows, shape (h,)."""
    errors, training = np.zeros(len(problem)), problem.rows.drop(index=problem.rows.index[held_out])
    for part, fitted in zip(problem.parts, fit.parts, strict=True):
        inside = np.isin(part.rows, held_out)
        if not inside.any():
            continue
        rows, at = part.rows[inside], np.zeros(int(inside.sum()), dtype=np.intp)
        if part.values.shape[1] > problem.n_shared:  # else any row has the values that all share
            labels, first = np.unique(fitted.block, return_index=True)
            at = first[np.searchsorted(labels, part.block[inside])]
        law = fitted.law.fitted_to(training) if isinstance(fitted.law, ExtendedTableLaw) else fitted.law
        predicted = law.predict(problem.rows.iloc[rows], fitted.values[at])
        errors[rows] = problem.responses[rows] - predicted
    return errors[held_out]
