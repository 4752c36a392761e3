"""FormulaTableCause: a cause given as a formula, in a table; its sizes are chosen from the rows.

Parameters in which the effect is linear, and without which there is none, are its amplitudes: they come first
and are tried at the size at which the effect is as large as the scatter about the law. The others are tried
on a grid within their bounds.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from math import isfinite
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.cause_formula import CauseFormula
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.table_cause import Effect, ExtendedTableLaw, Stage, TableCause
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws import Rows, TableLaw
from stickslip_fit.laws.table import count_rows, find_linear, number_column, similar_name, spread
from stickslip_fit.units import TableUnit, to_si

NUMBER_OF_PLACES = {0: 1, 1: 9, 2: 7, 3: 4}  # along each of so many nonlinear parameters
MAX_PARAMETERS = 8
NULL_TOL = 1e-9
_STAGES: dict[str, Stage] = {"+": "term", "*": "factor", "=": "column"}


_PHRASES = {"+": "the law lacks {}", "*": "the response is {} times the law's", "=": "{1} in truth is {0}"}
Place = tuple[float, ...]
"""Values of the parameters that are no amplitudes."""


@dataclass(frozen=True)
class FormulaTableCause(TableCause):
    """A formula as a cause of a table.

    Attributes
    ----------
    source : CauseFormula
    order : tuple of str
        The formula's parameters, amplitudes first.
    levels : tuple
        Values of the column `source.by`, for each of which there is one set of parameters; else None alone.
    sizes : tuple of (tuple of float, tuple of float)
        Of each place that is tried, the values there of what is no amplitude, and the amplitudes' sizes.
    """

    source: CauseFormula
    order: tuple[str, ...]
    levels: tuple[Any, ...]
    parameters: tuple[CauseParameter, ...]
    null_values: tuple[float, ...]
    scale: tuple[float, ...]
    sizes: tuple[tuple[Place, Place], ...] = ()

    max_trial_factor = 100.0  # what is tried has the size of the scatter, or of a guess

    @property
    def name(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return self.source.name

    @property
    def phrase(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return self.source.phrase or _PHRASES[self.source.kind].format(
            self.source.effect.text.strip(), self.target
        )

    @property
    def physics(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return self.source.physics

    @property
    def sentence(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return self.source.sentence

    @property
    def remedy(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return self.source.remedy

    @property
    def shows_best(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return self.source.shows_best

    @property
    def stage(self) -> Stage:  # type: ignore[override]
        """See `TableCause`."""
        return _STAGES[self.source.kind]

    @property
    def target(self) -> str:  # type: ignore[override]
        """See `TableCause`."""
        return self.source.target

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `Cause`; also the law's parameters and the response, where it uses them."""
        by = (self.source.by,) if self.source.by else ()
        return (*(name for name in self.source.names if name not in self.order), *by)

    @property
    def combine_trials(self) -> bool:  # type: ignore[override]
        """See `Cause`."""
        return len(self.sizes) > 0 and len(self.sizes[0][1]) > 1

    def trials(self, rows: pd.DataFrame) -> list[tuple[FormulaTableCause, Array]]:  # type: ignore[override]
        """See `Cause.trials`: a version for each place where several amplitudes act together."""
        if not self.combine_trials:
            return [(self, np.array([[*amplitudes, *place] for place, amplitudes in self.sizes]))]
        versions = []
        for place, amplitudes in self.sizes:
            null = (*np.zeros(len(amplitudes)), *np.repeat(place, len(self.levels)))
            trials = np.column_stack(
                [np.diag(amplitudes), np.tile(null[len(amplitudes) :], (len(amplitudes), 1))]
            )
            versions.append(
                (replace(self, null_values=tuple(map(float, null)), sizes=((place, amplitudes),)), trials)
            )
        return versions

    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        """See `TableCause.effect`."""
        effect, n = self.source.effect, count_rows(rows)
        outer = [name for name in effect.names if name in variable]
        fixed = [name for name in effect.names if name not in self.order and name not in variable]
        columns = {name: number_column(rows, name) for name in fixed}
        function = effect.function((*self.order, *outer))
        level, inside = self._level_of(rows, n)
        # One for each parameter of the formula and row: where its value stands among the cause's.
        place = level[:, None] + len(self.levels) * np.arange(len(self.order))
        null = np.array(self.null_values)

        def apply(state: Mapping[str, Array], values: Array) -> tuple[Array, Array, dict[str, Array]]:
            own = np.where(inside[:, None], np.take_along_axis(values, place, axis=1), null[place])
            by_name = dict(zip(self.order, own.T, strict=True))
            value, slopes = function(columns | {name: state[name] for name in outer} | by_name)
            slopes = np.broadcast_to(slopes, (n, slopes.shape[-1]))
            own_slopes = np.zeros(values.shape)
            np.put_along_axis(own_slopes, place, slopes[:, : len(self.order)] * inside[:, None], axis=1)
            return value, own_slopes, dict(zip(outer, slopes[:, len(self.order) :].T, strict=True))

        return apply

    def _level_of(self, rows: Rows, n: int) -> tuple[IntArray, npt.NDArray[np.bool_]]:
        """The index of each row's level, and whether it has one."""
        if not self.source.by:
            return np.zeros(n, dtype=np.intp), np.ones(n, dtype=bool)
        level = pd.Index(self.levels).get_indexer(pd.Index(np.asarray(rows[self.source.by])))
        return np.maximum(level, 0), level >= 0


