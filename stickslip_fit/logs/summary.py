"""What a log holds, in a screenful."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stickslip_fit.logs.columns import CONDITIONS, COVARIATE, FIELDS
from stickslip_fit.logs.configurations import configurations
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.units import SUFFIXES, from_si

_MOST_SESSIONS = 20


def summarise(rows: pd.DataFrame, sources: Sequence[tuple[str, str]], notes: Sequence[str]) -> str:
    """Describe a log for people: files, sessions, joints, coverage, columns, notes.

    Parameters
    ----------
    rows : DataFrame
        Rows of a Log.
    sources : sequence of (str, str)
        Name and sha256 of each file.
    notes : sequence of str
    """
    traverses, sessions = _plural(len(rows), "traverse"), _plural(rows["session"].nunique(), "session")
    tables = [_sessions(rows), _joints(rows), _coverage(rows[rows["status"] == "ok"]), _columns(rows)]
    parts = [
        "\n".join([f"{traverses} in {sessions}", *(f"  {file}  sha256 {sha[:12]}" for file, sha in sources)]),
        *(align(table) for table in tables if len(table) > 1),
    ]
    if notes:
        parts.append("\n".join(["notes", *(f"  {note}" for note in notes)]))
    return "\n\n".join(parts)


def align(table: Sequence[Sequence[str]]) -> str:
    """Rows of text in columns: the first to the left, the others to the right.

    Examples
    --------
    >>> print(align([["joint", "traverses"], ["3 +", "219"]]))
    joint  traverses
    3 +          219
    """
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for first, *others in table:
        cells = [first.ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def _sessions(rows: pd.DataFrame) -> list[list[str]]:
    groups = rows.groupby("session", sort=False)["time"].agg(["min", "max", "size"])
    table = [
        [str(session), f"{first:%Y-%m-%d %H:%M}", f"{last:%Y-%m-%d %H:%M}", f"{count:,}"]
        for session, first, last, count in groups.itertuples()
    ]
    left_out = len(table) - _MOST_SESSIONS
    if left_out > 0:
        half = _MOST_SESSIONS // 2
        table[half:-half] = [[f"({left_out:,} more)", "", "", ""]]
    return [["session", "first", "last", "traverses"], *table]


def _joints(rows: pd.DataFrame) -> list[list[str]]:
    header = ["joint", "traverses", "ok", "interrupted", "excluded", "configurations", "replicates"]
    table = [header]
    for (joint, direction), group in rows.groupby(["joint", "direction"], sort=True):
        statuses = [f"{(group['status'] == status).sum():,}" for status in header[2:5]]
        covered = configurations(group[group["status"] == "ok"])
        places = covered.drop_duplicates(["q1", "q2", "q3", "theta", "psi", "low", "high"])
        counts = [f"{len(places):,}", f"{covered['replicates'].sum():,}"]
        table.append([f"{joint} {direction}", f"{len(group):,}", *statuses, *counts])
    return table


def _coverage(usable: pd.DataFrame) -> list[list[str]]:
    table = [["covered (deg, mm)", "q1", "q2", "q3", "theta", "psi", "traversed"]]
    for joint, group in usable.groupby("joint", sort=True):
        cells = [
            _values(group[name], "mm" if name == "q3" else "deg")
            for name in ("q1", "q2", "q3", "theta", "psi")
        ]
        length = (group["stop"] - group["start"]).abs()
        table.append([f"joint {joint}", *cells, _values(length, "mm" if joint == PRISMATIC else "deg")])
    return table


def _columns(rows: pd.DataFrame) -> list[list[str]]:
    given = [name for name in CONDITIONS if rows[name].notna().any()]
    own = [name for name in rows.columns if name.startswith(COVARIATE)]
    units = {field.name: SUFFIXES[field.suffixes[0]] for field in FIELDS if field.name in given}
    table = [["column", "given", "values"]]
    for name in given + own:
        unit = units.get(name, "1")
        label = name if unit == "1" else f"{name} ({unit})"
        table.append([label, f"{rows[name].notna().sum():,} of {len(rows):,}", _values(rows[name], unit)])
    return table


def _values(values: pd.Series, unit: str) -> str:
    """A few values as they are, many as lowest and highest."""
    with np.errstate(over="ignore"):
        distinct = np.unique(np.round(from_si(values.dropna().to_numpy(), unit), 6)) + 0.0
    if len(distinct) <= 4:
        return " ".join(f"{value:g}" for value in distinct)
    return f"{distinct[0]:g} to {distinct[-1]:g} ({len(distinct):,} values)"


def _plural(count: int, word: str) -> str:
    return f"{count:,} {word}" if count == 1 else f"{count:,} {word}s"
