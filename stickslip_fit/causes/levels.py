"""Causes of a column of texts, such as a specimen, an operator or a state: what differs between its values.

Either the response is higher at some of them by a constant, or the law's own parameters are not the same:
the analysis of covariance (R. A. Fisher, Statistical Methods for Research Workers, 1932), for any law.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from stickslip_fit._format import format_measured, join_words
from stickslip_fit._typing import Array
from stickslip_fit.causes.generic import AddedTerm, CovariateCause, GenericCause, Term, linear_term
from stickslip_fit.causes.parameters import CauseParameter, SizedParameter, Sizes
from stickslip_fit.causes.table_cause import Effect
from stickslip_fit.errors import InputIssue, shorten
from stickslip_fit.laws import Rows, TableLaw
from stickslip_fit.units import TableUnit

MAX_LEVELS, MIN_ROWS_PER_LEVEL = 12, 3  # of a column; rows, on average


def find_levels(cells: pd.Series) -> tuple[str, ...]:
    """The values of a column of texts in their order of appearance.

    Examples
    --------
    >>> find_levels(pd.Series(["old", "new", "old"]))
    ('old', 'new')
    """
    return tuple(map(str, cells.astype(object).astype(str).unique()))


def explain_unusable_levels(cells: pd.Series) -> str | None:
    """Why a column of texts can say nothing of the response, None where it can."""
    if cells.isna().any():
        return f"{int(cells.isna().sum()):,} of its cells are empty"
    number = len(find_levels(cells))
    if number < 2:
        return "it is the same in every row"
    if number > MAX_LEVELS or number * MIN_ROWS_PER_LEVEL > len(cells):
        return f"it has {number:,} different texts in {len(cells):,} rows"
    return None


@dataclass(frozen=True, kw_only=True)
class LevelCause(CovariateCause):
    """Something differs between the values of a column of texts.

    Attributes
    ----------
    levels : tuple of str
        Its values; what differs is said beside the first.
    law : TableLaw
        Of the table.
    slopes : tuple of float
        Rms derivative of the response by each of the law's parameters.
    """

    levels: tuple[str, ...]
    law: TableLaw = field(repr=False)
    slopes: tuple[float, ...]

    base_phrase = "the response is not the same at all values of a column"
    physics = "Whatever differs between them; the table alone shows that the response is not the same."
    shows_best = "one condition at every value of the column"

    @property
    def remedy(self) -> str:  # type: ignore[override]
        """See `GenericCause`."""
        return f"calibrating for each {self.column}"

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `GenericCause`."""
        others = join_words(list(self.levels[1:]), "or")
        own = {"d": sizes["d"]} if "d" in sizes else {}
        return {**own, "column": self.column, "first": self.levels[0], "others": others}

    def find_unknown(self, frame: pd.DataFrame) -> list[InputIssue]:
        """What keeps rows from being predicted: no such column, or a value of it that was never fitted."""
        if self.column not in frame:
            return [InputIssue("the table has no such column, and the law needs it", column=self.column)]
        cells = frame[self.column].astype(object).astype(str).reset_index(drop=True)
        unknown = cells[~cells.isin(self.levels)].drop_duplicates()
        known = ", ".join(map(shorten, self.levels))
        return [
            InputIssue(f"row {row + 1}: the law was fitted to {known} only", column=self.column, value=value)
            for row, value in unknown.items()
        ]

    def indicators(self, rows: Rows) -> Array:
        """1 in the rows of each level but the first, shape (n, levels - 1)."""
        cells = np.asarray(rows[self.column], dtype=object).astype(str)
        return (cells[:, None] == np.array(self.levels[1:])).astype(float)


