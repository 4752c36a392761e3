"""FormulaTableCause: a cause given as a formula, in a table; it is tried at the size of the law's scatter."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._expression import Expression
from stickslip_fit._typing import Array
from stickslip_fit.causes.cause_formula import CauseFormula
from stickslip_fit.causes.formula_trials import MAX_LEVELS, FormulaTrials, Place, TrialSearch, first_row
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.table_cause import Effect, ExtendedTableLaw, Stage, TableCause
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws import Rows, TableLaw
from stickslip_fit.laws.dimensions import check_dimensions
from stickslip_fit.laws.table import count_rows, number_column, similar_name
from stickslip_fit.units import TableUnit, to_si

MAX_PARAMETERS = 8
MAX_NAMES_SHOWN = 40
MAX_EFFECT = 30.0  # of the scatter about the law, in trials of what is not linear in any parameter
MIN_SCATTER = 1e-6  # of the response's standard deviation; less is rounding
# Stages of what is added, with those in which causes of the law change it before it is added.
_BESIDE: dict[Stage, set[Stage]] = {"term": {"column"}, "measurement": {"column", "measurement", "factor"}}
_STAGES: dict[str, Stage] = {"+": "term", "*": "factor", "=": "column"}


@dataclass(frozen=True, kw_only=True)
class FormulaTableCause(FormulaTrials, TableCause):
    """A formula as a cause of a table; see `FormulaTrials`."""

    @property
    def stage(self) -> Stage:  # type: ignore[override]
        return _STAGES[self.source.operation]

    def stage_in(self, response: str) -> Stage:
        measures = self.stage == "term" and response in self.source.effect.names
        return "measurement" if measures else self.stage

    @property
    def target(self) -> str:  # type: ignore[override]
        return self.source.target

    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        effect, n = self.source.effect, count_rows(rows)
        outer = [name for name in effect.names if name in variable]
        fixed = [name for name in effect.names if name not in self.order and name not in variable]
        columns = {name: number_column(rows, name) for name in fixed}
        function = self.limited.function((*self.order, *outer))
        places, inside = self.own_places(rows[self.source.by] if self.source.by else None, n)
        null = np.array(self.null_values)[places]

        def apply(state: Mapping[str, Array], values: Array) -> tuple[Array, Array, dict[str, Array]]:
            own = np.where(inside[:, None], np.take_along_axis(values, places, axis=1), null)
            by_name = dict(zip(self.order, own.T, strict=True))
            value, slopes = function(columns | {name: state[name] for name in outer} | by_name)
            slopes = np.broadcast_to(slopes, (n, slopes.shape[-1]))
            own_slopes = np.zeros(values.shape)
            np.put_along_axis(own_slopes, places, slopes[:, : len(self.order)] * inside[:, None], axis=1)
            return value, own_slopes, dict(zip(outer, slopes[:, len(self.order) :].T, strict=True))

        return apply

    def changes(  # type: ignore[override]
        self, law: TableLaw | ExtendedTableLaw, rows: Rows, values: Array, trials: Array
    ) -> Array:
        """See `Cause.changes`; a row hangs on its own level alone, so that all levels are tried at once."""
        if len(self.levels) == 1:
            return self._changes_without_slopes(law, rows, values, trials)
        by_level = trials.reshape(len(trials), len(self.order), len(self.levels))
        packed = np.tile(np.array(self.null_values), (len(trials), 1)).reshape(by_level.shape)
        place_of, number = np.zeros((len(self.levels), len(trials)), dtype=np.intp), 0
        for level in range(len(self.levels)):
            own, place_of[level] = np.unique(by_level[:, :, level], axis=0, return_inverse=True)
            packed[: len(own), :, level] = own
            number = max(number, len(own))
        changes = self._changes_without_slopes(law, rows, values, packed[:number].reshape(number, -1))
        places, _ = self.own_places(rows[self.source.by], len(values))
        return np.take_along_axis(changes, place_of[places[:, 0]], axis=1)

    def _changes_without_slopes(
        self, law: TableLaw | ExtendedTableLaw, rows: Rows, values: Array, trials: Array
    ) -> Array:
        """Of what is added, without the derivatives that the law's model has."""
        base, others = (law.law, law.causes) if isinstance(law, ExtendedTableLaw) else (law, ())
        stage = self.stage_in(base.response_name)
        beside = {one.stage_in(base.response_name) for one in others}
        if stage not in _BESIDE or beside & _BESIDE[stage]:
            return super().changes(law, rows, values, trials)
        n, names = len(values), self.source.effect.names
        known = dict(zip(base.parameter_names, values.T, strict=False))
        if base.response_name in names:
            known[base.response_name] = law.predict(rows, values)
        own = [name for name in names if name not in known and name not in self.order]
        known |= {name: number_column(rows, name) for name in own}
        places, inside = self.own_places(rows[self.source.by] if self.source.by else None, n)
        null, changes = np.array(self.null_values), np.zeros((n, len(trials)))
        for k, trial in enumerate(trials):
            if np.any(trial != null):
                tried = np.where(inside[:, None], trial[places], null[places])
                effect = self.limited.evaluate(known | dict(zip(self.order, tried.T, strict=True)))
                changes[:, k] = np.broadcast_to(effect, (n,))
        if isinstance(law, ExtendedTableLaw) and beside & {"measurement", "factor"}:
            total, respond = law.split_at_terms(rows, values)
            before = respond(total)
            for change in changes.T:
                change[:] = respond(total + change) - before
        return changes


