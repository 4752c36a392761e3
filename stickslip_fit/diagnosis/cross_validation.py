"""Cross-validation splits, and held-out errors of the laws with the causes found in the training rows.

Whole configurations are held out together, except those without which a parameter or a cause would no
longer be determined. The entire selection is repeated on the training rows of each split.
`hold_out_sessions` leaves out whole sessions but for their calibration traverses: what a user has on a
new day.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.linearized import LawBlock, LinearizedFit, split_positions
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.result import Finding
from stickslip_fit.diagnosis.selection import SelectedCause, Selection
from stickslip_fit.estimation._optimize import Groups, group_rows, minimize
from stickslip_fit.estimation.closed_form import pick_calibration
from stickslip_fit.machine import Machine

N_FOLDS = 10
# What the rest of a session leaves open by more than this share counts as not known without a configuration:
# a prediction would be off by 1 / sqrt(1 - share), here four and a half times, what a traverse repeats to.
MAX_UNKNOWN_SHARE = 0.95
MIN_KNOWN_STRENGTH = (
    5.0  # strength below which the search would more often than not miss a cause in what is left
)


@dataclass(frozen=True, eq=False)
class Split:
    """Rows of a log by what they are used for.

    Attributes
    ----------
    train : array of int
        By which causes are chosen and sized.
    calibrating : array of int
        By which the laws' own parameters are fitted.
    held : array of int
        That are predicted.
    """

    train: IntArray
    calibration: IntArray
    held: IntArray


def make_folds(
    linearized: LinearizedFit,
    kinds: IntArray,
    rng: np.random.Generator,
    effects: Array | None = None,
    number: int = N_FOLDS,
) -> list[Split]:
    """Hold out every configuration once, but for those without which a parameter cannot be known.

    Parameters
    ----------
    linearized : Study
        Of the baseline; n rows.
    kinds : array of int, shape (n,)
        Configuration of each row; all of its rows are held out together.
    rng : Generator
    effects : array, shape (n, k), optional
        Of the causes found, in units of the noise, recalibration taken out: they, too, have to stay known.
    number : int, optional
        Of folds; those in which nothing can be held out are left out.
    """
    n = len(linearized)
    block, place = number_blocks(linearized.parts, n), _coordinates(linearized)
    shown = np.zeros((n, 0)) if effects is None else effects
    taken = [_FoldInformation.empty(int(block.max()) + 1, place.shape[1], shown) for _ in range(number)]
    fold_of, filled = np.full(n, -1), np.zeros(number, dtype=np.intp)
    members = split_positions(kinds)
    for kind in rng.permutation(len(members)):
        rows = members[kind]
        for fold in np.argsort(filled, kind="stable"):
            if taken[fold].try_add(block[rows], place[rows], shown[rows]):
                fold_of[rows], filled[fold] = fold, filled[fold] + len(rows)
                break
    return [_hold_out(np.flatnonzero(fold_of == fold), n) for fold in range(number) if filled[fold]]


@dataclass(frozen=True, eq=False)
class _FoldInformation:
    """What a fold's rows know of B blocks with up to w parameters, and of k causes.

    Attributes
    ----------
    own : array, shape (B, w, w)
        Products of the rows' coordinates.
    cross : array, shape (B, w, k)
        Of the rows' coordinates and the causes' effects.
    effect : array, shape (B, k)
        Squared effects.
    left : array, shape (k,)
        Squared strength of each cause in the rest of the log, recalibrated by that rest.
    least : array, shape (k,)
    """

    own: Array
    cross: Array
    effect: Array
    left: Array
    least: Array

    @classmethod
    def empty(cls, blocks: int, width: int, effects: Array) -> _FoldInformation:
        """No row yet."""
        k, whole = effects.shape[1], np.sum(effects**2, axis=0)
        empty = np.zeros((blocks, width, width)), np.zeros((blocks, width, k)), np.zeros((blocks, k))
        return cls(*empty, whole, np.minimum(MIN_KNOWN_STRENGTH**2, whole / 2))

    def try_add(self, block: IntArray, place: Array, effect: Array) -> bool:
        """Hold these rows out, too, if every parameter stays known."""
        touched, at = np.unique(block, return_inverse=True)
        own, across, alone = self.own[touched], self.cross[touched], self.effect[touched]
        before = _lost_strength(own, across, alone)
        np.add.at(own, at, place[:, :, None] * place[:, None, :])
        np.add.at(across, at, place[:, :, None] * effect[:, None, :])
        np.add.at(alone, at, effect**2)
        if np.linalg.eigvalsh(own).max() >= MAX_UNKNOWN_SHARE:
            return False
        left = self.left + before - _lost_strength(own, across, alone)
        if np.any(left < self.least):
            return False
        self.own[touched], self.cross[touched], self.effect[touched] = own, across, alone
        self.left[:] = left
        return True


def _lost_strength(own: Array, across: Array, alone: Array) -> Array:
    """Squared strength that goes with the rows held out, and with what the rest then absorbs; shape (k,)."""
    solved = np.linalg.solve(np.eye(own.shape[1]) - own, across)
    return np.sum(alone + np.sum(across * solved, axis=1), axis=0)


def number_blocks(parts: Sequence[LawBlock], n: int) -> IntArray:
    """Which set of own parameters each row uses, over all parts, shape (n,)."""
    found, first = np.zeros(n, dtype=np.intp), 0
    for part in parts:
        found[part.rows] = first + part.block
        first += int(part.block.max(initial=-1)) + 1
    return found


def _hold_out(held: IntArray, n: int) -> Split:
    rest = np.setdiff1d(np.arange(n), held)
    return Split(rest, rest, held)


def _coordinates(linearized: LinearizedFit) -> Array:
    """Each row's entries in its own block's columns of the basis, shape (n, most columns of a block)."""
    block, entries = number_blocks(linearized.parts, len(linearized)), linearized.basis.tocoo()
    first = np.full(block.max() + 1, linearized.basis.shape[1])
    np.minimum.at(first, block[entries.row], entries.col)
    column = entries.col - first[block[entries.row]]
    place = np.zeros((len(linearized), int(column.max(initial=0)) + 1))
    place[entries.row, column] = entries.data
    return place


Selector = Callable[[DiagnosisProblem, np.random.Generator], Selection]

TOLERANCE, MAX_ITERATIONS = 1e-5, 60


def compute_held_out_errors(
    problem: DiagnosisProblem,
    split: Split,
    findings: Sequence[Finding],
    selector: Selector,
    seed: Sequence[int],
) -> Array:
    """Search the training rows, and predict those held out under ever more of what was found.

    Parameters
    ----------
    bench : Bench
        Without the log's misfires.
    split : Split
    findings : sequence of Finding
        Those of the whole log that extend its laws.
    seek : callable
        The search, from a bench and a generator.
    seed : sequence of int

    Returns
    -------
    array, shape (k + 1, number held out)
        Measured less predicted, relative: under the baseline, then with what the search made of the first
        finding, of the first two, and so on; in the last with everything it found.
    """
    training = problem.without(np.setdiff1d(np.arange(len(problem)), split.train))
    selection = selector(training, np.random.default_rng(seed))
    off = [_prediction_errors(problem, split.calibration, split.held, (), np.zeros(0))]
    named = [each for each in selection.found if each.version is not None]
    step_of = match_findings(named, findings)
    for step in range(len(findings)):
        chosen = [each for each, subset in zip(named, step_of, strict=True) if subset <= step]
        versions = [each.version for each in chosen]
        if len(chosen) == len(named):
            values = selection.fit.values
        else:
            start = np.concatenate([np.zeros(0), *(each.start for each in chosen)])
            values = selection.problem.fit_extended(versions, start).values
        off.append(_prediction_errors(problem, split.calibration, split.held, versions, values))
    return np.stack(off)


def match_findings(named: Sequence[SelectedCause], findings: Sequence[Finding]) -> list[int]:
    """Which finding of the whole log each cause found in a part of it stands for.

    That which names it, or names it as a rival; what no finding names stands for the last.
    """

    def step(found: SelectedCause) -> int:
        alike = [found.cause in (each.cause, *each.equivalent) for each in findings]
        return alike.index(True) if any(alike) else len(findings) - 1

    return [step(each) for each in named]


def _prediction_errors(
    problem: DiagnosisProblem, calibration: IntArray, held: IntArray, versions: Sequence[Any], values: Array
) -> Array:
    """Errors on rows held out, of laws that hold causes of known size and are calibrated by some rows."""
    off, measured = np.zeros(len(problem)), problem.responses
    of_row = number_blocks(problem.parts, len(problem))
    for part in problem.parts:
        law = part.law
        for version in versions:
            law = version.extend(law)
        known, wanted = np.isin(part.rows, calibration), np.isin(part.rows, held)
        if not wanted.any():
            continue
        subset, block = part.rows[known], of_row[part.rows]
        kinds, group = np.unique(block[known], return_inverse=True)
        start = part.values[known][np.unique(group, return_index=True)[1]]
        groups = Groups(pd.DataFrame({"block": kinds}), group.ravel())
        fitted = _calibrate_groups(problem, law, subset, groups, start, values)
        rows, at = part.rows[wanted], np.searchsorted(kinds, block[wanted])
        both = np.concatenate([fitted[at], np.broadcast_to(values, (len(rows), len(values)))], axis=1)
        off[rows] = measured[rows] - law.predict(problem.rows.iloc[rows], both)
    return off[held]


def _calibrate_groups(
    problem: DiagnosisProblem, law: Any, rows: IntArray, groups: Groups, start: Array, values: Array
) -> Array:
    """Own parameters of each group, shape (g, p), the causes' being known."""
    model = law.model(problem.rows.iloc[rows])
    shared = np.broadcast_to(values, (len(rows), len(values)))

    def own(each: Array) -> tuple[Array, Array]:
        predicted, slopes = model(np.concatenate([each, shared], axis=1))
        return predicted, slopes[:, : each.shape[1]]

    scales = np.maximum(np.abs(start), 0.1 * np.abs(start[:, :1]))
    weight = 1.0 / problem.scale[rows] ** 2
    return minimize(
        own,
        problem.responses[rows],
        weight,
        groups,
        start,
        scales,
        damping=0.0,
        tolerance=TOLERANCE,
        most=MAX_ITERATIONS,
    ).values


MIN_SESSIONS = 3  # sessions
MAX_SPLITS = 5  # times that sessions are held out; of more sessions several are held out together


def hold_out_sessions(problem: DiagnosisProblem, machine: Machine) -> list[Split]:
    """Hold out whole sessions but for their calibration; only what that calibrates is predicted.

    Returns
    -------
    list of Split
        Empty where the log has too few sessions, or none was calibrated as the laws ask for.
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


def _find_calibration(
    problem: DiagnosisProblem, machine: Machine
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
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
