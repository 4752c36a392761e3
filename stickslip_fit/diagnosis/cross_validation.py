"""Cross-validation splits, and held-out errors of the laws with the causes selected from the training rows.

Whole configurations are held out together, except those without which a parameter or a cause would no
longer be determined. The entire selection is repeated on the training rows of each split.
`hold_out_sessions` leaves out whole sessions but for their calibration traverses: what a user has on a
new day.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes.proposed import CarryOverTerm
from stickslip_fit.diagnosis.extension import DEPARTURE_PASSES, SelectedCause, fit_causes
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.fold_selection import Looks, OpenSelection
from stickslip_fit.diagnosis.linearized import (
    ExtendedFit,
    LawBlock,
    LinearizedFit,
    split_positions,
)
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.refits import refine_trial
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.estimation._groups import Groups, group_rows
from stickslip_fit.estimation._optimize import minimize
from stickslip_fit.estimation.closed_form import pick_calibration
from stickslip_fit.logs.history import DEPARTURES, follow_departures
from stickslip_fit.machine import Machine

N_FOLDS = 10
# Leverage of the held-out rows on a parameter above which it counts as undetermined without them: the
# prediction error would be 1 / sqrt(1 - leverage), here 4.5, times the repeatability.
MAX_UNKNOWN_SHARE = 0.95
MIN_KNOWN_STRENGTH = 5.0  # below, the selection misses a cause in the training rows more often than not
TOLERANCE, MAX_ITERATIONS = 1e-5, 60  # of the calibration of a split
MIN_SESSIONS, MAX_SPLITS = 3, 5  # to hold sessions out; of more than `MAX_SPLITS`, several together

Selector = Callable[[DiagnosisProblem, np.random.Generator], Selection]


@dataclass(frozen=True, eq=False)
class Split:
    """Rows of a log by their use.

    Attributes
    ----------
    train : array of int
        From which causes are selected and sized.
    calibration : array of int
        To which the laws' own parameters are fitted.
    held_out : array of int
        Which are predicted.
    """

    train: IntArray
    calibration: IntArray
    held_out: IntArray


def make_folds(
    linearized: LinearizedFit,
    kinds: IntArray,
    rng: np.random.Generator,
    effects: Array | None = None,
    needed: Collection[int] = (),
) -> list[Split]:
    """Hold out every configuration once, except those without which a parameter is not determined.

    Parameters
    ----------
    linearized : LinearizedFit
        Of the baseline; n rows.
    kinds : array of int, shape (n,)
        Configuration of each row; all of its rows are held out together.
    rng : Generator
    effects : array, shape (n, k), optional
        Of the selected causes, whitened and projected; these must stay determined, too.
    needed : collection of int, optional
        Kinds that are not held out.
    """
    n = len(linearized)
    block, coordinates = number_blocks(linearized.parts, n), _coordinates(linearized)
    effects = np.zeros((n, 0)) if effects is None else effects
    n_blocks, width = int(block.max()) + 1, coordinates.shape[1]
    folds = [_FoldInformation.empty(n_blocks, width, effects) for _ in range(N_FOLDS)]
    sums = _KindInformation.of(kinds, block, coordinates, effects)

    def try_add(fold: int, rows: IntArray) -> bool:
        kind = int(kinds[rows[0]])
        return kind not in needed and folds[fold].try_add(sums[kind])

    return deal_kinds(kinds, N_FOLDS, try_add, rng)


def deal_kinds(
    kinds: IntArray, number: int, try_add: Callable[[int, IntArray], bool], rng: np.random.Generator
) -> list[Split]:
    """Deal the rows, all of one kind together, to folds in random order, each to the smallest that takes it.

    Folds are as large as if all took what is dealt to them, so that one that refuses a kind changes nothing
    for the next kinds: a replicate of a log has nearly the same folds, whatever else is found in it.

    Parameters
    ----------
    kinds : array of int, shape (n,)
    number : int
        Of folds; those in which nothing can be held out are left out.
    try_add : callable
        From a fold and rows to whether everything stays determined if these are held out in it, too.
    rng : Generator
    """
    fold_of, sizes = np.full(len(kinds), -1), np.zeros(number, dtype=np.intp)
    members = split_positions(kinds)
    for kind in rng.permutation(len(members)):
        rows = members[kind]
        for fold in np.argsort(sizes, kind="stable").tolist():
            if try_add(fold, rows):
                fold_of[rows] = fold
                break
        sizes[np.argmin(sizes)] += len(rows)
    splits = []
    for used in np.unique(fold_of[fold_of >= 0]):
        train = np.flatnonzero(fold_of != used)
        splits.append(Split(train, train, np.flatnonzero(fold_of == used)))
    return splits


@dataclass(frozen=True, eq=False)
class _KindInformation:
    """Information in the rows of a kind, on the b blocks that it has rows of; see `_FoldInformation`."""

    blocks: IntArray
    own: Array
    cross: Array
    effect: Array

    @classmethod
    def of(
        cls, kinds: IntArray, block: IntArray, coordinates: Array, effects: Array
    ) -> dict[int, _KindInformation]:
        """Of each kind; n rows with their kinds and blocks, coordinates (n, w) and effects (n, k)."""
        order = np.lexsort((block, kinds))
        kind, block, x, effect = kinds[order], block[order], coordinates[order], effects[order]
        begins = np.r_[True, (np.diff(kind) != 0) | (np.diff(block) != 0)]
        first = np.flatnonzero(begins)
        own = np.add.reduceat(x[:, :, None] * x[:, None, :], first)
        cross = np.add.reduceat(x[:, :, None] * effect[:, None, :], first)
        squares, of_kind = np.add.reduceat(effect**2, first), kind[first]
        ends = np.r_[np.flatnonzero(np.diff(of_kind)) + 1, len(first)]
        information, begin = {}, 0
        for end in ends.tolist():
            inside = slice(begin, end)
            blocks = block[first[inside]]
            information[int(of_kind[begin])] = cls(blocks, own[inside], cross[inside], squares[inside])
            begin = end
        return information


@dataclass(frozen=True, eq=False)
class _FoldInformation:
    """Information in a fold's rows on B blocks with up to w parameters, and on k causes.

    Attributes
    ----------
    own : array, shape (B, w, w)
        Sums of products of the rows' coordinates.
    cross : array, shape (B, w, k)
        Of the rows' coordinates and the causes' effects.
    effect : array, shape (B, k)
        Squared effects.
    lost : array, shape (B, k)
        Squared strength in the held-out rows, and what the training rows then absorb.
    remaining_strength : array, shape (k,)
        Squared strength of each cause in the training rows, calibrated by them.
    min_strength : array, shape (k,)
    """

    own: Array
    cross: Array
    effect: Array
    lost: Array
    remaining_strength: Array
    min_strength: Array

    @classmethod
    def empty(cls, blocks: int, width: int, effects: Array) -> _FoldInformation:
        """Of no row."""
        k, whole = effects.shape[1], np.sum(effects**2, axis=0)
        sums = np.zeros((blocks, width, width)), np.zeros((blocks, width, k)), np.zeros((blocks, k))
        return cls(*sums, np.zeros((blocks, k)), whole, np.minimum(MIN_KNOWN_STRENGTH**2, whole / 2))

    def try_add(self, kind: _KindInformation) -> bool:
        """Hold the rows of a kind out, too, if every parameter stays determined."""
        blocks = kind.blocks
        own, cross = self.own[blocks] + kind.own, self.cross[blocks] + kind.cross
        effect = self.effect[blocks] + kind.effect
        # The trace bounds the largest eigenvalue.
        bound = np.trace(own, axis1=1, axis2=2).max()
        if bound >= MAX_UNKNOWN_SHARE and np.linalg.eigvalsh(own).max() >= MAX_UNKNOWN_SHARE:
            return False
        lost = _lost_strength(own, cross, effect) if effect.shape[1] else effect
        left = self.remaining_strength + np.sum(self.lost[blocks] - lost, axis=0)
        if np.any(left < self.min_strength):
            return False
        self.own[blocks], self.cross[blocks] = own, cross
        self.effect[blocks], self.lost[blocks] = effect, lost
        self.remaining_strength[:] = left
        return True


def _lost_strength(own: Array, cross: Array, effect: Array) -> Array:
    """As `_FoldInformation.lost`, of each block."""
    solved = np.linalg.solve(np.eye(own.shape[1]) - own, cross)
    return np.asarray(effect + np.sum(cross * solved, axis=1))


def number_blocks(parts: Sequence[LawBlock], n: int) -> IntArray:
    """Number of each row's block of own parameters over all parts, shape (n,)."""
    numbers, first = np.zeros(n, dtype=np.intp), 0
    for part in parts:
        numbers[part.rows] = first + part.block
        first += int(part.block.max(initial=-1)) + 1
    return numbers


