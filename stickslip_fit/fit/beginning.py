"""Where a search with causes begins: of all that each may do, what explains most of what the law leaves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import Cause
from stickslip_fit.errors import InputError
from stickslip_fit.fit.problem import JointProblem
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import Machine

Array = npt.NDArray[np.float64]

FARTHEST = 20.0  # times as large as in a trial


@dataclass(frozen=True, eq=False)
class Remainder:
    """What published laws, each at its best, leave of the responses of n rows.

    Attributes
    ----------
    problems : tuple of JointProblem
        One for each joint.
    rows : DataFrame
        Theirs, one problem's after the other's.
    values, slopes : tuple of array, shape (rows of each problem, p)
        The law's parameters of each row, and the derivatives of its response by them.
    residual : array, shape (n,)
    """

    problems: tuple[JointProblem, ...]
    rows: pd.DataFrame
    values: tuple[Array, ...]
    slopes: tuple[Array, ...]
    residual: Array

    def recalibrated(self, columns: Array) -> Array:
        """Columns less what the laws' own parameters can follow, group by group; shape (n, m)."""
        left, first = np.empty_like(columns), 0
        for problem, slopes in zip(self.problems, self.slopes, strict=True):
            for group in range(len(problem.groups)):
                mine = np.flatnonzero(problem.groups.of_row == group)
                size = np.abs(slopes[mine]).max(axis=0)
                basis, column = slopes[mine] / np.where(size > 0, size, 1.0), columns[first + mine]
                left[first + mine] = column - basis @ np.linalg.lstsq(basis, column, rcond=1e-9)[0]
            first += len(problem.y)
        return left

    def effects(self, laws: Sequence[StepLaw], start: Array, version: Cause, trials: Array) -> Array:
        """Change of each response by each trial, in laws that have causes at `start`; shape (n, m)."""
        changes = []
        for law, problem, own in zip(laws, self.problems, self.values, strict=True):
            values = np.column_stack([own, np.tile(start, (len(own), 1))])
            acts = law.joint in version.joints
            none = np.zeros((len(own), len(trials)))
            changes.append(version.changes(law, problem.rows, values, trials) if acts else none)
        return self.recalibrated(np.concatenate(changes))


def remainder_of(problems: Sequence[JointProblem]) -> Remainder:
    """Fit every joint's published law by itself, all rows alike."""
    found = [problem.minimise(np.ones(len(problem.y)), problem.start) for problem in problems]
    values = tuple(each.values[problem.groups.of_row] for problem, each in zip(problems, found, strict=True))
    slopes = tuple(problem.model(mine)[1] for problem, mine in zip(problems, values, strict=True))
    rows = pd.concat([problem.rows for problem in problems])
    return Remainder(tuple(problems), rows, values, slopes, np.concatenate([each.residual for each in found]))


def bound_to(rows: pd.DataFrame, causes: Sequence[Cause], machine: Machine) -> tuple[Cause, ...]:
    """Causes with the means and ranges of a log.

    Raises
    ------
    InputError
        For one that the log cannot show, and why.
    """
    for cause in causes:
        why = cause.missing(rows)
        if why is not None:
            raise InputError(f"{cause.name} cannot be fitted: {why}")
    return tuple(cause.bound(rows, machine) for cause in causes)


def begin(remainder: Remainder, causes: Sequence[Cause]) -> tuple[tuple[Cause, ...], Array]:
    """The version of each bound cause that explains most, one after the other, and values to begin with.

    Raises
    ------
    InputError
        For a cause that changes no expected count.
    """
    laws: list[StepLaw] = [problem.law for problem in remainder.problems]
    chosen: list[Cause] = []
    start, left = np.zeros(0), remainder.residual
    for cause in causes:
        ways = list(_ways(remainder, laws, start, cause, left))
        if not ways:
            raise InputError(
                f"{cause.name} changes no expected count of this log, so that there is nothing to fit; "
                "misfires are met by a fit with heavy tails"
            )
        version, values, explained = max(ways, key=lambda way: float(way[2] @ left))
        laws = [version.extend(law) for law in laws]
        chosen.append(version)
        start, left = np.append(start, values), left - explained
    return tuple(chosen), start


def _ways(
    remainder: Remainder, laws: Sequence[StepLaw], start: Array, cause: Cause, left: Array
) -> Iterator[tuple[Cause, Array, Array]]:
    """Each version of a cause, values for it, and what these explain of what is left, shape (n,)."""
    for version, trials in cause.trials(remainder.rows):
        effects = remainder.effects(laws, start, version, trials)
        if version.joined:
            share = np.linalg.lstsq(effects, left, rcond=1e-9)[0]
            yield version, share @ trials, effects @ share
            continue
        absent = version.absent[0]
        for trial, effect in zip(trials, effects.T, strict=True):
            if effect @ effect > 0:
                share = np.clip(effect @ left / (effect @ effect), -FARTHEST, FARTHEST)
                values = np.append(absent + share * (trial[0] - absent), trial[1:])
                yield version, values, share * effect
