"""What a log holds: sessions, coverage, columns, and what is not fitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MISSING,
    format_configuration,
    format_direction,
    format_plain,
    join_words,
    joint_name,
    pluralize,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.logs.columns import CONDITIONS, COVARIATE, FIELDS
from stickslip_fit.logs.log import Log
from stickslip_fit.units import SUFFIXES, from_si

MAX_ROWS = 10  # of a table; the log itself holds the others
MAX_FILES = 3
FEW_VALUES = 4
POSITIONS = {"q1": "deg", "q2": "deg", "q3": "mm", "theta": "deg", "psi": "deg"}
NOT_FITTED = ("interrupted", "excluded")


@summarize.register
def summarize_log(log: Log) -> Summary:
    """The log in two sentences, then its sessions, coverage, conditions, and traverses with a note."""
    tables = [_sessions(log), _coverage(log), _columns(log), _noted(log)]
    files = join_words([f"{name} (sha256 {sha[:12]})" for name, sha in log.sources[:MAX_FILES]] or ["memory"])
    more = len(log.sources) - MAX_FILES
    return Summary(
        title=f"Log {file_names([name for name, _ in log.sources])}".strip(),
        headline=(f"{_facts(log)} From {files}{f' and {more:,} more' if more > 0 else ''}.",),
        sections=(Section(tables=tuple(table for table in tables if table and table.rows)),),
        flags=log.notes,
        provenance=(
            *((name, f"sha256 {sha}") for name, sha in log.sources),
            (f"machine {log.machine.name}", f"sha256 {log.machine.sha256}"),
        ),
    )


def file_names(names: list[str]) -> str:
    """Files in a title, without their folders; empty for a log that was never in a file."""
    short = [Path(name).name for name in names[:MAX_FILES]]
    if len(names) > MAX_FILES:
        short.append(pluralize(len(names) - MAX_FILES, "more file"))
    return join_words(short)


def latest(sessions: int) -> str:
    """The note of a table that leaves earlier sessions out."""
    return f"The latest {MAX_ROWS} of {pluralize(sessions, 'session')}." if sessions > MAX_ROWS else ""


def _facts(log: Log) -> str:
    rows = log.rows
    counts = f"{pluralize(len(rows), 'traverse')} in {pluralize(len(log.sessions), 'session')}"
    if rows.empty:
        return f"{counts}."
    dates = dict.fromkeys(f"{moment:%Y-%m-%d}" for moment in (rows["time"].min(), rows["time"].max()))
    joints = join_words([joint_name(joint) for joint in log.joints])
    states = rows["status"].value_counts()
    unused = [pluralize(int(states[name]), f"{name} traverse") for name in NOT_FITTED if name in states]
    use = f"Not fitted, but part of the history: {join_words(unused)}." if unused else "All are usable."
    return f"{counts} ({' to '.join(dates)}), {joints}. {use}"


def _sessions(log: Log) -> Table:
    """When each session was and what was driven in it."""
    kinds = [(joint, sign) for joint in log.joints for sign in ("+", "-")]
    columns = (
        *words("session", "first traverse", "last traverse"),
        *(Column(format_direction(sign), group=f"joint {joint}") for joint, sign in kinds),
        *(Column(name, group="not fitted") for name in NOT_FITTED),
    )
    shown = log.rows[log.rows["session"].isin(log.sessions[-MAX_ROWS:])]
    body = []
    for session, rows in shown.groupby("session", sort=False, observed=True):
        driven = rows.groupby(["joint", "direction"], observed=True).size()
        body.append(
            (
                str(session),
                f"{rows['time'].iloc[0]:%Y-%m-%d %H:%M}",
                f"{rows['time'].iloc[-1]:%Y-%m-%d %H:%M}",
                *(f"{driven.get(kind, 0):,}" for kind in kinds),
                *(f"{(rows['status'] == name).sum():,}" for name in NOT_FITTED),
            )
        )
    return Table("Sessions and traverses", columns, tuple(body), note=latest(len(log.sessions)))


def _coverage(log: Log) -> Table | None:
    """What was covered: one column for each joint."""
    covered = [_coverage_of(log, joint) for joint in log.joints]
    if not covered:
        return None
    columns = (Column("covered", text=True), *(Column(joint_name(joint), text=True) for joint in log.joints))
    body = tuple((name, *(each[name] for each in covered)) for name in covered[0])
    note = "Configurations: in either direction. Replicates: traverses that repeat another of their session."
    return Table("Coverage, usable traverses", columns, body, note=note)


def _coverage_of(log: Log, joint: int) -> dict[str, str]:
    rows, places = log.usable, log.configurations()
    rows, places = rows[rows["joint"] == joint], places[places["joint"] == joint]
    distinct = places[["q1", "q2", "q3", "theta", "psi", "low", "high"]].drop_duplicates()
    length = (rows["stop"] - rows["start"]).abs()
    covered = {
        "traverses": f"{len(rows):,}",
        "over the full range": f"{np.isclose(length, log.machine.span(joint), rtol=1e-6).sum():,}",
        "configurations": f"{len(distinct):,}",
        "replicates": f"{places['replicates'].sum():,}",
    }
    for name, unit in POSITIONS.items():
        moves = name == f"q{joint}"
        covered[f"{name} ({'°' if unit == 'deg' else unit})"] = (
            "moves" if moves else _values(rows[name], unit)
        )
    return covered


def _columns(log: Log) -> Table:
    """Conditions, and the lab's own columns of numbers."""
    rows = log.rows
    units = {field.name: SUFFIXES[field.suffixes[0]] for field in FIELDS if field.name in CONDITIONS}
    given = [name for name in CONDITIONS if rows[name].notna().any()]
    own = [name for name in rows.columns if name.startswith(COVARIATE)]
    body = tuple(
        (
            f"{name} ({units[name]})" if name in units else name,
            f"{rows[name].notna().sum():,} of {len(rows):,}",
            _values(rows[name], units.get(name, "1")),
        )
        for name in given + own
    )
    return Table("Conditions", (Column("column", text=True), *numbers("given", "values")), body)