def _coordinates(linearized: LinearizedFit) -> Array:
    """Each row's entries in its own block's columns of the basis, shape (n, most columns of a block)."""
    block, entries = number_blocks(linearized.parts, len(linearized)), linearized.basis.tocoo()
    first = np.full(block.max() + 1, linearized.basis.shape[1])
    np.minimum.at(first, block[entries.row], entries.col)
    column = entries.col - first[block[entries.row]]
    coordinates = np.zeros((len(linearized), int(column.max(initial=0)) + 1))
    coordinates[entries.row, column] = entries.data
    return coordinates


def predict_held_out(
    problem: DiagnosisProblem, split: Split, findings: Sequence[Finding], selection: Selection
) -> Array:
    """Predict the held-out rows with ever more of the causes that were selected from the training rows.

    Parameters
    ----------
    problem : DiagnosisProblem
        Without outlying counts.
    split : Split
    findings : sequence of Finding
        Those of the whole log that extend its laws, k.
    selection : Selection
        See `select_from_training`.

    Returns
    -------
    array, shape (k + 1, number held out)
        Measured less predicted, relative: of the baseline; with the causes that stand for the first finding,
        for the first two, and so on; at last with all selected causes.
    """
    errors = [_prediction_errors(problem, split, (), np.zeros(0))]
    for versions, fit in extend_by_steps(selection, findings):
        errors.append(_prediction_errors(problem, split, versions, fit.values))
    return np.stack(errors)


