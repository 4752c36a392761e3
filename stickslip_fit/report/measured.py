"""What was measured: sessions, coverage, and what is not fitted."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    format_configuration,
    format_direction,
    format_plain,
    join_words,
    joint_name,
    pluralize,
)
from stickslip_fit._summary import Column, Table
from stickslip_fit.logs import Log
from stickslip_fit.units import from_si

MOST_ROWS = 24
FEW_VALUES = 4
NOT_FITTED = ("interrupted", "excluded")


def facts(log: Log) -> str:
    """The log in a sentence or two."""
    rows = log.rows
    dates = dict.fromkeys(f"{moment:%Y-%m-%d}" for moment in (rows["time"].min(), rows["time"].max()))
    told = (
        f"{pluralize(len(rows), 'traverse')} in {pluralize(len(log.sessions), 'session')} "
        f"({' to '.join(dates)}), "
        f"{join_words([joint_name(joint) for joint in log.joints])}."
    )
    states = rows["status"].value_counts()
    unused = [pluralize(int(states[name]), f"{name} traverse") for name in NOT_FITTED if name in states]
    return f"{told} " + (
        f"Not fitted, but part of the history: {join_words(unused)}." if unused else "All are usable."
    )


def sessions_table(log: Log) -> Table:
    """When each session was and what was driven in it."""
    kinds = [(joint, sign) for joint in log.joints for sign in ("+", "-")]
    columns = (
        Column("session", text=True),
        Column("first traverse", text=True),
        Column("last traverse", text=True),
        *(Column(format_direction(sign), group=f"joint {joint}") for joint, sign in kinds),
        *(Column(name, group="not fitted") for name in NOT_FITTED),
    )
    body = []
    for session, rows in log.rows.groupby("session", sort=False, observed=True):
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
    return _latest("Sessions and traverses", columns, body, "session")


def coverage_table(log: Log) -> Table:
    """What was covered: one column for each joint."""
    covered = [_coverage(log, joint) for joint in log.joints]
    columns = (Column("covered", text=True), *(Column(joint_name(joint), text=True) for joint in log.joints))
    body = tuple((name, *(each[name] for each in covered)) for name in covered[0])
    note = (
        "Configurations: different places and stretches, whatever the direction. Replicates: traverses that "
        "repeat another one of their session."
    )
    return Table("Coverage, usable traverses", columns, body, note=note)


def _coverage(log: Log, joint: int) -> dict[str, str]:
    rows, places = log.usable, log.configurations()
    rows, places = rows[rows["joint"] == joint], places[places["joint"] == joint]
    distinct = places[["q1", "q2", "q3", "theta", "psi", "low", "high"]].drop_duplicates()
    full = np.isclose((rows["stop"] - rows["start"]).abs(), log.machine.span(joint), rtol=1e-6)
    covered = {
        "traverses": f"{len(rows):,}",
        "over the full range": f"{full.sum():,}",
        "configurations": f"{len(distinct):,}",
        "replicates": f"{places['replicates'].sum():,}",
    }
    for name, unit in {"q1": "deg", "q2": "deg", "q3": "mm", "theta": "deg", "psi": "deg"}.items():
        label = f"{name} ({'°' if unit == 'deg' else unit})"
        covered[label] = "moves" if name == f"q{joint}" else _values(rows[name], unit)
    return covered


def remarked_table(log: Log) -> Table | None:
    """Traverses that the lab wrote a note about or does not have fitted; None where there are none."""
    rows = log.rows[(log.rows["note"] != "") | (log.rows["status"] != "ok")]
    if rows.empty:
        return None
    columns = tuple(
        Column(name, text=True) for name in ("time", "session", "joint", "configuration", "status", "note")
    )
    body = tuple(
        (
            f"{row['time']:%Y-%m-%d %H:%M:%S}",
            str(row["session"]),
            f"{row['joint']} {format_direction(row['direction'])}",
            format_configuration(row, log.machine.span(row["joint"])),
            str(row["status"]),
            str(row["note"]),
        )
        for _, row in rows.head(MOST_ROWS).iterrows()
    )
    left = len(rows) - len(body)
    note = f"{pluralize(left, 'more traverse')} with a note or not fitted: see the log." if left else ""
    return Table("Traverses with a note or not fitted", columns, body, note=note)


def _values(values: pd.Series[float], unit: str) -> str:
    """A few values as they are, many as lowest and highest, with their spacing where it is even."""
    distinct = np.unique(np.round(from_si(values.dropna().to_numpy(float), unit), 3)) + 0.0
    if not len(distinct):
        return "–"
    if len(distinct) <= FEW_VALUES:
        return ", ".join(format_plain(value) for value in distinct)
    ends = f"{format_plain(distinct[0])} to {format_plain(distinct[-1])}"
    spacing = np.diff(distinct)
    if np.allclose(spacing, spacing[0], atol=2e-3):
        return f"{ends} by {format_plain(spacing[0])}"
    return f"{ends}, {len(distinct):,} values"


def _latest(caption: str, columns: tuple[Column, ...], body: list[tuple[str, ...]], what: str) -> Table:
    more = len(body) > MOST_ROWS
    note = f"The latest {MOST_ROWS} of {pluralize(len(body), what)}." if more else ""
    return Table(caption, columns, tuple(body[-MOST_ROWS:]), note=note)
