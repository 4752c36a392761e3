"""Parameters of causes and their sizes; the quantities of a traverse; candidate times of sudden changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    capitalize_first,
    choose_time_unit,
    format_direction,
    format_estimate,
    format_measured,
    format_number,
    join_words,
)
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws import Parameter, Rows, State, float_column
from stickslip_fit.logs.history import DEPARTURES, FURTHER_HISTORY
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX
from stickslip_fit.units import Interval, TableUnit

Row = Mapping[str, Any]
"""Quantities of each traverse by name, arrays of shape (n,)."""


@dataclass(frozen=True)
class CauseParameter(Parameter):
    """A parameter of a cause: one number for the whole campaign, or for one joint, direction or session.

    Attributes
    ----------
    joint : int or None
    direction, session : str or None
    sudden : bool
        The response jumps as it changes, so that it is chosen among trials, not by derivatives.
    prior_sd : float
        Standard deviation of its normal prior about zero, SI: of a coefficient of a smooth function, which is
        fitted with a penalty. Infinite for any other.
    """

    joint: int | None = None
    direction: str | None = None
    session: str | None = None
    sudden: bool = False
    prior_sd: float = np.inf

    def of_cause(self, cause: str) -> CauseParameter:
        """The same by its full name, such as ``load-nonlinearity.k[3+]``."""
        scope = f"{self.joint or ''}{self.direction or ''}{self.session or ''}"
        return replace(self, name=f"{cause}.{self.name}{f'[{scope}]' if scope else ''}")

    @property
    def title(self) -> str:
        """The full name as people read it.

        Examples
        --------
        >>> CauseParameter("c7", "%", "a coefficient", joint=1, session="Monday").of_cause("smooth").title
        'smooth.c7 (joint 1, Monday)'
        """
        joint = "" if self.joint is None else f"joint {self.joint}"
        scope = [text for text in (joint, format_direction(self.direction), self.session) if text]
        return f"{self.name.rpartition('[')[0]} ({', '.join(scope)})" if scope else self.name


@dataclass(frozen=True)
class SizedParameter:
    """A parameter of a cause that acts in a log, SI with the unit for display, with its interval of 95 %.

    In ``sentence.format(k=...)`` ``{k}`` is its size with its unit, ``{k:+}`` the same with its sign,
    ``{k:.2f}`` the bare number, and of ``{k:grow|shrink}`` the first word if it is above 0, else the second.
    """

    name: str
    unit: str
    size: Interval
    joint: int | None = None
    direction: str | None = None
    session: str | None = None

    def times(self, factor: float, unit: str = "") -> SizedParameter:
        """The parameter times a factor, displayed in another unit if one is given."""
        return replace(self, size=self.size.times(factor), unit=unit or self.unit)

    def plus(self, share: float) -> SizedParameter:
        """The parameter and a share of its estimate, with the error that it has."""
        more = share * self.size.estimate
        return replace(self, size=Interval(*(end + more for end in astuple(self.size))))

    def __format__(self, form: str) -> str:
        positive, bar, negative = form.partition("|")
        if bar:
            return positive if self.size.estimate > 0 else negative
        if form.endswith("f"):
            return format_number(self.size.estimate, self.unit, int(form[1:-1]))
        if isinstance(self.unit, TableUnit):
            sign = 1.0 if form == "+" or self.size.estimate >= 0 else -1.0
            return format_measured(self.size.times(sign), self.unit)
        return format_estimate(self.size, self.unit, signed=form == "+")


def show_time(parameters: Sequence[SizedParameter], name: str, unit: str) -> tuple[SizedParameter, ...]:
    """Parameters of which one is a time; it is put into the unit in which it is read most easily."""
    shown = list(parameters)
    for place, one in enumerate(parameters):
        if one.name == name:
            readable, size = choose_time_unit(one.size.estimate, unit)
            shown[place] = one.times(1.0 / size, TableUnit(readable))
    return tuple(shown)


@dataclass(frozen=True)
class SizesApart:
    """A parameter that each direction or joint has for itself; it is formatted like one, one by one.

    Where some are above 0 and others below, they have signs, and what would grow or shrink changes.
    """

    sizes: tuple[SizedParameter, ...]

    @property
    def size(self) -> Interval:
        """Of the first."""
        return self.sizes[0].size

    def times(self, factor: float, unit: str = "") -> SizesApart:
        """Each size times a factor, displayed in another unit if one is given."""
        return SizesApart(tuple(one.times(factor, unit) for one in self.sizes))

    def plus(self, share: float) -> SizesApart:
        """Each with a share of its estimate, see `SizedParameter.plus`."""
        return SizesApart(tuple(one.plus(share) for one in self.sizes))

    def __format__(self, form: str) -> str:
        differ = len({one.size.estimate > 0 for one in self.sizes}) > 1
        if form == "grow|shrink" and differ:
            return "change"
        texts = [f"{one:{form or '+' * differ}}" for one in self.sizes]
        if "|" in form and len(set(texts)) == 1:
            return texts[0]
        where = [
            format_direction(one.direction) if one.direction else f"joint {one.joint}" for one in self.sizes
        ]
        return join_words([f"{text} ({own})" for text, own in zip(texts, where, strict=True)])


Sizes = Mapping[str, SizedParameter | SizesApart]
"""Parameters of a cause by name."""


def number_repeated(names: Iterable[str]) -> list[str]:
    """Names, those that came before with their number.

    Examples
    --------
    >>> number_repeated(["drift", "smooth-term", "smooth-term"])
    ['drift', 'smooth-term', 'smooth-term-2']
    """
    count = Counter[str]()
    numbered = []
    for name in names:
        count[name] += 1
        numbered.append(name if count[name] == 1 else f"{name}-{count[name]}")
    return numbered


def name_parameters(causes: Sequence[Any]) -> tuple[CauseParameter, ...]:
    """The parameters of causes, one cause after the other, by their full names."""
    named = zip(causes, number_repeated(one.name for one in causes), strict=True)
    return tuple(parameter.of_cause(name) for cause, name in named for parameter in cause.parameters)


def parameter_titles(parameters: Iterable[Parameter]) -> dict[str, str]:
    """How people read each parameter's full name."""
    return {one.name: one.title if isinstance(one, CauseParameter) else one.name for one in parameters}