def confirm_selection(looks: Looks, split: Split) -> Selection | OpenSelection | None:
    """As `select_from_training` where the training rows clearly show what the whole log shows, else None.

    The tests are repeated by linear algebra, and the laws refitted from their fit to all rows. A law for
    unknown structure is searched again. Where combinations of causes come near to the last structure, the
    selection before it.
    """
    whole = looks.selection
    if any(one.cause == UNKNOWN and one.version is None for one in whole.selected):
        return None
    rows = np.setdiff1d(np.arange(len(whole.problem)), split.train)
    causes = looks.select_without(rows)
    if causes is None:
        return None
    parts = [
        replace(part, values=fitted.values[:, : part.values.shape[1]])
        for part, fitted in zip(whole.problem.parts, whole.fit.parts, strict=True)
    ]
    training = replace(whole.problem, parts=tuple(parts)).select_rows(split.train)
    moved = []
    for k, (one, before, place) in enumerate(zip(causes, whole.law_causes, whole.slices, strict=True)):
        if len(one.version.finer_trials(training.rows, one.start)):
            moved.append(k)  # a moment of change found in the whole log knows the rows held out
        elif one.version is before.version:
            causes[k] = replace(one, start=whole.fit.values[place])
    for k in moved:
        others = fit_causes(training, [*causes[:k], *causes[k + 1 :]])
        causes[k] = refine_trial(causes[k], training.linearize_extended(others))
    rng = np.random.default_rng(0)  # of simulated noise
    for k, (one, before) in enumerate(zip(causes, whole.law_causes, strict=True)):
        if one.cause == UNKNOWN:
            last = k + 1 == len(causes)
            if last and looks.is_open(rows):
                return looks.leave_open(training, causes[:k], rows)
            causes[k] = looks.propose_without(k, one, rows, rng)
            version = causes[k].version
            # The tests of what follows are those without all that its carriers may explain.
            if version is None or (version.carriers != before.version.carriers and not last):
                return None
    fit = fit_causes(training, causes)
    return replace(whole, problem=training, selected=tuple(causes), fit=fit)