def bind_formula_to_table(
    cause: CauseFormula, law: TableLaw | ExtendedTableLaw, frame: pd.DataFrame
) -> FormulaTableCause:
    """A formula as a cause of a table; see `FormulaCause.bind_table`."""
    base = law.law if isinstance(law, ExtendedTableLaw) else law
    if faults := _find_faults(cause, base, frame):
        raise InputError([InputIssue(f"the cause {cause.name}: {fault}") for fault in faults])
    _check_units(cause, base)
    levels = tuple(sorted(frame[cause.by].unique().tolist(), key=str)) if cause.by else (None,)
    declared = {one.name: _in_table_unit(one) for one in cause.declared}
    y = base.response(frame)[0]
    return _TableTrialSearch(cause, declared, levels, base, frame, y, base.start_values(frame, y)).bind()


def _in_table_unit(parameter: CauseParameter) -> CauseParameter:
    """Per cent is a share; other numbers are as the table has them."""
    if parameter.unit == "%":
        low, high = (to_si(end, "%") for end in (parameter.lower, parameter.upper))
        return replace(parameter, lower=low, upper=high)
    return replace(parameter, unit=TableUnit("" if parameter.unit == "1" else parameter.unit))


def _find_faults(cause: CauseFormula, law: TableLaw, frame: pd.DataFrame) -> list[str]:
    own = [one.name for one in cause.declared]
    columns = [str(name) for name in frame.columns]
    known = [*columns, *law.parameter_names, law.response_name]
    faults = [
        f"{name} is also a column or a parameter of the law; name it otherwise"
        for name in own
        if name in known
    ]
    for name in (*cause.names, *([cause.by] if cause.by else [])):
        if name not in own and name not in known:
            similar = similar_name(name, known)
            there = ", ".join(known[:MAX_NAMES_SHOWN])
            hint = f"; did you mean {similar}?" if similar else f"; there are {there}"
            faults.append(f"{name} is no column, no parameter of the law and none of its own{hint}")
    if len(own) > MAX_PARAMETERS:
        faults.append(f"it has {len(own)} parameters, more than {MAX_PARAMETERS}")
    if cause.operation == "steps +":
        faults.append("a table has no steps; what is added to the response begins with + alone")
    if cause.by and cause.by in columns and frame[cause.by].isna().any():
        faults.append(f"the column {cause.by} has empty cells, and every row needs its own parameters")
    if cause.by in columns and (number := frame[cause.by].nunique()) > MAX_LEVELS:
        faults.append(f"the column {cause.by} has {number:,} values; by= takes at most {MAX_LEVELS}")
    if cause.operation == "=":
        if cause.target not in law.right.names or cause.target not in columns:
            faults.append(f"{cause.target} is no column that the law {law.name!r} uses")
        if law.response_name in cause.names:
            faults.append(f"the response {law.response_name} is not known before the law")
    return faults