def bind_formula_to_table(
    cause: CauseFormula, law: TableLaw | ExtendedTableLaw, frame: pd.DataFrame
) -> FormulaTableCause:
    """A formula as a cause of a table; see `FormulaCause.bind_table`."""
    base = law.law if isinstance(law, ExtendedTableLaw) else law
    faults = list(_find_faults(cause, base, frame))
    if faults:
        raise InputError([InputIssue(f"the cause {cause.name}: {fault}") for fault in faults])
    levels = tuple(sorted(frame[cause.by].unique().tolist())) if cause.by else (None,)
    declared = {one.name: _in_table_unit(one) for one in cause.declared}
    y = base.response(frame)[0]
    return _Binding(cause, base, frame, y, base.start_values(frame, y), declared, levels).bind()


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
            hint = f"; did you mean {similar}?" if similar else f"; there are {', '.join(known[:40])}"
            faults.append(f"{name} is no column, no parameter of the law and none of its own{hint}")
    if len(own) > MAX_PARAMETERS:
        faults.append(f"it has {len(own)} parameters, more than {MAX_PARAMETERS}")
    if cause.kind == "steps +":
        faults.append("a table has no steps; what is added to the response begins with + alone")
    if cause.by and cause.by in columns and frame[cause.by].isna().any():
        faults.append(f"the column {cause.by} has empty cells, and every row needs its own parameters")
    if cause.kind == "=":
        if cause.target not in law.right.names or cause.target not in columns:
            faults.append(f"{cause.target} is no column that the law {law.name!r} uses")
        if law.response_name in cause.names:
            faults.append(f"the response {law.response_name} is not known before the law")
    return faults