def sizes_by_name(parameters: Sequence[SizedParameter]) -> dict[str, SizedParameter | SizesApart]:
    """Parameters by name, those of the directions or joints together."""
    groups: dict[str, list[SizedParameter]] = {}
    for parameter in parameters:
        groups.setdefault(parameter.name, []).append(parameter)
    return {name: own[0] if len(own) == 1 else SizesApart(tuple(own)) for name, own in groups.items()}


def plain_description(phrase: str, parameters: Sequence[SizedParameter]) -> str:
    """A cause by its phrase, with the sizes of its parameters.

    Examples
    --------
    >>> plain_description("the moon shines", [SizedParameter("k", "%", Interval(0.02, 0.01, 0.03))])
    'The moon shines (k = 2 %)'
    """
    sizes = ", ".join(f"{parameter.name} = {parameter:+}" for parameter in parameters)
    return capitalize_first(phrase) + (f" ({sizes})" if sizes else "")


def missing_column(rows: pd.DataFrame, name: str) -> str | None:
    """Why a column cannot explain anything, or None: it is empty, or the same within every session."""
    label = CONDITIONS[name].label if name in CONDITIONS else f"column {name.removeprefix(COVARIATE_PREFIX)}"
    values = pd.to_numeric(rows[name], errors="coerce") if name in rows else pd.Series(dtype=float)
    if not values.notna().any():
        return f"the log has no {label}"
    by_session = values.groupby(rows["session"])
    if not (by_session.max() > by_session.min()).any():
        return f"{label} is the same within every session, and each session is calibrated by itself"
    return None


def fill_empty(values: Array, mean: float) -> Array:
    """Values with the mean in empty cells, which so have no effect."""
    return np.where(np.isnan(values), mean, values)


# A joint's first traverse of a session follows none.
FIRST_TRAVERSE = {
    "before_direction": "",
    "before_load": 0.0,
    **dict.fromkeys(FURTHER_HISTORY, np.nan),
    **dict.fromkeys(DEPARTURES, 0.0),
}
REQUIRED_HISTORY = {
    "session": "the session's name",
    "session_seconds": "the time since the session's first traverse, s",
    "steps_before": "the steps that the joint has made so far",
}


