"""Formulas as causes of a log: a term, a factor, a state or a count; each is bound to the log's rows.

They are tried at a size that matters to a lab: 1 % of the step size, a hundredth of a radian or a tenth of a
millimetre, ten steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.cause_formula import CauseFormula
from stickslip_fit.causes.formula_trials import MAX_LEVELS, FormulaTrials, Place, TrialSearch, first_row
from stickslip_fit.causes.kinds import CountCause, FactorCause, StateCause, TermCause
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws import State, float_column, state_at
from stickslip_fit.laws.base import expected_steps, traverse_length
from stickslip_fit.laws.quantities import (
    OF_GEOMETRY,
    POSE,
    columns_of,
    is_coordinate,
    known_names,
    quantity,
    varies_with_position,
)
from stickslip_fit.laws.table import similar_name
from stickslip_fit.machine import Machine
from stickslip_fit.units import UNITS, to_si

SHARE, ANGLE, LENGTH, LOAD, COUNT = 0.01, 0.01, 1e-4, 0.05, 10.0  # what is tried: 1, rad, m, 1, steps
STEP_SIZE = "gamma"
STEP_SIZE_GUESS = 1e-6  # m or rad, for rows without counts
_SHIFTED = {name: f"override_{name}" for name in OF_GEOMETRY}


@dataclass(frozen=True, kw_only=True)
class FormulaStepCause(FormulaTrials):
    """What formulas share as causes of a log; see `FormulaTrials`."""

    @property
    def joints(self) -> tuple[int, ...]:  # type: ignore[override]
        return self.source.joints or Cause.joints

    @property
    def varies_along_traverse(self) -> bool:  # type: ignore[override]
        return varies_with_position(self.source.names)

    def evaluate(self, state: State, values: Sequence[Array], step_size: Array | None = None) -> Array:
        """The formula in a state, (n, k) or (n, 1); each of `values` has shape (n, 1)."""
        n = len(state.position)
        labels = None
        if self.source.by:
            labels = np.full(n, state.joint) if self.source.by == "joint" else state.row[self.source.by]
        places, inside = self.own_places(labels, n)
        table = np.broadcast_to(np.concatenate(values, axis=1), (n, len(self.null_values)))
        own = np.where(
            inside[:, None], np.take_along_axis(table, places, axis=1), np.array(self.null_values)[places]
        )
        known = {name: own[:, k, None] for k, name in enumerate(self.order)}
        for name in self.source.names:
            if name == STEP_SIZE and step_size is not None:
                known[name] = step_size
            elif name not in known:
                known[name] = quantity(state, name)
        return np.atleast_2d(self.limited.evaluate(known))


@dataclass(frozen=True, kw_only=True)
class FormulaTerm(FormulaStepCause, TermCause):
    """Adds a formula to the step size."""

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        return self.evaluate(state, values, free)


@dataclass(frozen=True, kw_only=True)
class FormulaFactor(FormulaStepCause, FactorCause):
    """Multiplies the step size by a formula."""

    def factor(self, state: State, values: list[Array]) -> Array:
        return self.evaluate(state, values)


@dataclass(frozen=True, kw_only=True)
class FormulaState(FormulaStepCause, StateCause):
    """Puts a formula in place of an angle, a position, the load or the recoil."""

    @property
    def stage(self) -> int:  # type: ignore[override]
        return 2 if self.source.target in OF_GEOMETRY else 1

    def change(self, state: State, values: list[Array]) -> State:
        target, true = self.source.target, self.evaluate(state, values)
        if target in ("q", f"q{state.joint}"):
            changes = {"position": true}
            if state.joint <= 3:
                changes[f"q{state.joint}"] = true
            return state.with_changes(**changes)
        if target in POSE or target in _SHIFTED:
            return state.with_changes(**{_SHIFTED.get(target, target): true})
        return state.with_changes(row={**state.row, target: true[:, 0]})


@dataclass(frozen=True, kw_only=True)
class FormulaCount(FormulaStepCause, CountCause):
    """Adds a formula to the count."""

    def steps(self, state: State, values: list[Array]) -> Array:
        return self.evaluate(state, values)[:, :1]


STEP_CAUSES: dict[str, type[FormulaStepCause]] = {
    "+": FormulaTerm,
    "*": FormulaFactor,
    "=": FormulaState,
    "steps +": FormulaCount,
}


def bind_formula_to_log(cause: CauseFormula, rows: pd.DataFrame, machine: Machine) -> FormulaStepCause:
    """A formula as a cause of a log; see `FormulaCause.bind`."""
    if faults := _find_faults(cause, rows):
        raise InputError([InputIssue(f"the cause {cause.name}: {fault}") for fault in faults])
    if {*cause.names, cause.target} & {*OF_GEOMETRY}:
        machine.require_geometry(f"the cause {cause.name}: load or recoil in a formula")
    acting = rows[rows["joint"].isin(cause.joints)] if cause.joints else rows
    levels = tuple(sorted(acting[cause.by].unique().tolist(), key=str)) if cause.by else (None,)
    declared = {one.name: _in_si(one) for one in cause.declared}
    used = [name for name in cause.names if name not in declared and name != STEP_SIZE]
    by = [cause.by] if cause.by and cause.by != "joint" else []
    joint = int(acting["joint"].iloc[0])
    columns = tuple(dict.fromkeys([*columns_of(used, rows, 0), *by]))
    search = _LogTrialSearch(cause, declared, levels, acting, machine, joint)
    bound = search.choose(lambda **found: STEP_CAUSES[cause.operation](columns=columns, **found))
    assert isinstance(bound, FormulaStepCause)
    return bound


def _in_si(parameter: CauseParameter) -> CauseParameter:
    low, high = (to_si(end, parameter.unit) for end in (parameter.lower, parameter.upper))
    return replace(parameter, lower=low, upper=high)


def _find_faults(cause: CauseFormula, rows: pd.DataFrame) -> list[str]:
    own = [one.name for one in cause.declared]
    known = [*known_names(rows), *([STEP_SIZE] if cause.operation == "+" else [])]
    faults = [f"{name} is a name of the log already; name it otherwise" for name in own if name in known]
    for name in cause.names:
        if name not in own and name not in known:
            similar = similar_name(name, known)
            hint = f"; did you mean {similar}?" if similar else f"; there are {', '.join(known)}"
            faults.append(f"{name} is neither in the log nor a parameter{hint}")
    for one in cause.declared:
        if one.unit not in UNITS:
            similar = similar_name(one.unit, UNITS)
            hint = f"did you mean {similar}? " if similar else ""
            faults.append(
                f"the unit {one.unit!r} of {one.name} is not known; {hint}there are {', '.join(UNITS)}"
            )
    if cause.by and cause.by not in rows:
        faults.append(f"the log has no column {cause.by}")
    elif cause.by and (number := rows[cause.by].nunique()) > MAX_LEVELS:
        faults.append(f"the column {cause.by} has {number:,} values; by= takes at most {MAX_LEVELS}")
    if cause.operation == "=" and cause.target not in known:
        faults.append(f"{cause.target} is nothing that the log has; there are {', '.join(known)}")
    if cause.joints and not rows["joint"].isin(cause.joints).any():
        faults.append(f"the log has no traverse of joint {' or '.join(map(str, cause.joints))}")
    return faults


@dataclass(frozen=True, eq=False)
class _LogTrialSearch(TrialSearch):
    """See `TrialSearch`; in the middle of each traverse."""

    rows: pd.DataFrame
    machine: Machine
    joint: int

    @cached_property
    def _middles(self) -> list[tuple[State, Array]]:
        """The states of each joint, with mean step sizes, (n, 1)."""
        middles = []
        for joint, own in self.rows.groupby("joint"):
            columns = {str(name): own[name].to_numpy() for name in own}
            position = (float_column(columns, "start") + float_column(columns, "stop")) / 2
            step = np.full(len(own), STEP_SIZE_GUESS)
            if "steps" in columns:
                step = traverse_length(columns) / expected_steps(columns["steps"], columns["check_every"])
            middles.append((state_at(int(str(joint)), columns, position[:, None]), step[:, None]))
        return middles

    def evaluate(self, order: Sequence[str], values: Array) -> tuple[Array, Array]:
        """See `TrialSearch`; rows without a quantity are left out."""
        effects, slopes = [], []
        function = self.limited.function(tuple(order))
        for state, step in self._middles:
            known = dict(zip(order, np.reshape(values, (-1, 1, 1)), strict=True))
            for name in self.cause.names:
                if name not in known:
                    known[name] = step if name == STEP_SIZE else quantity(state, name)
            effect, slope = function(known)
            effects.append(np.broadcast_to(effect, (len(step), 1))[:, 0])
            slopes.append(np.broadcast_to(slope, (len(step), 1, len(order)))[:, 0])
        return np.concatenate(effects)[self._known_rows], np.concatenate(slopes)[self._known_rows]

    @cached_property
    def _known_rows(self) -> BoolArray:
        known = []
        for state, step in self._middles:
            used = [name for name in self.cause.names if name not in self.declared and name != STEP_SIZE]
            columns = [np.broadcast_to(quantity(state, name), (len(step), 1)) for name in used]
            known.append(np.isfinite(np.hstack([step, *columns])).all(axis=1))
        rows = np.concatenate(known)
        if not rows.any():
            raise self.error(f"no traverse has all of {', '.join(self.cause.names)}")
        return rows

    def absent(self) -> tuple[Array, float]:
        if self.cause.operation == "=":
            target = [
                np.broadcast_to(quantity(state, self.cause.target), (len(step), 1))[:, 0]
                for state, step in self._middles
            ]
            known = np.concatenate(target)[self._known_rows]
            return known, float(np.abs(known).max(initial=0.0)) or 1.0
        size = {"*": 1.0, "steps +": COUNT}.get(self.cause.operation, self._step_size)
        return np.full(1, 1.0 if self.cause.operation == "*" else 0.0), size

    @property
    def _step_size(self) -> float:
        return float(np.mean(np.concatenate([step for _, step in self._middles])))

    def sizes_at(self, bound: FormulaTrials, place: Place, amplitudes: Sequence[str]) -> Array:
        """See `TrialSearch`: those that matter to a lab."""
        start = np.array([*np.zeros(len(amplitudes)), *place])
        slopes = self.evaluate(bound.order, start)[1][:, : len(amplitudes)]
        if not np.isfinite(slopes).all():
            row = first_row(~np.isfinite(slopes).all(axis=1))
            raise self.error(f"its effect is no number in row {row} of its joints' traverses")
        rms = np.sqrt(np.mean(slopes**2, axis=0)) if len(slopes) else np.ones(len(amplitudes))
        return np.repeat(self._effect_size / np.where(rms > 0, rms, self._effect_size), len(self.levels))

    @property
    def _effect_size(self) -> float:
        """An effect that matters, in the unit of what it acts on."""
        target = self.cause.target
        if self.cause.operation == "=":
            if target in OF_GEOMETRY:
                return LOAD
            joint = self.joint if target == "q" else int(target[1:]) if is_coordinate(target) else 0
            if joint and joint in self.machine.joints and self.machine.is_prismatic(joint):
                return LENGTH
            return ANGLE
        return {"+": SHARE * self._step_size, "*": SHARE, "steps +": COUNT}[self.cause.operation]
