"""The rows of a table as its law and the roles of its columns ask for them, and what was taken for what."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import format_significant, join_words
from stickslip_fit._input import format_path
from stickslip_fit.causes.cause_formula import CauseFormula
from stickslip_fit.causes.empty_cells import leave_out_empty
from stickslip_fit.causes.late_columns import parse_late
from stickslip_fit.causes.roles import TableRoles, direction_labels, prepare_rows
from stickslip_fit.causes.times import read_times
from stickslip_fit.diagnosis.finding import TableInfo
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws import Law
from stickslip_fit.laws.table import as_written
from stickslip_fit.logs._numbers import with_numbers
from stickslip_fit.logs.table_file import read_table_file
from stickslip_fit.units import time_unit_of

CALENDAR, YEAR_TOL = (1700.0, 2100.0), 0.02  # years; of a month, which has been rounded
PARAMETER_LETTERS = "abcd"  # names of a formula that look like parameters


def as_law(law: Any) -> Any:
    """A law from a formula, or the law itself."""
    law = Law(law) if isinstance(law, str) else law
    if not hasattr(law, "bind_table"):
        raise InputError(f"a law is a formula or a Law, not {type(law).__name__}")
    return law


def find_columns(law: Any, response: str | None, causes: Iterable[Any]) -> list[str]:
    """Names that may be columns: those of a law and its response, and of causes that are formulas."""
    left = getattr(law, "left", None)
    names = [*getattr(law, "names", ()), *(left.names if left is not None else [response or ""])]
    for cause in causes:
        if isinstance(cause, CauseFormula):
            names += [*cause.effect.names, cause.target]
    return list(dict.fromkeys(filter(None, names)))


@contextmanager
def name_file(frame: pd.DataFrame | str | Path, sheet: str | None) -> Iterator[None]:
    """Where a table is a file, name it in issues of its columns, and a row by its line there."""
    try:
        yield
    except InputError as error:
        if isinstance(frame, pd.DataFrame) or not any(one.column and not one.file for one in error.problems):
            raise
        read, file = read_table_file(frame, sheet), format_path(frame)

        def locate(issue: InputIssue) -> InputIssue:
            if not issue.column or issue.file:
                return issue
            if issue.line is None:
                return replace(issue, file=file)
            line = read.line_of(issue.line - 1)
            return replace(issue, file=file, line=line, place=f"{read.lines_are} {line}")

        raise InputError(map(locate, error.problems)) from None


def read_table(
    frame: pd.DataFrame | str | Path, sheet: str | None = None
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """A table from a DataFrame or a file, with its name, hash and notes as `TableInfo` has them.

    Raises
    ------
    InputError
        If the file cannot be read, is no table, or has no such sheet.
    """
    if isinstance(frame, pd.DataFrame):
        return frame, {"sha256": _hash_frame(frame)}
    if not isinstance(frame, str | Path):
        raise InputError(f"a table is a DataFrame or the path of a file, not {type(frame).__name__}")
    read = read_table_file(frame, sheet)
    source = {"file": format_path(frame), "sha256": read.sha256, "files": (str(frame),)}
    return read.frame, source | ({"notes": (read.note,)} if read.note else {})


def read_rows(
    frame: pd.DataFrame | str | Path,
    sheet: str | None,
    roles: TableRoles,
    used: Sequence[str],
    levels: Sequence[str] = (),
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """As `read_table`, without the rows in which a role or a column is empty.

    Columns in `used` are of numbers, those in `levels` of anything.
    """
    table, source = read_table(frame, sheet)
    names = [str(name) for name in table.columns]
    if len(table) == 0 or len(set(names)) < len(names):
        prepare_rows(table, roles)  # which says what is wrong
    numbers = [*used, *roles.number_columns]
    texts = [roles.session, roles.direction, roles.group, roles.time, *levels]
    table = with_numbers(table.set_axis(names, axis=1), numbers)
    table, notes = leave_out_empty(table, numbers, [name for name in texts if name])
    return table, source | {"notes": (*source.get("notes", ()), *notes)}


def describe_choices(table: pd.DataFrame, roles: TableRoles, law: Any) -> tuple[str, ...]:
    """What was taken for what where another reading is possible, as sentences."""
    notes = []
    labels = direction_labels(table[roles.direction]) if roles.direction in table else ()
    is_number = bool(labels) and table[roles.direction].dtype.kind in "iuf"
    are_signs = float(labels[0]) < 0 < float(labels[-1]) if is_number else labels == ("-", "+")
    if labels and not are_signs:
        notes.append(f"In the column {roles.direction}, {labels[-1]} is + and {labels[0]} is -.")
    if roles.time in table and (note := read_times(table[roles.time]).note):
        notes.append(f"Of the time {roles.time}, {note}.")
    if _is_number(table, roles.time) and not stated_time_unit(law, str(roles.time)):
        counted = "seconds, as neither the column's name nor the law gives a unit"
        if are_parts_of_years(table[roles.time]):
            counted = "years, as they are months or quarters of calendar years"
        notes.append(f"The times in {roles.time} count as {counted}.")
    letters = [name for name in getattr(law, "names", ()) if name in PARAMETER_LETTERS and name in table]
    if letters:
        columns = "is the column of that name" if len(letters) == 1 else "are the columns of these names"
        notes.append(f"{join_words(letters)} of the law {columns}, and no parameter.")
    return tuple(notes)


def describe_weights(problem: DiagnosisProblem, table: TableInfo) -> tuple[str, ...]:
    """By what the rows are weighted, as a sentence; none where all count alike."""
    sd, name = problem.noise_sd, table.roles.get("sigma")
    if name:
        scale = float(np.median(sd / problem.rows[name].to_numpy(float)))
        factor = format_significant(scale, 3)
        return (f"Rows are weighted by 1 / {as_written(name)}^2; the noise is {factor} times {name}.",)
    if np.ptp(problem.relative_sd) == 0:
        return ()
    linearized = problem.linearize()
    predicted = problem.responses - linearized.unwhiten(linearized.residual)
    (least, at_least), (most, at_most) = (
        (table.format_size(float(sd[row])), table.format_size(float(predicted[row])))
        for row in (np.argmin(problem.relative_sd), np.argmax(problem.relative_sd))
    )
    return (
        f"The noise of {table.response} grows with the response, from {least} where the law predicts "
        f"{at_least} to {most} where it predicts {at_most}; rows are weighted by 1 / noise^2.",
    )


def describe_late_columns(rows: pd.DataFrame, time_unit: str) -> tuple[str, ...]:
    """What columns are that were made from others, as sentences."""
    parsed = {name: parse_late(name, time_unit) for name in map(str, rows)}
    return tuple(
        f"{name}: {late[0]} behind a low-pass filter with that time constant, as a heavy body follows it. It "
        f"was searched as one more column, since it explains more than {late[0]} itself."
        for name, late in parsed.items()
        if late is not None and late[0] in parsed
    )


def declared_time_unit(law: Any, table: pd.DataFrame, time: str | None) -> str:
    """The unit of a time column of numbers: as stated, years where it shows these, or seconds."""
    if not _is_number(table, time):
        return "s"
    return stated_time_unit(law, str(time)) or ("years" if are_parts_of_years(table[time]) else "s")


def are_parts_of_years(cells: pd.Series) -> bool:
    """Whether numbers are months or quarters of calendar years, some of them within a year.

    Examples
    --------
    >>> [are_parts_of_years(pd.Series(times)) for times in ([1959.0, 1959.0833, 1959.1667], [1959.0, 1960.0])]
    [True, False]
    """
    values = cells.dropna().to_numpy(float)
    if not len(values) or values.min() < CALENDAR[0] or values.max() > CALENDAR[1]:
        return False
    months = 12.0 * values
    return bool(np.any(values % 1 > YEAR_TOL) and np.all(np.abs(months - np.round(months)) < YEAR_TOL))


def stated_time_unit(law: Any, time: str) -> str | None:
    """The unit of a time column that the law declares or its name ends in, if any."""
    declared = (getattr(law, "units", None) or {}).get(time)
    return str(declared) if declared else time_unit_of(time)


def _is_number(table: pd.DataFrame, name: str | None) -> bool:
    return name in table and pd.api.types.is_numeric_dtype(table[name])


def _hash_frame(frame: pd.DataFrame) -> str:
    try:
        cells = pd.util.hash_pandas_object(frame, index=False).to_numpy().tobytes()
    except TypeError:  # cells such as lists, which a role may not name anyway
        cells = repr(frame).encode()
    return hashlib.sha256(cells).hexdigest()