def collect_row_values(rows: Rows, columns: Iterable[str]) -> dict[str, Any]:
    """Start, stop and the given columns of each traverse, as arrays of shape (n,).

    A column that is absent has the values of a session's first traverse under mean conditions (as an empty
    cell has). The time since the session began and the steps made so far have no such value.

    Raises
    ------
    InputError
        For an absent column that has no such value.

    Examples
    --------
    >>> collect_row_values({"start": [0.0], "stop": [0.012]}, ["temperature"])["temperature"]
    array([nan])
    """
    columns = tuple(columns)
    absent = [name for name in columns if name in REQUIRED_HISTORY and name not in rows]
    if absent:
        raise InputError(
            [InputIssue(f"the law needs {REQUIRED_HISTORY[name]}: give it", column=name) for name in absent]
        )
    values: dict[str, Any] = {"start": float_column(rows, "start"), "stop": float_column(rows, "stop")}
    for name in columns:
        default = np.full(len(values["start"]), FIRST_TRAVERSE.get(name, np.nan))
        values[name] = np.asarray(rows[name]) if name in rows else default
    return values


# Numbers of candidate times: a change between two of them shows nearly as well.
MAX_PER_SESSION, MIN_PER_SESSION, PER_LOG = 120, 6, 700
MIN_TRAVERSES = 3  # before and after a change


def candidate_moments(rows: pd.DataFrame) -> list[tuple[str, Array]]:
    """Times halfway between traverses, s since the first, of each session that has enough traverses."""
    times, target_spacing = [], len(rows) / PER_LOG
    number, names = pd.factorize(rows["session"].astype(object))
    every = rows["session_seconds"].to_numpy(float)
    for own, session in enumerate(names):
        seconds = np.unique(every[number == own])
        between = ((seconds[1:] + seconds[:-1]) / 2)[MIN_TRAVERSES - 1 : 1 - MIN_TRAVERSES]
        if len(between):
            spacing = min(target_spacing, len(between) / MIN_PER_SESSION)
            spacing = max(len(between) / MAX_PER_SESSION, spacing)
            times.append((str(session), between[:: int(np.ceil(spacing))]))
    return times


def moments_about(rows: pd.DataFrame, session: str, moment: float) -> Array:
    """All times halfway between traverses of a session that are as near as the next candidates."""
    subset = rows[rows["session"].astype(object) == session]
    candidates = dict(candidate_moments(rows)).get(session, np.empty(0))
    seconds = np.unique(subset["session_seconds"].to_numpy(float))
    between = ((seconds[1:] + seconds[:-1]) / 2)[MIN_TRAVERSES - 1 : 1 - MIN_TRAVERSES]
    spacing = int(np.ceil(len(between) / max(len(candidates), 1)))
    place = int(np.searchsorted(between, moment))
    return between[max(place - spacing, 0) : place + spacing + 1]


def moment_parameter(session: str) -> CauseParameter:
    """The parameter for the time of a lasting change in a session."""
    meaning = "when, from the session's first traverse"
    return CauseParameter("moment", "min", meaning, lower=0.0, session=session, sudden=True)


def is_since(state: State, session: str, moment: Array) -> BoolArray:
    """Whether each traverse belongs to a session and begins at a moment or later, shape (n, 1)."""
    subset = np.asarray(state.row["session"], dtype=object) == session
    return subset[:, None] & (state.column("session_seconds") >= moment)


def changes_since(
    changes: Callable[[dict[str, Any], Array, Array], Array],
    row: dict[str, Any],
    values: Array,
    session: str,
    trials: Array,
) -> Array:
    """Changes by trials (size, moment), (m, 2) -> (n, m): those of the whole session, from the moment on.

    `changes` is `Cause.changes` of a cause that changes a traverse entirely or not at all; `row` has arrays
    of shape (n,), `values` shape (n, p).
    """
    result = np.zeros((len(values), len(trials)))
    subset = np.flatnonzero(np.asarray(row["session"], dtype=object) == session)
    sizes, which = np.unique(trials[:, 0], return_inverse=True)
    always = np.column_stack([sizes, np.full(len(sizes), -np.inf)])
    session_row = {name: column[subset] for name, column in row.items()}
    after = session_row["session_seconds"][:, None] >= trials[:, 1]
    result[subset] = changes(session_row, values[subset], always)[:, which] * after
    return result