@dataclass(frozen=True, kw_only=True)
class LevelDependence(LevelCause, AddedTerm):
    """Each value of a column of texts has an offset of its own."""

    @property
    def sentence(self) -> str:  # type: ignore[override]
        """See `GenericCause`."""
        if len(self.levels) == 2:
            return (
                "The response is {d:higher|lower} by {d} where {column} is {others} than where it is {first}"
            )
        return "The response is not the same for every {column}"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `GenericCause`: the first level has none."""
        unit, first = TableUnit(self.unit), self.levels[0]
        names = ["d"] if len(self.levels) == 2 else [f"d[{level}]" for level in self.levels[1:]]
        return tuple(
            CauseParameter(name, unit, f"offset of {self.column} {level} beside {first}")
            for name, level in zip(names, self.levels[1:], strict=True)
        )

    def trials(self, rows: pd.DataFrame) -> list[tuple[GenericCause, Array]]:  # type: ignore[override]
        """See `GenericCause`: offsets, and other parameters of the law."""
        versions: list[GenericCause] = [self, ParametersByLevel(**vars(self))]
        return [(one, np.diag(one.scale)) for one in versions]

    def term(self, rows: Rows) -> Term:
        """See `GenericCause`."""
        return linear_term(self.indicators(rows))


@dataclass(frozen=True, kw_only=True)
class ParametersByLevel(LevelCause):
    """The law's parameters are not the same at all values of a column of texts."""

    @property
    def sentence(self) -> str:  # type: ignore[override]
        """See `GenericCause`."""
        return "The law has other parameters where {column} is {others}, not {first}{how}"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `GenericCause`: parameter by parameter, the first level has none."""
        two, first = len(self.levels) == 2, self.levels[0]
        return tuple(
            CauseParameter(
                own.name if two else f"{own.name}[{level}]",
                own.unit,
                f"change of {own.name} at {self.column} {level} beside {first}",
            )
            for own in self.law.parameters
            for level in self.levels[1:]
        )

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `GenericCause`: as large an effect on the response by each parameter."""
        each = [self.size / slope if slope > 0 else 0.0 for slope in self.slopes]
        return tuple(np.repeat(each, len(self.levels) - 1).tolist())

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `GenericCause`."""
        changes = [
            f"{name} by {format_measured(one.size, one.unit)}"
            for name, one in sizes.items()
            if isinstance(one, SizedParameter)
        ]
        how = f": {join_words(changes)}" if len(self.levels) == 2 and changes else ""
        return {**super().quantities({}), "how": how}

    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        """See `TableCause`: the law with other parameters less the law."""
        inside, own_names = self.indicators(rows), self.law.parameter_names
        by = tuple(dict.fromkeys([*own_names, *(name for name in variable if name in self.law.right.names)]))
        function, n, width = self.law.right.function(by), len(inside), len(self.levels) - 1

        def effect(state: Mapping[str, Array], values: Array) -> tuple[Array, Array, Mapping[str, Array]]:
            known = {name: state[name] for name in self.law.right.names if name in state}
            changes = np.sum(values.reshape(n, len(own_names), width) * inside[:, None], axis=2)
            moved = {name: known[name] + change for name, change in zip(own_names, changes.T, strict=True)}
            before, slopes_before = function(known)
            after, slopes_after = (
                np.broadcast_to(one, (n, *one.shape[1:])) for one in function(known | moved)
            )
            own = (slopes_after[:, : len(own_names), None] * inside[:, None]).reshape(n, -1)
            return after - before, own, dict(zip(by, (slopes_after - slopes_before).T, strict=True))

        return effect

    def changes(self, law: object, rows: Rows, values: Array, trials: Array) -> Array:
        """See `Cause`: by the derivatives without effect, since trials are small and many."""
        slopes = self.law.jacobian(rows, values[:, : len(self.law.parameters)])
        own = (slopes[:, :, None] * self.indicators(rows)[:, None]).reshape(len(values), -1)
        return np.asarray(own @ trials.T)


def level_causes(
    columns: Sequence[str], rows: pd.DataFrame, law: TableLaw, y: Array, unit: str, size: float
) -> list[LevelDependence]:
    """A cause for each column of texts; `size` as of a `GenericCause`."""
    if not columns:
        return []
    slopes = law.jacobian(rows, np.tile(law.start_values(rows, y), (len(rows), 1)))
    rms = tuple(np.sqrt(np.mean(np.nan_to_num(slopes) ** 2, axis=0)).tolist())
    return [
        LevelDependence(
            unit=unit, size=size, column=name, levels=find_levels(rows[name]), law=law, slopes=rms
        )
        for name in columns
    ]
