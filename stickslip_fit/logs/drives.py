"""read_drives: drives to be predicted, a file with the columns of a log but for its counts."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._typing import BoolArray
from stickslip_fit.logs._files import SourcePath, open_sources
from stickslip_fit.logs._table import IssueCollector, parse_numbers
from stickslip_fit.logs._units import doubt_units
from stickslip_fit.logs.history import add_session_history
from stickslip_fit.logs.reader import build_columns, match_files, order_columns, read_row_keys
from stickslip_fit.logs.schema import COVARIATE_PREFIX, LogCells, LogFormat, log_format, split_by_file
from stickslip_fit.machine import Machine

ORDER = "order"  # of the rows in the file
NOT_NEEDED = ("session", "time")  # by a drive


def read_drives(
    source: SourcePath | Iterable[SourcePath],
    machine: Machine,
    fitted: Mapping[tuple[int, str], Sequence[str]],
    needed: Collection[str],
    sheet: str | None = None,
) -> pd.DataFrame:
    """Read and check drives, CSV, Excel or Parquet, that a law is to predict.

    Parameters
    ----------
    source : path or iterable of paths
        See `read_log`. Columns as in a log. Session and time are not needed; counts are not read.
    machine : Machine
    fitted : mapping of (int, str) to sequence of str
        The sessions that the law knows, by joint and direction.
    needed : collection of str
        Columns of a log's rows on which the law depends.
    sheet : str, optional
        See `read_log`.

    Returns
    -------
    DataFrame
        The columns of `Log.rows` without steps, in the order of the file; history only with times. The
        session is empty where the file has none, and check_every is 1 where it is not given.

    Raises
    ------
    InputError
        With every fault: file, line, column, value and what to do; a session, joint or direction that was not
        fitted among them.

    Warns
    -----
    UserWarning
        As `read_log`.
    """
    issues = IssueCollector()
    files = match_files(open_sources(source, issues, sheet), _drive_format(machine), issues)
    keys = read_row_keys(files, machine, labelled=False)
    placed = [joint for joint in machine.joints if f"q{joint}" in needed]
    columns, _ = build_columns(files, keys, machine, placed)
    _report_unfitted(files, columns, fitted)
    for cells in files:
        _report_text(cells, needed)
    issues.raise_if_any()
    for doubt in (doubt for cells in files for doubt in doubt_units(cells, machine)):
        warnings.warn(doubt, UserWarning, stacklevel=3)
    given = np.concatenate([cells.is_filled("check_every") for cells in files])
    columns["check_every"] = columns["check_every"].where(given, 1)
    columns[ORDER] = pd.Series(np.arange(len(given)))
    rows = order_columns(columns, keys.order).drop(columns="steps")
    if keys.has_times:
        rows = add_session_history(rows, keys.session[keys.order], machine)
    rows = rows.sort_values(ORDER, ignore_index=True).drop(columns=ORDER)
    return rows.astype({name: object for name in ("session", "direction")})


def _drive_format(machine: Machine) -> LogFormat:
    form = log_format(machine)
    fields = (
        replace(field, required=field.required and field.name not in NOT_NEEDED)
        for field in form.fields
        if field.name != "steps"
    )
    return LogFormat(tuple(fields), kind="list of drives")


def _report_unfitted(
    files: list[LogCells], columns: Mapping[str, pd.Series], fitted: Mapping[tuple[int, str], Sequence[str]]
) -> None:
    """Add issues for joints, directions and sessions that the law does not know."""
    joints = {joint for joint, _ in fitted}
    table = pd.DataFrame({name: columns[name].to_numpy(object) for name in ("joint", "direction", "session")})
    keys = list(table.itertuples(index=False, name=None))
    unknown = {
        "joint": [joint > 0 and joint not in joints for joint, _, _ in keys],
        "direction": [
            joint in joints and way in ("+", "-") and (joint, way) not in fitted for joint, way, _ in keys
        ],
        "session": [
            bool(label.strip()) and label not in fitted.get((joint, way), (label,))
            for joint, way, label in keys
        ],
    }
    named = [f"joint {joint} in direction {way}" for joint, way in fitted]
    choices = f"; the law knows {join_words(named)}"
    messages = {
        "joint": f"was not fitted{choices}",
        "direction": f"was not fitted of this joint{choices}",
        "session": "was not fitted; the law knows "
        f"{join_words(list(dict.fromkeys(name for own in fitted.values() for name in own)))}; "
        "an empty cell stands for a session to come",
    }
    for name, wrong in unknown.items():
        for cells, own in zip(files, split_by_file(files, np.array(wrong, np.bool_)), strict=True):
            cells.add_issue(name, own, messages[name])


def _report_text(cells: LogCells, needed: Collection[str]) -> None:
    """Add issues for cells that are no numbers, in columns of the lab's own on which the law depends."""
    for name in cells.layout.unknown:
        if COVARIATE_PREFIX + name in needed:
            bad: BoolArray = parse_numbers(cells.table.column(name)).bad
            cells.issues.add_cells(
                cells.table, bad, name, "is no number, and the law depends on it; write one"
            )
