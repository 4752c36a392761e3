"""TableCause: what a law of a table leaves out; ExtendedTableLaw: such a law with causes in it.

The response is evaluated in a fixed order: columns as they truly are, the law, what is added to it, what is
added as the response is measured and depends on it, what it is multiplied by. Each cause acts at one of these
stages. Derivatives follow by the chain rule, exact wherever those of the pieces are.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from typing import ClassVar, Literal

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.parameters import CauseParameter, number_repeated
from stickslip_fit.laws import Parameter, Rows, TableLaw
from stickslip_fit.laws.base import Model
from stickslip_fit.laws.table import count_rows, number_column

Stage = Literal["column", "term", "measurement", "factor"]
Effect = Callable[[Mapping[str, Array], Array], tuple[Array, Array, Mapping[str, Array]]]
"""Quantities by name, (n,), and the cause's values, (n, q), to the effect, (n,), and its derivatives: by the
values, (n, q), and by quantities that depend on parameters, (n,)."""


class TableCause(Cause):
    """A cause that acts in a table, bound to it; see `Cause` for its attributes.

    Attributes
    ----------
    stage : {"column", "term", "measurement", "factor"}
        Whether it puts something in place of a column, adds to the response, adds something that depends on
        the response, or multiplies it.
    target : str
        The column that it replaces.
    texts : tuple of str
        Columns whose values it takes for names, be they numbers or not.
    constant_beyond : tuple of str
        Columns beyond whose known values the effect is what it is at the last of them.
    """

    stage: Stage = "term"
    target: str = ""
    texts: tuple[str, ...] = ()
    constant_beyond: tuple[str, ...] = ()
    joints: ClassVar[tuple[int, ...]] = (1,)
    takes_functions: ClassVar[bool] = False  # it has one equation, which may be far from the function
    physics: ClassVar[str] = ""
    shows_best: ClassVar[str] = ""

    def stage_in(self, response: str) -> Stage:
        """The stage in a law of this response; what is added and depends on it acts on all other terms."""
        return self.stage

    @abstractmethod
    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        """What it does in these rows.

        Parameters
        ----------
        rows : DataFrame or mapping of str to array
        variable : collection of str
            Quantities that depend on parameters, and so need derivatives: the law's parameters, columns that
            other causes replace, and the response by its name.
        """

    def extend(self, law: TableLaw | ExtendedTableLaw) -> ExtendedTableLaw:  # type: ignore[override]
        if isinstance(law, ExtendedTableLaw):
            return ExtendedTableLaw(law.law, (*law.causes, self))
        return ExtendedTableLaw(law, (self,))

    def changes(  # type: ignore[override]
        self, law: TableLaw | ExtendedTableLaw, rows: Rows, values: Array, trials: Array
    ) -> Array:
        """See `Cause.changes`: the finite change, whatever the size."""
        model, before = self.extend(law).model(rows), law.predict(rows, values)
        changes = np.zeros((len(values), len(trials)))
        for k, trial in enumerate(trials):
            if np.any(trial != np.array(self.null_values)):
                changes[:, k] = model(np.hstack([values, np.tile(trial, (len(values), 1))]))[0] - before
        return changes


@dataclass(frozen=True, eq=False)
class ExtendedTableLaw:
    """A law of a table and the causes by which the response departs from it.

    Its parameters are the law's own, then those of each cause under ``cause.parameter``; the causes' are
    shared by all rows. Methods are those of `TableLaw`. `known` has the range of columns in the rows that the
    causes were fitted to, where it is not all that causes know of them.
    """

    law: TableLaw
    causes: tuple[TableCause, ...]
    known: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def fitted_to(self, rows: pd.DataFrame) -> ExtendedTableLaw:
        """The law as these rows know it: causes of other rows are constant beyond them."""
        columns = {name for cause in self.causes for name in cause.constant_beyond}
        limits = {name: (float(rows[name].min()), float(rows[name].max())) for name in sorted(columns)}
        return replace(self, known=limits)

    @cached_property
    def cause_parameters(self) -> tuple[CauseParameter, ...]:
        """The causes' parameters, one cause after the other."""
        return tuple(
            replace(parameter, name=f"{name}.{parameter.name}")
            for cause, name in zip(self.causes, number_repeated(one.name for one in self.causes), strict=True)
            for parameter in cause.parameters
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The law's own, then the causes'."""
        return (*self.law.parameters, *self.cause_parameters)

    @property
    def n_shared(self) -> int:
        """How many of the parameters, the last ones, all rows share."""
        return self.law.n_shared + len(self.cause_parameters)

    @property
    def null_values(self) -> Array:
        """Values of the causes' parameters without effect, shape (q,)."""
        return np.array([value for cause in self.causes for value in cause.null_values], dtype=float)

    @property
    def columns(self) -> tuple[str, ...]:
        """All that it uses."""
        return tuple(
            dict.fromkeys([*self.law.columns, *(name for one in self.causes for name in one.columns)])
        )

    @property
    def name(self) -> str:
        """The law's, with the causes'."""
        return " + ".join([self.law.name, *(cause.name for cause in self.causes)])

    @property
    def response_name(self) -> str:
        """See `TableLaw`."""
        return self.law.response_name

    @property
    def response_unit(self) -> str:
        """See `TableLaw`."""
        return self.law.response_unit

    def response(self, rows: Rows) -> tuple[Array, Array]:
        """See `TableLaw.response`."""
        return self.law.response(rows)

    def start_values(self, rows: Rows, y: Array, near: Sequence[Array] | None = None) -> Array:
        """See `TableLaw.start_values`: the law's own, with the causes absent."""
        own = None if near is None else [one[: len(self.law.parameters)] for one in near]
        return np.concatenate([self.law.start_values(rows, y, own), self.null_values])

    def predict(self, rows: Rows, values: Array) -> Array:
        """The response, shape (n,)."""
        return self.model(rows)(values)[0]

    def jacobian(self, rows: Rows, values: Array) -> Array:
        """Derivatives of the response by each row's own parameters, shape (n, p)."""
        return self.model(rows)(values)[1]

    def model(self, rows: Rows) -> Model:
        """The response and its derivatives as a function of the values alone; see `StepLaw.model`."""
        n, names, response = count_rows(rows), self.law.parameter_names, self.law.response_name
        replaced = tuple(dict.fromkeys(cause.target for cause in self.causes if cause.stage == "column"))
        columns = self.law.quantities(rows) | {name: number_column(rows, name) for name in replaced}
        variable = (*names, *replaced)
        law = self.law.right.function(tuple(name for name in variable if name in self.law.right.names))
        effects = {
            stage: [
                (cause.target, places, cause.effect(self._clip(rows, cause), (*variable, response)))
                for cause, places in self._places
                if cause.stage_in(response) == stage
            ]
            for stage in ("column", "term", "measurement", "factor")
        }

        def predict(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (n, len(self.parameters)))
            state = _Quantities(dict(columns), {}, n, values.shape[1])
            for k, name in enumerate(names):
                state.put_parameter(name, values[:, k], k)
            for target, places, effect in effects["column"]:
                state.put(target, *state.apply(effect, values, places))
            by = tuple(name for name in variable if name in self.law.right.names)
            value, slopes = law(state.values)
            value = np.broadcast_to(value, (n,))
            total, slopes = value, state.chain(dict(zip(by, np.moveaxis(slopes, -1, 0), strict=True)))
            for stage in ("term", "measurement"):
                state.put(response, total, slopes)
                for _, places, effect in effects[stage]:
                    added, added_slopes = state.apply(effect, values, places)
                    total, slopes = total + added, slopes + added_slopes
            for _, places, effect in effects["factor"]:
                factor, factor_slopes = state.apply(effect, values, places)
                slopes = slopes * factor[:, None] + factor_slopes * total[:, None]
                total = total * factor
            return total, slopes

        return predict

    def split_at_terms(self, rows: Rows, values: Array) -> tuple[Array, Callable[[Array], Array]]:
        """What the law and the terms add up to, shape (n,), and from such a sum to the response.

        Of causes none of which replaces a column. Those that depend on the response, or multiply it, act on
        the sum of all terms.
        """
        names, response = self.law.parameter_names, self.law.response_name
        known = self.law.quantities(rows) | dict(zip(names, values.T, strict=False))
        effects = [
            (cause.stage_in(response), places, cause.effect(self._clip(rows, cause), (*names, response)))
            for cause, places in self._places
        ]

        def evaluate(stage: Stage, state: Mapping[str, Array]) -> list[Array]:
            return [effect(state, values[:, places])[0] for own, places, effect in effects if own == stage]

        def respond(total: Array) -> Array:
            state = known | {response: total}
            measured = sum(evaluate("measurement", state), start=total)
            return np.broadcast_to(prod(evaluate("factor", state), start=measured), (len(values),))

        terms = evaluate("term", known)
        return sum(terms, start=self.law.predict(rows, values[:, : len(names)])), respond

    def _clip(self, rows: Rows, cause: TableCause) -> Rows:
        """Rows within what is known of a cause's columns."""
        names = [name for name in cause.constant_beyond if name in self.known]
        if not names:
            return rows
        return {**rows, **{name: np.clip(np.asarray(rows[name], float), *self.known[name]) for name in names}}

    @property
    def _places(self) -> list[tuple[TableCause, slice]]:
        """Each cause with the columns of its parameters."""
        places, first = [], len(self.law.parameters)
        for cause in self.causes:
            places.append((cause, slice(first, first := first + len(cause.parameters))))
        return places


@dataclass(frozen=True, eq=False)
class _Quantities:
    """Quantities of n rows, and the derivatives of those that depend on any of p values."""

    values: dict[str, Array]
    slopes: dict[str, Array]
    n: int
    p: int

    def put(self, name: str, value: Array, slopes: Array) -> None:
        """A quantity in place of one of that name."""
        self.values[name], self.slopes[name] = value, slopes

    def put_parameter(self, name: str, value: Array, place: int) -> None:
        """A quantity that is one of the values itself."""
        slopes = np.zeros((self.n, self.p))
        slopes[:, place] = 1.0
        self.put(name, value, slopes)

    def chain(self, by: Mapping[str, Array]) -> Array:
        """Derivatives by the values, (n, p), from those by quantities, each (n,)."""
        total = np.zeros((self.n, self.p))
        for name, slope in by.items():
            total += np.broadcast_to(slope, (self.n,))[:, None] * self.slopes[name]
        return total

    def apply(self, effect: Effect, values: Array, places: slice) -> tuple[Array, Array]:
        """A cause's effect and its derivatives by the values."""
        value, own, by = effect(self.values, values[:, places])
        slopes = self.chain({name: slope for name, slope in by.items() if name in self.slopes})
        slopes[:, places] += own
        return np.broadcast_to(value, (self.n,)), slopes
