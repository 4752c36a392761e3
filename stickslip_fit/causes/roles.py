"""TableRoles: which columns of a table are its session, time, position, direction, group and sigma.

`prepare_rows` checks what the roles and a law need of a table, and returns its rows as causes see them: in
order of time within each session, with the columns ``session`` (text), ``session_seconds`` (time since the
session's first row; NaN where the order of the rows means nothing), and `ROW_NUMBER`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.late_columns import find_late, with_late_columns
from stickslip_fit.causes.times import AMBIGUOUS, read_times
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.laws.table import mistyped_column

ROLES = ("session", "time", "position", "direction", "group", "sigma")
ORDER = "order"
ONE_SESSION = "all"  # label of the rows of a table without sessions
# Values of a direction, in lower case.
BACKWARD = (
    *("-", "minus", "neg", "negative", "backward", "backwards", "back", "bwd", "rev", "reverse"),
    *("down", "left", "false", "return", "falling", "decreasing", "unloading", "ccw"),
)
ROW_NUMBER = "stickslip-fit: row"  # column of each row's place in the table, from 0
MAX_LISTED = 3  # faulty cells of a column, and columns of a table
OWN_COLUMNS = {
    "session": "the session of each row",
    "session_seconds": "the time since the session's first row",
    "joint": "the joint of each row",
}


@dataclass(frozen=True)
class TableRoles:
    """Columns by what they mean; None where a table has no such column.

    Attributes
    ----------
    session : str or None
        Rows with equal values share the law's own parameters; without it all rows do.
    time : str or None
        Numbers, or times of day. ``"order"``, where no column has that name: rows stand in the order in
        which they were measured. None: their order means nothing.
    position : str or None
        Of what moves.
    direction : str or None
        Two values, see `direction_labels`, or numbers whose signs count.
    group : str or None
        What belongs together: replicates of one condition, one specimen.
    sigma : str or None
        Uncertainty of the response, above 0.
    time_unit : str
        Of ``session_seconds``: a time column's own, s for times of day, ``"rows"`` where their order is all.
    """

    session: str | None = None
    time: str | None = None
    position: str | None = None
    direction: str | None = None
    group: str | None = None
    sigma: str | None = None
    time_unit: str = "s"

    def __post_init__(self) -> None:
        if self.time == ORDER:
            object.__setattr__(self, "time_unit", "rows")

    @property
    def number_columns(self) -> tuple[str, ...]:
        """The columns of roles that have to be of numbers."""
        return tuple(filter(None, [self.position, self.sigma]))

    @property
    def columns(self) -> dict[str, str]:
        """The column of each role that is given."""
        named = {role: getattr(self, role) for role in ROLES}
        return {role: name for role, name in named.items() if name is not None}


def prepare_rows(frame: pd.DataFrame, roles: TableRoles, numbers: Iterable[str] = ()) -> pd.DataFrame:
    """The rows of a table as laws and causes see them; `numbers` are the columns that have to be numbers.

    Those of them that are other columns late (`late_columns`) are made where there is a time.

    Raises
    ------
    InputError
        With every fault: no rows, columns of one name, unknown columns with what is similar, cells that are
        no finite numbers, a direction with more than two values.
    """
    if not isinstance(frame, pd.DataFrame):
        raise InputError(f"a table is a DataFrame or the path of a file, not {type(frame).__name__}")
    names = [str(name) for name in frame.columns]
    late = find_late(numbers, names, roles.time_unit) if roles.time else {}
    numbers = tuple(dict.fromkeys(late[name][0] if name in late else name for name in numbers))
    for role, name in roles.columns.items():
        if not isinstance(name, str):
            raise InputError(f"{role} names a column of the table, so it is text, not {name!r}")
    repeated = sorted({name for name in names if names.count(name) > 1})
    issues = [InputIssue("stands more than once in the table; rename one", column=name) for name in repeated]
    if not len(frame):
        issues.append(InputIssue("the table has no rows"))
    if issues:
        raise InputError(issues)
    frame = frame.set_axis(names, axis=1)
    places = frame[ROW_NUMBER] if ROW_NUMBER in names else np.arange(len(frame))
    frame = frame.set_axis(pd.Index(places), axis=0)
    wanted = {name: role for role, name in roles.columns.items() if (role, name) != ("time", ORDER)}
    missing = {name: role for name, role in wanted.items() if name not in names}
    issues += [_explain_unknown(name, f"is named as the {role}", names) for name, role in missing.items()]
    issues += [_explain_unknown(name, "is in the law", names) for name in numbers if name not in names]
    issues += [
        InputIssue(
            f"the law uses a column of this name, which stands for {OWN_COLUMNS[name]} here; rename it",
            column=name,
        )
        for name in numbers
        if name in OWN_COLUMNS and name in names and name != roles.session
    ]
    if issues:
        raise InputError(issues)
    cells = dict.fromkeys([*numbers, *roles.number_columns])
    issues += [issue for name in cells for issue in find_bad_numbers(frame[name])]
    if roles.sigma and not issues:
        bad = pd.to_numeric(frame[roles.sigma]).to_numpy(float) <= 0
        issues += _list_cells(frame[roles.sigma], bad, "is no uncertainty, which is above 0; correct it")
    for name in filter(None, dict.fromkeys([roles.session, roles.group, roles.direction])):
        empty = frame[name].isna().to_numpy()
        issues += _list_cells(frame[name], empty, "is empty; fill it in, or leave out its row")
    if roles.direction and not issues:
        issues += _check_direction(frame[roles.direction])
    seconds, time_issues = _read_time(frame, roles)
    if issues or time_issues:
        raise InputError([*issues, *time_issues])
    session = _label_sessions(frame[roles.session]) if roles.session else pd.Series(ONE_SESSION, frame.index)
    order = np.lexsort((np.arange(len(frame)), seconds, pd.factorize(session)[0]))
    own = {"session": session.astype(object), "session_seconds": seconds, "joint": 1}
    # A copy is one block; to a table of a hundred columns in pieces pandas adds none without a warning.
    rows = frame.copy().assign(**own, **{ROW_NUMBER: frame.index})
    rows = rows.iloc[order].reset_index(drop=True)
    if roles.time == ORDER:
        rows["session_seconds"] = _count_rows(rows)
    elif roles.time:
        first = rows.groupby("session", sort=False)["session_seconds"].transform("first")
        rows["session_seconds"] -= first
    else:
        rows["session_seconds"] = np.nan
    return with_late_columns(rows, late)


def _label_sessions(cells: pd.Series[Any]) -> pd.Series[Any]:
    """Sessions as text; whole numbers are written as such, also beside cells that were empty."""
    if cells.dtype.kind == "f" and (cells % 1 == 0).all():
        cells = cells.astype(int)
    return cells.astype(str)


def _count_rows(rows: pd.DataFrame) -> pd.Series[Any]:
    """The place of each row in its session; where sessions do not interleave, rows left out count, too."""
    sessions = rows.groupby("session", sort=False)[ROW_NUMBER]
    spans = sessions.agg(["min", "max"]).sort_values("min")
    if (spans["max"].to_numpy()[:-1] < spans["min"].to_numpy()[1:]).all():
        return (rows[ROW_NUMBER] - sessions.transform("first")).astype(float)
    return sessions.cumcount().astype(float)


def _explain_unknown(name: str, where: str, names: list[str]) -> InputIssue:
    similar = mistyped_column(name, names) or next(iter(get_close_matches(name, names, 1, 0.5)), "")
    hint = f"did you mean {shorten(similar)}? " if similar else ""
    names = [name for name in names if name != ROW_NUMBER]
    shown = ", ".join(map(shorten, names[:40])) + (" ..." if len(names) > 40 else "")
    return InputIssue(
        f"{where}, and the table has no such column; {hint}its columns are {shown}", column=name
    )


def find_bad_numbers(cells: pd.Series[Any]) -> list[InputIssue]:
    """Cells of a column that are no finite numbers, the first of them with their rows, counted from 1.

    A column without any number is told once.
    """
    if pd.api.types.is_bool_dtype(cells) or pd.api.types.is_numeric_dtype(cells):
        numbers = cells.to_numpy(dtype=float, na_value=np.nan)
    else:
        numbers = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float, na_value=np.nan)
        if len(cells) > 1 and np.isnan(numbers).all():
            message = "is a column of texts, and used as one of numbers; use another column"
            return [InputIssue(message, column=str(cells.name), value=str(cells.iloc[0]))]
    return _list_cells(cells, ~np.isfinite(numbers), "is no finite number; correct it, or leave out its row")


def _list_cells(cells: pd.Series[Any], bad: BoolArray, message: str) -> list[InputIssue]:
    places = np.flatnonzero(bad)
    issues = [
        InputIssue(
            message,
            line=int(cells.index[place]) + 1,
            place=f"row {cells.index[place] + 1}",
            column=str(cells.name),
            value=str(cells.iloc[place]),
        )
        for place in places[:MAX_LISTED].tolist()
    ]
    if len(places) > MAX_LISTED:
        more = (
            f"{len(places) - MAX_LISTED:,} more cells of it {message.split(';')[0].replace('is ', 'are ', 1)}"
        )
        issues.append(InputIssue(more, column=str(cells.name)))
    return issues


def _check_direction(cells: pd.Series[Any]) -> list[InputIssue]:
    values = list(map(str, pd.unique(cells)))
    if pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells):
        if issues := find_bad_numbers(cells):
            return issues
        if cells.min() < 0 < cells.max():
            return []
    if len(values) <= 2:
        return []
    shown = ", ".join(map(shorten, values[: MAX_LISTED + 1]))
    message = (
        "a direction has two values, or is a number that is above 0 one way and below 0 the other; this "
        f"column has {shown}"
    )
    return [InputIssue(message + (" ..." if len(values) > MAX_LISTED + 1 else ""), column=str(cells.name))]


def _read_time(frame: pd.DataFrame, roles: TableRoles) -> tuple[Array, list[InputIssue]]:
    """Times in seconds, shape (n,); the order of the rows where no column has them."""
    if roles.time is None or roles.time == ORDER:
        return np.arange(len(frame), dtype=float), []
    times = read_times(frame[roles.time])
    if times.fault == AMBIGUOUS and times.bad.all():
        return times.seconds, [InputIssue(AMBIGUOUS, column=roles.time, value=str(frame[roles.time].iloc[0]))]
    if pd.api.types.is_numeric_dtype(frame[roles.time]):
        return times.seconds, find_bad_numbers(frame[roles.time])
    first = min(times.seconds[~times.bad], default=0.0)
    return times.seconds - first, _list_cells(frame[roles.time], times.bad, times.fault)


def direction_sign(rows: Mapping[str, Any], column: str, labels: tuple[str, ...]) -> Array:
    """1 or -1 for each row (0 for a number 0), shape (n,).

    `labels` are the two values of a column, the backward one first; empty for numbers whose signs count.

    Examples
    --------
    >>> direction_sign({"way": ["up", "down"]}, "way", ("down", "up"))
    array([ 1., -1.])
    """
    values = np.asarray(rows[column])
    if not labels:
        return np.asarray(np.sign(values.astype(float)))
    forward = values == float(labels[-1]) if values.dtype.kind in "iuf" else values.astype(str) == labels[-1]
    return np.where(forward, 1.0, -1.0)


def direction_labels(cells: pd.Series[Any]) -> tuple[str, ...]:
    """The two values of a direction, the backward one first; empty for more values, whose signs count.

    Of two numbers the larger is forward, of two words the first that appears, unless that means backward.

    Examples
    --------
    >>> direction_labels(pd.Series(["+", "-", "+"])), direction_labels(pd.Series([0, 1, 1]))
    (('-', '+'), ('0', '1'))
    >>> direction_labels(pd.Series([-0.2, 0.1, 0.3]))
    ()
    """
    values = pd.unique(cells.dropna())
    if pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells):
        return tuple(f"{value:.15g}" for value in sorted(map(float, values))) if len(values) == 2 else ()
    words = list(map(str, values))
    return tuple(sorted(words[::-1], key=lambda word: word.lower() not in BACKWARD))