def _noted(log: Log) -> Table | None:
    """Traverses that the lab wrote a note about or does not have fitted."""
    rows = log.rows[(log.rows["note"] != "") | (log.rows["status"] != "ok")]
    names = ("time", "session", "joint", "configuration", "status", "note")
    body = tuple(
        (
            f"{row['time']:%Y-%m-%d %H:%M:%S}",
            str(row["session"]),
            f"{row['joint']} {format_direction(row['direction'])}",
            format_configuration(row, log.machine.span(row["joint"])),
            str(row["status"]),
            str(row["note"]),
        )
        for _, row in rows.head(MAX_ROWS).iterrows()
    )
    left = len(rows) - len(body)
    note = f"{pluralize(left, 'more traverse')} with a note or not fitted: see the log." if left else ""
    columns = tuple(Column(name, text=True) for name in names)
    return Table("Traverses with a note or not fitted", columns, body, note=note, folded=True)


def _values(values: pd.Series[float], unit: str) -> str:
    """A few values as they are, many as lowest and highest, with their spacing where it is even."""
    with np.errstate(over="ignore"):
        distinct = np.unique(np.round(from_si(values.dropna().to_numpy(float), unit), 3)) + 0.0
    if not len(distinct):
        return MISSING
    if len(distinct) <= FEW_VALUES:
        return ", ".join(format_plain(value) for value in distinct)
    ends = f"{format_plain(distinct[0])} to {format_plain(distinct[-1])}"
    spacing = np.diff(distinct)
    if np.allclose(spacing, spacing[0], atol=2e-3):
        return f"{ends} by {format_plain(spacing[0])}"
    return f"{ends}, {len(distinct):,} values"