def select_from_training(
    problem: DiagnosisProblem, split: Split, selector: Selector, seed: Sequence[int]
) -> Selection:
    """The selection repeated on the training rows."""
    training = problem.without_rows(np.setdiff1d(np.arange(len(problem)), split.train))
    return selector(training, np.random.default_rng(seed))


def extend_by_steps(
    selection: Selection, findings: Sequence[Finding]
) -> Iterator[tuple[list[Any], ExtendedFit]]:
    """The causes that stand for the first finding, for the first two, and so on; each with its fit."""
    causes = selection.law_causes
    step_of = match_findings(causes, findings)
    for step in range(len(findings)):
        chosen = [one for one, own in zip(causes, step_of, strict=True) if own is not None and own <= step]
        versions = [one.version for one in chosen]
        if len(chosen) == len(causes):
            yield versions, selection.fit
        else:
            yield versions, fit_causes(selection.problem, chosen)


def match_findings(causes: Sequence[SelectedCause], findings: Sequence[Finding]) -> list[int | None]:
    """The finding of the whole log for which each cause selected in a part of it stands.

    It is the one with this cause in its cause set, of unknown structure one that follows the same if there is
    one. Others take the places of findings for which nothing stands. Where all have something that does, a
    cause is beside what the whole law has, whose errors are wanted: None.
    """

    def match(selected: SelectedCause) -> int | None:
        inside = [k for k, finding in enumerate(findings) if selected.cause in finding.cause_set]
        carriers = getattr(selected.version, "carriers", ())
        same = [k for k in inside if getattr(findings[k].version, "carriers", ()) == carriers]
        return next(iter([*same, *inside]), None)

    matched = [match(selected) for selected in causes]
    free = [k for k in range(len(findings)) if k not in matched]
    places = iter([*free, *free[-1:] * len(causes)])
    return [next(places, None) if place is None else place for place in matched]


def _prediction_errors(
    problem: DiagnosisProblem, split: Split, versions: Sequence[Any], values: Array
) -> Array:
    """Errors on the held-out rows of laws with causes of known size, calibrated by the calibration rows.

    A traverse is predicted from the counts before it, which are known by then, held out or not.
    """
    if any(isinstance(version, CarryOverTerm) for version in versions):
        known, rows = np.union1d(split.calibration, split.held_out), problem.rows
        reliability = 1.0 / (1.0 + _calibration_variance(problem.linearize(), split.calibration))

        def depart(rows: pd.DataFrame) -> Array:
            errors = _compute_errors(
                replace(problem, table=RowTable(rows)), split.calibration, known, versions, values
            )
            return -reliability * errors

        without = rows.drop(columns=[name for name in DEPARTURES if name in rows])
        problem = replace(problem, table=RowTable(follow_departures(without, depart, DEPARTURE_PASSES)))
    errors = _compute_errors(problem, split.calibration, split.held_out, versions, values)
    return errors[split.held_out]


