"""Parameters of causes with their sizes, and the quantities of a traverse that causes refer to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import capitalize_first, format_estimate, format_number
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws import Parameter, Rows, State, float_column
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX
from stickslip_fit.units import Interval

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
        The response jumps as it changes, so that it is chosen among trials; slopes say nothing of it.
    """

    joint: int | None = None
    direction: str | None = None
    session: str | None = None
    sudden: bool = False


@dataclass(frozen=True)
class SizedParameter:
    """A parameter of a cause that acts in a log, SI, with its interval of 95 %.

    In ``sentence.format(k=...)`` ``{k}`` is its size with its unit, ``{k:+}`` the same with its sign,
    ``{k:.2f}`` the bare number, and of ``{k:grow|shrink}`` the first word if it is above 0, else the second.

    Attributes
    ----------
    name, unit : str
        The unit is the one people read it in.
    size : Interval
    joint : int or None
    direction, session : str or None
    """

    name: str
    unit: str
    size: Interval
    joint: int | None = None
    direction: str | None = None
    session: str | None = None

    def times(self, factor: float, unit: str = "") -> SizedParameter:
        """The parameter times a factor, read in another unit if one is given."""
        return replace(self, size=self.size.times(factor), unit=unit or self.unit)

    def __format__(self, form: str) -> str:
        positive, either, other = form.partition("|")
        if either:
            return positive if self.size.estimate > 0 else other
        if form.endswith("f"):
            return format_number(self.size.estimate, self.unit, int(form[1:-1]))
        return format_estimate(self.size, self.unit, signed=form == "+")


Sizes = Mapping[str, SizedParameter]
"""Parameters of a cause by name."""


def plain_description(phrase: str, parameters: Sequence[SizedParameter]) -> str:
    """A cause by its phrase, with the sizes of its parameters.

    Examples
    --------
    >>> plain_description("the moon shines", [SizedParameter("k", "%", Interval(0.02, 0.01, 0.03))])
    'The moon shines (k = 2 %)'
    """
    sizes = ", ".join(f"{each.name} = {each:+}" for each in parameters)
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


def filled(values: Array, mean: float) -> Array:
    """Empty cells count as the mean, and so do nothing."""
    return np.where(np.isnan(values), mean, values)


# A joint's first traverse of a session follows none.
FIRST = {"before_direction": "", "before_load": 0.0}
NEEDED = {
    "session": "the session's name",
    "session_seconds": "the time since the session's first traverse, s",
    "steps_before": "the steps that the joint has made so far",
}


def known_of(rows: Rows, columns: Iterable[str]) -> dict[str, Any]:
    """Start, stop and the given columns of each traverse, as arrays of shape (n,).

    A joint that nothing is said of follows no other traverse, under the log's mean conditions (as an empty
    cell does). How long a session has run and how many steps a joint has made have no such value.

    Raises
    ------
    InputError
        For a column that is not there and has none.

    Examples
    --------
    >>> known_of({"start": [0.0], "stop": [0.012]}, ["temperature"])["temperature"]
    array([nan])
    """
    known: dict[str, Any] = {"start": float_column(rows, "start"), "stop": float_column(rows, "stop")}
    lacking = [name for name in columns if name in NEEDED and name not in rows]
    if lacking:
        raise InputError(
            [InputIssue(f"the law needs {NEEDED[name]}: give it", column=name) for name in lacking]
        )
    for name in columns:
        stands_in = np.full(len(known["start"]), FIRST.get(name, np.nan))
        known[name] = np.asarray(rows[name]) if name in rows else stands_in
    return known


# In a session, in a log, and as many as a session has in any case: between two of them a change is seen
# nearly as well.
MOST, ABOUT, LEAST = 120, 700, 6
FEWEST = 3  # traverses on either side


def moments(rows: pd.DataFrame) -> list[tuple[str, Array]]:
    """Halfway between traverses, for each session that has enough of them; s from its first."""
    found, every = [], len(rows) / ABOUT
    for session, subset in rows.groupby(rows["session"].astype(object), sort=False):
        seconds = np.unique(subset["session_seconds"].to_numpy(float))
        between = ((seconds[1:] + seconds[:-1]) / 2)[FEWEST - 1 : 1 - FEWEST]
        if len(between):
            apart = max(len(between) / MOST, min(every, len(between) / LEAST))
            found.append((str(session), between[:: int(np.ceil(apart))]))
    return found


def moment_of(session: str) -> CauseParameter:
    """The parameter that says when, in a session, something changed for good."""
    meaning = "when, from the session's first traverse"
    return CauseParameter("moment", "min", meaning, lower=0.0, session=session, sudden=True)


def since(state: State, session: str, moment: Array) -> BoolArray:
    """Whether each traverse is one of a session and begins at its moment or later; (n, 1) -> (n, 1)."""
    subset = np.asarray(state.row["session"], dtype=object) == session
    return subset[:, None] & (state.column("session_seconds") >= moment)


def changes_since(
    changes: Callable[[dict[str, Any], Array, Array], Array],
    known: dict[str, Any],
    values: Array,
    session: str,
    trials: Array,
) -> Array:
    """Changes by trials (size, moment): those that a size makes at all times, from its moment on.

    Parameters
    ----------
    changes : callable
        As `Cause.changes`, of a cause that changes a traverse by the whole or not at all.
    known : dict of str to array, shape (n,)
    values : array, shape (n, p)
    session : str
    trials : array, shape (m, 2)

    Returns
    -------
    array, shape (n, m)
    """
    found = np.zeros((len(values), len(trials)))
    subset = np.flatnonzero(np.asarray(known["session"], dtype=object) == session)
    sizes, which = np.unique(trials[:, 0], return_inverse=True)
    at_all_times = np.column_stack([sizes, np.full(len(sizes), -np.inf)])
    there = {name: of[subset] for name, of in known.items()}
    after = there["session_seconds"][:, None] >= trials[:, 1]
    found[subset] = changes(there, values[subset], at_all_times)[:, which] * after
    return found