def _check_units(cause: CauseFormula, law: TableLaw) -> None:
    """The units of a cause, where all are declared; a parameter without one is not."""
    units = {name: str(unit) for name, unit in law.source.units.items()}
    own = {one.name: "1" if one.unit == "%" else str(one.unit) for one in cause.declared if one.unit != "1"}
    other = cause.target or law.response_name
    expected, name = ("1", "a factor") if cause.operation == "*" else (units.get(other), other)
    if expected is not None and isinstance(cause.effect, Expression):
        check_dimensions(cause.effect, units | own, expected, name, cause.text)


@dataclass(frozen=True, eq=False)
class _TableTrialSearch(TrialSearch):
    """See `TrialSearch`; for a law at values of shape (p,) and responses of shape (n,)."""

    law: TableLaw
    frame: pd.DataFrame
    y: Array
    values: Array

    def bind(self) -> FormulaTableCause:
        """The cause, with trials for its parameters."""
        by = (self.cause.by,) if self.cause.by else ()
        law_names = (*self.law.parameter_names, self.law.response_name)
        used = [name for name in self.cause.names if name not in self.declared and name not in law_names]
        bound = self.choose(lambda **found: FormulaTableCause(columns=(*used, *by), **found))
        assert isinstance(bound, FormulaTableCause)
        return bound

    def evaluate(self, order: Sequence[str], values: Array) -> tuple[Array, Array]:
        """See `TrialSearch`: all levels alike."""
        n = len(self.frame)
        known = {name: np.full(n, value) for name, value in zip(order, values, strict=True)}
        law = zip(self.law.parameter_names, self.values, strict=True)
        known |= {name: np.full(n, value) for name, value in law}
        known[self.law.response_name] = self.law.predict(self.frame, self.values)
        for name in self.cause.names:
            if name not in known:
                known[name] = number_column(self.frame, name)
        value, slopes = self.limited.function(tuple(order))(known)
        return np.broadcast_to(value, (n,)), np.broadcast_to(slopes, (n, len(order)))

    def moderate(self, order: Sequence[str], places: Sequence[Place]) -> list[Place]:
        """See `TrialSearch`: those whose effect has a size with the scatter about the law."""
        absent, scatter = self.absent()[0], np.std(self.y - self.law.predict(self.frame, self.values))
        effects = {place: self.evaluate(order, np.array(place))[0] - absent for place in places if any(place)}
        sizes = {place: float(np.sqrt(np.mean(effect**2))) for place, effect in effects.items()}
        return [place for place, size in sizes.items() if size < MAX_EFFECT * scatter] or list(sizes)

    def absent(self) -> tuple[Array, float]:
        if self.cause.operation == "=":
            column = number_column(self.frame, self.cause.target)
            return column, float(np.abs(column).max())
        return (np.ones(1), 1.0) if self.cause.operation == "*" else (np.zeros(1), float(np.std(self.y)))

    def sizes_at(self, bound: FormulaTrials, place: Place, amplitudes: Sequence[str]) -> Array:
        """See `TrialSearch`: those at which the effect is as large as the scatter about the law."""
        assert isinstance(bound, FormulaTableCause)
        n, p = len(amplitudes) * len(self.levels), len(self.values)
        values = np.concatenate([self.values, np.zeros(n), np.repeat(place, len(self.levels))])
        predicted, slopes = bound.extend(self.law).model(self.frame)(values)
        own = slopes[:, p : p + n]
        if not np.isfinite(own).all():
            row = first_row(~np.isfinite(own).all(axis=1))
            raise self.error(f"its effect is no number in row {row} of the table")
        scatter = float(np.sqrt(np.mean((self.y - predicted) ** 2)))
        scatter = max(scatter, MIN_SCATTER * float(np.std(self.y))) or 1.0
        acts = np.maximum(np.count_nonzero(own, axis=0), 1)
        rms = np.sqrt(np.sum(own**2, axis=0) / acts)
        return np.where(rms > 0, scatter / np.where(rms > 0, rms, 1.0), 1.0)