def _calibration_variance(linearized: LinearizedFit, calibrates: IntArray) -> Array:
    """Variance of predictions after calibration by some rows, in units of each row's noise, shape (n,)."""
    block, x = number_blocks(linearized.parts, len(linearized)), _coordinates(linearized)
    information = np.zeros((int(block.max()) + 1, x.shape[1], x.shape[1]))
    np.add.at(information, block[calibrates], x[calibrates, :, None] * x[calibrates, None, :])
    return np.asarray(np.einsum("ni,nij,nj->n", x, np.linalg.pinv(information)[block], x))


def _compute_errors(
    problem: DiagnosisProblem,
    calibrates: IntArray,
    predicted: IntArray,
    versions: Sequence[Any],
    values: Array,
) -> Array:
    """Errors of laws calibrated by some rows on the rows to be predicted, shape (n,); 0 on others."""
    errors = np.zeros(len(problem))
    of_row = number_blocks(problem.parts, len(problem))
    for part in problem.parts:
        law = part.law
        for version in versions:
            law = version.extend(law)
        calibration, held = np.isin(part.rows, calibrates), np.isin(part.rows, predicted)
        if not held.any():
            continue
        block = of_row[part.rows]
        labels, first, group = np.unique(block[calibration], return_index=True, return_inverse=True)
        groups = Groups(pd.DataFrame({"block": labels}), group.ravel())
        start = part.values[calibration][first]
        own = _calibrate_groups(problem, law, part.rows[calibration], groups, start, values)
        rows, at = part.rows[held], np.searchsorted(labels, block[held])
        both = np.concatenate([own[at], np.broadcast_to(values, (len(rows), len(values)))], axis=1)
        errors[rows] = problem.responses[rows] - law.predict(problem.table.subset(rows), both)
    return errors


def _calibrate_groups(
    problem: DiagnosisProblem, law: Any, rows: IntArray, groups: Groups, start: Array, values: Array
) -> Array:
    """Own parameters of each group, shape (g, p), the causes' values being fixed."""
    model = law.model(problem.table.subset(rows))
    shared = np.broadcast_to(values, (len(rows), len(values)))

    def own_model(own: Array) -> tuple[Array, Array]:
        predicted, slopes = model(np.concatenate([own, shared], axis=1))
        return predicted, slopes[:, : own.shape[1]]

    scales = np.maximum(np.abs(start), 0.1 * np.abs(start[:, :1]))
    y, weight = problem.responses[rows], 1.0 / problem.scale[rows] ** 2
    return minimize(
        own_model, y, weight, groups, start, scales, damping=0.0, tolerance=TOLERANCE, most=MAX_ITERATIONS
    ).values


def hold_out_sessions(problem: DiagnosisProblem, machine: Machine) -> list[Split]:
    """Hold out whole sessions but for their calibration; only what that calibrates is predicted.

    Returns
    -------
    list of Split
        Empty where the log has too few sessions, or none with the calibration that the laws ask for.
    """
    session, labels = pd.factorize(problem.rows["session"].astype(object))
    if len(labels) < MIN_SESSIONS:
        return []
    calibration, calibrated = _find_calibration(problem, machine)
    splits = []
    for sessions in np.array_split(np.arange(len(labels)), min(len(labels), MAX_SPLITS)):
        new = np.isin(session, sessions)
        held = np.flatnonzero(new & calibrated & ~calibration)
        if len(held):
            splits.append(Split(np.flatnonzero(~new), np.flatnonzero(new & calibration), held))
    return splits


def _find_calibration(problem: DiagnosisProblem, machine: Machine) -> tuple[BoolArray, BoolArray]:
    """Which rows are calibration traverses, and which are of a session and direction that has them all."""
    calibration, calibrated = np.zeros(len(problem), dtype=bool), np.zeros(len(problem), dtype=bool)
    for part in problem.parts:
        rows = problem.rows.iloc[part.rows]
        groups = group_rows(rows)
        picked = pick_calibration(part.law, rows, groups, machine)
        complete = np.all(picked >= 0, axis=1)
        calibration[part.rows[picked[complete].ravel()]] = True
        calibrated[part.rows] = complete[groups.of_row]
    return calibration, calibrated