@dataclass(frozen=True, eq=False)
class _Binding:
    """The choice of amplitudes and sizes, for a law at values of shape (p,)."""

    cause: CauseFormula
    law: TableLaw
    frame: pd.DataFrame
    y: Array
    values: Array
    declared: Mapping[str, CauseParameter]
    levels: tuple[Any, ...]

    def bind(self) -> FormulaTableCause:
        """The cause, with trials for its parameters."""
        names = list(self.declared)
        amplitudes = self._choose_amplitudes(names)
        others = [name for name in names if name not in amplitudes]
        if unbounded := [name for name in others if not self._is_bounded(name)]:
            raise self._error(
                f"it is not linear in {' and '.join(unbounded)}, so that trials need bounds, e.g. "
                f"bounds={{{unbounded[0]!r}: (low, high)}}"
            )
        if len(others) not in NUMBER_OF_PLACES:
            raise self._error(
                f"it is not linear in {', '.join(others)}; at most {max(NUMBER_OF_PLACES)} can be searched"
            )
        if not amplitudes and len(self.levels) > 1:
            raise self._error(
                f"by={self.cause.by!r} needs a parameter in which it is linear, such as a factor A"
            )
        bound = self._with_order((*amplitudes, *others), len(amplitudes))
        places = self._places(others)
        sizes = [(place, self._sizes_at(bound, place, amplitudes)) for place in places]
        if not amplitudes:
            sizes = [(place[1:], place[:1]) for place in places if any(place)]
        middle = len(sizes) // 2
        scale = (*sizes[middle][1], *bound.scale[len(sizes[middle][1]) :])
        return replace(bound, sizes=tuple(sizes), scale=scale)

    def _error(self, reason: str) -> InputError:
        return InputError(f"the cause {self.cause.name}: {reason}")

    def _is_bounded(self, name: str) -> bool:
        return isfinite(self.declared[name].upper - self.declared[name].lower)

    def _middle(self, name: str) -> float:
        one = self.declared[name]
        return float(spread(one.lower, one.upper, 1)[0]) if self._is_bounded(name) else 1.0

    def _evaluate(self, names: Sequence[str], values: npt.ArrayLike) -> tuple[Array, Array]:
        """The effect and its derivatives in every row, all levels alike."""
        n = len(self.frame)
        one = self._with_order(tuple(names), 0, (None,))
        state = {
            name: np.full(n, value) for name, value in zip(self.law.parameter_names, self.values, strict=True)
        }
        state |= {self.law.response_name: self.law.predict(self.frame, self.values)}
        known = {
            **state,
            **(
                {self.cause.target: number_column(self.frame, self.cause.target)} if self.cause.target else {}
            ),
        }
        value, slopes, _ = one.effect(self.frame, tuple(known))(
            known, np.tile(np.asarray(values, float), (n, 1))
        )
        return np.broadcast_to(value, (n,)), slopes

    def _choose_amplitudes(self, names: Sequence[str]) -> tuple[str, ...]:
        """The largest set in which the effect is linear and without which there is none."""
        sets = [some for size in range(len(names), -1, -1) for some in combinations(names, size)]
        unbounded = {name for name in names if not self._is_bounded(name)}
        sets.sort(key=lambda some: (-len(some), not unbounded <= set(some)))
        for some in sets:
            if self._are_amplitudes(some, [name for name in names if name not in some]):
                return some
        raise self._error(
            "with its parameters at 0 it still changes the response; write it so that 0 means no effect, "
            "e.g. '* (1 + k*x)' in place of '* k*x'"
        )

    def _are_amplitudes(self, some: Sequence[str], others: Sequence[str]) -> bool:
        """Whether the effect is linear in some of the parameters, and absent where they are 0."""
        absent = np.array([*np.zeros(len(some)), *(self._middle(name) if some else 0.0 for name in others)])

        def evaluate(values: Array) -> tuple[Array, Array]:
            return self._evaluate((*some, *others), values)

        without, places = evaluate(absent)[0], list(range(len(some)))
        if not some and not np.isfinite(without).all():
            raise self._error(f"its effect is no number in row {_first(~np.isfinite(without))} of the table")
        return self._vanishes(without) and find_linear(evaluate, absent, places) == places

    def _vanishes(self, effect: Array) -> bool:
        kind, target = self.cause.kind, self.cause.target
        absent = number_column(self.frame, target) if kind == "=" else np.array(1.0 if kind == "*" else 0.0)
        size = max(float(np.abs(absent).max()), float(np.std(self.y)) if kind == "+" else 0.0)
        return bool(np.all(np.abs(effect - absent) <= NULL_TOL * size))

    def _with_order(
        self, order: tuple[str, ...], amplitudes: int, levels: tuple[Any, ...] | None = None
    ) -> FormulaTableCause:
        levels = self.levels if levels is None else levels
        source = self.cause if levels == self.levels else replace(self.cause, by="")
        parameters, null, scale = [], [], []
        for k, name in enumerate(order):
            one, middle = self.declared[name], self._middle(name)
            for level in levels:
                parameters.append(replace(one, name=name if level is None else f"{name}[{level}]"))
                null.append(0.0 if k < amplitudes or not amplitudes else middle)
                scale.append(abs(middle) or 1.0)
        return FormulaTableCause(source, order, levels, tuple(parameters), tuple(null), tuple(scale))

    def _places(self, others: Sequence[str]) -> list[Place]:
        number = NUMBER_OF_PLACES[len(others)]
        along = [spread(self.declared[name].lower, self.declared[name].upper, number) for name in others]
        return [tuple(map(float, place)) for place in product(*along)]

    def _sizes_at(self, bound: FormulaTableCause, place: Place, amplitudes: Sequence[str]) -> Place:
        """Of each amplitude the size at which the effect is as large as the scatter about the law."""
        if not amplitudes:
            return ()
        n = len(amplitudes) * len(self.levels)
        values = np.concatenate([self.values, np.zeros(n), np.repeat(place, len(self.levels))])
        predicted, slopes = bound.extend(self.law).model(self.frame)(values)
        own = slopes[:, len(self.values) : len(self.values) + n]
        if not np.isfinite(own).all():
            row = _first(~np.isfinite(own).all(axis=1))
            raise self._error(f"its effect is no number in row {row} of the table")
        scatter = float(np.sqrt(np.mean((self.y - predicted) ** 2))) or float(np.std(self.y)) or 1.0
        acts = np.maximum(np.count_nonzero(own, axis=0), 1)
        rms = np.sqrt(np.sum(own**2, axis=0) / acts)
        sizes = np.where(rms > 0, scatter / np.where(rms > 0, rms, 1.0), 1.0)
        for k, name in enumerate(amplitudes):
            given = self.cause.size.get(name) if isinstance(self.cause.size, Mapping) else self.cause.size
            if given is not None and (k == 0 or isinstance(self.cause.size, Mapping)):
                own_places = slice(k * len(self.levels), (k + 1) * len(self.levels))
                sizes[own_places] = to_si(float(given), "%") if self.declared[name].unit == "%" else given
        return tuple(map(float, sizes))


def _first(rows: npt.NDArray[np.bool_]) -> int:
    """The number of the first row of a table that is true."""
    return int(np.argmax(rows)) + 1
