"""Causes of a column of labels, such as a specimen, an operator or a lot: what differs between its values.

Either the response is higher at some of them by a constant, or the law's own parameters are not the same:
the analysis of covariance (R. A. Fisher, Statistical Methods for Research Workers, 1932), for any law.

Labels are texts, or few integers, which may as well be a quantity: both are tried. The offsets of
`MIN_POOLED` labels or more have a normal prior of common size, so that many of them cost no more than they
tell; the size of fewer can hardly be known (A. Gelman and J. Hill, Data Analysis Using Regression and
Multilevel/Hierarchical Models, 2007, section 12.9). So have other parameters of three labels or more, which
are many and hardly ever known one by one.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd

from stickslip_fit._format import format_measured, format_significant, join_words
from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.generic import (
    AddedTerm,
    ColumnDependence,
    CovariateCause,
    Term,
    linear_term,
)
from stickslip_fit.causes.parameters import CauseParameter, SizedParameter, Sizes
from stickslip_fit.causes.table_cause import Effect
from stickslip_fit.causes.zeros import is_left
from stickslip_fit.errors import InputIssue, shorten
from stickslip_fit.laws import Parameter, Rows, TableLaw
from stickslip_fit.units import Z_95, Interval, TableUnit

MIN_POOLED = 5  # labels whose effects have a common prior
MAX_LEVELS, MIN_ROWS_PER_LEVEL = 12, 3  # of a column of integers; rows, on average
MAX_OWN_PARAMETERS = 120  # of all labels together, where each has other parameters
MAX_POOLED, MIN_ROWS_PER_POOLED = 60, 2  # of a column of texts
MAX_CELLS = 150_000  # rows times labels of a column of more than `MAX_LEVELS` texts, which take half a minute
MAX_NAMED = 12  # labels in a message


def name_levels(cells: Any) -> Array:
    """The label in each cell, shape (n,); of a number without decimals that are 0.

    Examples
    --------
    >>> name_levels(np.array([1.0, 2.0])).tolist(), name_levels(["old", "new"]).tolist()
    (['1', '2'], ['old', 'new'])
    """
    values = np.asarray(cells)
    if values.dtype.kind == "f":
        values = np.array([int(one) if float(one).is_integer() else one for one in values], dtype=object)
    return values.astype(object).astype(str)


def _is_number(label: str) -> bool:
    try:
        return bool(np.isfinite(float(label)))
    except ValueError:
        return False


def find_levels(cells: pd.Series) -> tuple[str, ...]:
    """The labels of a column in their order of appearance.

    Examples
    --------
    >>> find_levels(pd.Series(["old", "new", "old"]))
    ('old', 'new')
    """
    return tuple(map(str, pd.unique(name_levels(cells))))


def explain_unusable_levels(cells: pd.Series) -> str | None:
    """Why a column of texts can say nothing of the response, None where it can."""
    if cells.isna().any():
        return f"{int(cells.isna().sum()):,} of its cells are empty"
    number = len(find_levels(cells))
    if number < 2:
        return "it is the same in every row"
    if number > MAX_POOLED or number * MIN_ROWS_PER_POOLED > len(cells):
        return f"it has {number:,} different texts in {len(cells):,} rows"
    if number > MAX_LEVELS and number * len(cells) > MAX_CELLS:
        return f"it has {number:,} different texts in {len(cells):,} rows, and so many take too long"
    return None


def may_be_labels(cells: pd.Series) -> bool:
    """Whether a column of finite numbers may be one of labels: few integers, each in several rows."""
    number = cells.nunique()
    few = number <= MAX_LEVELS and number * MIN_ROWS_PER_LEVEL <= len(cells)
    return bool(few and np.all(np.asarray(cells, float) % 1 == 0))


@dataclass(frozen=True, kw_only=True)
class LevelCause(CovariateCause):
    """Something differs between the values of a column of labels.

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
    adds_to_simpler: ClassVar[bool] = False  # whether a version with fewer parameters does nearly the same

    @property
    def texts(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.column,)

    @property
    def remedy(self) -> str:  # type: ignore[override]
        return f"calibrating {self._at_each}"

    @property
    def _at_each(self) -> str:
        """The levels in words: numbers are values of a quantity, or of what has numbers for names."""
        are_numbers = all(map(_is_number, self.levels))
        return f"at each value of {self.column}" if are_numbers else f"for each {self.column}"

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        others = join_words(list(self.levels[1:]), "or")
        own = {"d": sizes["d"]} if "d" in sizes else {}
        return {
            **own,
            "column": self.column,
            "at_each": self._at_each,
            "first": self.levels[0],
            "others": others,
        }

    def find_unknown(self, frame: pd.DataFrame) -> list[InputIssue]:
        """What keeps rows from being predicted: no such column, or a value of it that was never fitted."""
        if self.column not in frame:
            return [InputIssue("the table has no such column, and the law needs it", column=self.column)]
        cells = pd.Series(name_levels(frame[self.column]))
        unknown = cells[~cells.isin(self.levels)].drop_duplicates()
        known = ", ".join(map(shorten, self.levels[:MAX_NAMED])) + " ..." * (len(self.levels) > MAX_NAMED)
        return [
            InputIssue(f"row {row + 1}: the law was fitted to {known} only", column=self.column, value=value)
            for row, value in unknown.items()
        ]

    @property
    def named(self) -> tuple[str, ...]:
        """The levels with values of their own."""
        return self.levels[1:]

    @property
    def beside(self) -> str:
        """What the others are compared with."""
        return self.levels[0]

    @property
    def prior_sds(self) -> tuple[float, ...]:
        """Of each parameter."""
        return (np.inf,) * len(self.scale)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `GenericCause`: each level by itself, the first one by all others, so that none is special."""
        scale = np.array(self.scale).reshape(-1, len(self.named))
        others = np.kron(np.diag(scale[:, 0]), np.full(len(self.named), -1.0))
        return [(self, np.concatenate([np.diag(scale.ravel()), others]))]

    def indicators(self, rows: Rows) -> Array:
        """1 in the rows of each level with values of its own, shape (n, number of them).

        A level that was not fitted, as of rows that were held out, is expected to be as the mean of all.
        """
        cells = name_levels(rows[self.column])
        known = np.isin(cells, self.levels)[:, None]
        return np.where(known, cells[:, None] == np.array(self.named), self._unknown)

    @property
    def _unknown(self) -> float:
        return 1.0 / len(self.levels)


@dataclass(frozen=True, kw_only=True)
class PooledLevels(LevelCause):
    """What differs between levels has a normal prior about zero, of one size for all of them.

    Attributes
    ----------
    amplitude : float
        The prior's standard deviation, in units of `scale`.
    """

    amplitude: float = 1.0

    beside = "the mean of all"
    _unknown = 0.0

    @property
    def named(self) -> tuple[str, ...]:
        """See `LevelCause`: all of them."""
        return self.levels

    @property
    def prior_sds(self) -> tuple[float, ...]:
        """See `LevelCause`; what has no effect at all has no prior."""
        return tuple(self.amplitude * one if one > 0 else np.inf for one in self.scale)

    def with_amplitude(self, amplitude: float) -> Self:
        """The same with another size of the prior."""
        return replace(self, amplitude=float(amplitude))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `GenericCause`: each level by itself."""
        return [(self, np.diag(self.scale))]

    def summarize(self, values: Array, covariance: Array) -> tuple[SizedParameter, ...]:
        """Each parameter beside the mean of the labels, by the values (q,) and their covariance (q, q).

        Beside the mean of all labels that there might be they are known less well than among themselves.
        """
        number = len(self.levels)
        centre = np.kron(np.eye(len(values) // number), np.eye(number) - 1.0 / number)
        beside, error = centre @ values, np.sqrt(np.maximum(np.diag(centre @ covariance @ centre), 0.0))
        return tuple(
            SizedParameter(one.name, one.unit, Interval(value, value - Z_95 * sd, value + Z_95 * sd))
            for one, value, sd in zip(self.parameters, beside, error, strict=True)
        )


@dataclass(frozen=True, kw_only=True)
class LevelDependence(LevelCause, AddedTerm):
    """Each value of a column of labels has an offset of its own."""

    @property
    def sentence(self) -> str:  # type: ignore[override]
        if len(self.levels) == 2:
            return (
                "The response is {d:higher|lower} by {d} where {column} is {others} than where it is {first}"
            )
        return (
            "The response is not the same {at_each}: about {apart} apart from {lowest}, where it is "
            "lowest, to {highest}"
        )

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `GenericCause`: of more than two levels the extremes."""
        if len(self.levels) == 2:
            return super().quantities(sizes)
        own = {level: sizes[f"d[{level}]"].size.estimate for level in self.named}
        own = dict.fromkeys(self.levels, 0.0) | own
        lowest, highest = min(own, key=own.__getitem__), max(own, key=own.__getitem__)
        apart = f"{format_significant(own[highest] - own[lowest])} {self.unit}".rstrip()
        return {"at_each": self._at_each, "lowest": lowest, "highest": highest, "apart": apart}

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (self.size,) * len(self.named)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        unit = TableUnit(self.unit)
        names = ["d"] if len(self.levels) == 2 else [f"d[{level}]" for level in self.named]
        return tuple(
            CauseParameter(name, unit, f"offset of {self.column} {level} beside {self.beside}", prior_sd=sd)
            for name, level, sd in zip(names, self.named, self.prior_sds, strict=True)
        )

    def term(self, rows: Rows) -> Term:
        return linear_term(self.indicators(rows))


@dataclass(frozen=True, kw_only=True)
class ParametersByLevel(LevelCause):
    """The law's parameters are not the same at all values of a column of labels.

    Attributes
    ----------
    subset : tuple of str
        Names of those that may not be the same; without, all of them.
    """

    subset: tuple[str, ...] = ()

    sentence = "The law has other parameters where {column} is {others}, not {first}{how}"
    adds_to_simpler: ClassVar[bool] = True  # to offsets

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `GenericCause`: parameter by parameter."""
        return tuple(
            CauseParameter(
                own.name if len(self.levels) == 2 else f"{own.name}[{level}]",
                own.unit,
                f"change of {own.name} at {self.column} {level} beside {self.beside}",
                prior_sd=sd,
            )
            for (own, level), sd in zip(self.each, self.prior_sds, strict=True)
        )

    @property
    def each(self) -> list[tuple[Parameter, str]]:
        """The law's parameter and the level of each of its own."""
        return [(self.law.parameters[one], level) for one in self._places for level in self.named]

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `GenericCause`: as large an effect on the response by each parameter."""
        slopes = [self.slopes[one] for one in self._places]
        each = [self.size / slope if slope > 0 else 0.0 for slope in slopes]
        return tuple(np.repeat(each, len(self.named)).tolist())

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        changes = [
            f"{name} by {format_measured(one.size, one.unit)}"
            for name, one in sizes.items()
            if isinstance(one, SizedParameter)
        ]
        how = f": {join_words(changes)}" if len(self.levels) == 2 and changes else ""
        return {**super().quantities({}), "how": how}

    def effect(self, rows: Rows, variable: Collection[str]) -> Effect:
        """See `TableCause`: the law with other parameters less the law."""
        inside, own_names = self.indicators(rows), [self.law.parameter_names[one] for one in self._places]
        by = tuple(dict.fromkeys([*own_names, *(name for name in variable if name in self.law.right.names)]))
        function, n, width = self.law.right.function(by), len(inside), len(self.named)

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
        own = (slopes[:, self._places, None] * self.indicators(rows)[:, None]).reshape(len(values), -1)
        return np.asarray(own @ trials.T)

    @property
    def _places(self) -> list[int]:
        """The places of those parameters among the law's."""
        names = self.law.parameter_names
        return [place for place, name in enumerate(names) if not self.subset or name in self.subset]


@dataclass(frozen=True, kw_only=True)
class PooledOffsets(PooledLevels, LevelDependence):
    """As `LevelDependence`, of many levels."""


@dataclass(frozen=True, kw_only=True)
class PooledParameters(PooledLevels, ParametersByLevel):
    """As `ParametersByLevel`, of many levels."""

    sentence = "The law has other parameters {at_each}"


@dataclass(frozen=True, kw_only=True)
class ParametersBySession(ParametersByLevel):
    """Parameters that all sessions share are not the same in two of them."""

    base_name = "parameters-by-session"
    base_phrase = "the law's parameters differ between sessions"
    physics = (
        "What is mounted, charged or set anew before a session, or a unit that is another one than before."
    )
    shows_best = "the same conditions in every session"
    sentence = "The law has other parameters in session {others} than in {first}{how}"
    remedy = "calibrating each session"
    columns = ("session",)
    texts = ()

    def find_unknown(self, frame: pd.DataFrame) -> list[InputIssue]:
        """See `LevelCause`: none, a new session is as the mean of all."""
        return []


@dataclass(frozen=True, kw_only=True)
class PooledParametersBySession(PooledParameters, ParametersBySession):
    """As `ParametersBySession`, of three sessions or more."""

    sentence = (
        "The law's parameters differ between sessions: {name} is furthest from the mean of all in {session}, "
        "by {change}"
    )

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `GenericCause`: of the parameter that changes the response most where it is furthest off."""
        found = [one for own in self.parameters if isinstance(one := sizes[own.name], SizedParameter)]
        effects = [abs(one.size.estimate) / scale for one, scale in zip(found, self.scale, strict=True)]
        furthest = int(np.argmax(effects))
        (parameter, session), own = self.each[furthest], found[furthest]
        change = format_measured(own.size, own.unit)
        return {**super().quantities(sizes), "name": parameter.name, "session": session, "change": change}


@dataclass(frozen=True, kw_only=True)
class LabelDependence(LevelDependence):
    """The response depends on a column of labels in any of these ways."""

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `GenericCause`: offsets, and other parameters of the law; levels without rows are left out."""
        own = set(name_levels(rows[self.column]))
        levels = tuple(level for level in self.levels if level in own)
        if len(levels) < 2:
            return []
        n = len(levels)
        kinds: list[type[LevelCause]] = [PooledOffsets if n >= MIN_POOLED else LevelDependence]
        same_in_all_rows = set(self.law.right.names) <= set(self.law.parameter_names)  # and so are offsets
        if not same_in_all_rows and _may_have_parameters(n, self.law, rows):
            kinds.append(PooledParameters if n > 2 else ParametersByLevel)
        versions = [kind(**(vars(self) | {"levels": levels})) for kind in kinds]
        return [trial for one in versions for trial in one.trials(rows)]


@dataclass(frozen=True, kw_only=True)
class IntegerDependence(ColumnDependence):
    """The response depends on a column of few integers, which are a quantity or labels.

    Attributes
    ----------
    as_labels : LabelDependence
        What may differ if they are labels.
    """

    as_labels: LabelDependence

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `GenericCause`: a line, a simple curve, and those of labels, as a curve that bends more is."""
        labelled = self.as_labels.trials(rows)
        if len(self.as_labels.levels) == 2:  # the same but for the words
            return labelled
        quantity = ColumnDependence(**{one.name: getattr(self, one.name) for one in fields(ColumnDependence)})
        return [*quantity.trials(rows)[:2], *labelled]

    def with_functions(self, term: Any) -> None:
        """See `Cause.with_functions`: the labels are its most flexible form."""


def session_parameters(
    rows: pd.DataFrame, law: TableLaw, y: Array, unit: str, size: float
) -> list[ParametersBySession]:
    """A cause for the parameters that sessions share, but for those that only add to the response."""
    levels, names = find_levels(rows["session"]), law.parameter_names
    if len(levels) < 2 or not _may_have_parameters(len(levels), law, rows):
        return []
    slopes, ones = np.nan_to_num(law.slopes_at_start(rows, y)), np.ones((len(rows), 1))
    shared = range(len(names) - law.n_shared, len(names))
    subset = tuple(names[one] for one in shared if is_left(slopes[:, one, None], ones))
    kind = PooledParametersBySession if len(levels) > 2 else ParametersBySession
    own = kind(
        unit=unit,
        size=size,
        column="session",
        levels=levels,
        law=law,
        slopes=_rms_by_parameter(slopes),
        subset=subset,
    )
    return [own] if subset else []


def most_labels(law: TableLaw) -> int:
    """How many labels may have other parameters of a law."""
    return MAX_OWN_PARAMETERS // max(len(law.parameter_names), 1)


def _may_have_parameters(n_labels: int, law: TableLaw, rows: Rows) -> bool:
    return n_labels <= most_labels(law) and n_labels * MIN_ROWS_PER_LEVEL <= len(rows)


def _rms_by_parameter(slopes: Array) -> tuple[float, ...]:
    return tuple(np.sqrt(np.mean(slopes**2, axis=0)).tolist())


def level_causes(
    columns: Sequence[str], rows: pd.DataFrame, law: TableLaw, y: Array, unit: str, size: float
) -> list[LabelDependence]:
    """A cause for each column of labels; `size` as of a `GenericCause`."""
    if not columns:
        return []
    rms = _rms_by_parameter(np.nan_to_num(law.slopes_at_start(rows, y)))
    return [
        LabelDependence(
            unit=unit, size=size, column=name, levels=find_levels(rows[name]), law=law, slopes=rms
        )
        for name in columns
    ]
