"""A plan as a page to print: what to set, what to drive, and boxes for the time and the steps."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import pandas as pd

from stickslip_fit._format import format_direction, format_plain, pluralize
from stickslip_fit.files import write_atomically
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.units import from_si

UNIT_OF = {"theta": "deg", "psi": "deg", "q1": "deg", "q2": "deg", "q3": "mm"}
MOVES = "moves"


@dataclass(frozen=True)
class Setting:
    """One thing that a person sets before a visit; `emphasis` says whether it differs from the one before."""

    text: str
    emphasis: str


@dataclass(frozen=True)
class Drive:
    """One traverse: its number within the session, and which joint goes which way between which ends."""

    number: int
    joint: int
    direction: str
    ends: str
    emphasis: str


@dataclass(frozen=True)
class Visit:
    """Traverses in a row for which nothing needs to be set in between; `title` where a sweep begins."""

    title: str
    settings: list[Setting]
    drives: list[Drive]


@dataclass(frozen=True)
class SessionSheet:
    """What is to be done in one session."""

    label: str
    begins: datetime
    traverses: str
    visits: list[Visit]


def sheet_html(plan: Plan) -> str:
    """The page as HTML, self-contained; each session begins on a sheet of its own."""
    from stickslip_fit._summary import template

    rows = plan.rows()
    by_label = dict(list(rows.groupby("session")))
    sessions = [_session(each.label, each.begins, by_label[each.label]) for each in plan.sessions]
    period = f"{from_si(plan.timing.step_period, 'ms'):g} ms"
    return template("sheet.html.j2").render(plan=plan, period=period, sessions=sessions)


def write_sheet_page(plan: Plan, path: str | Path) -> None:
    """Write the page.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_atomically(path, sheet_html(plan))


def _session(label: str, begins: datetime, rows: pd.DataFrame) -> SessionSheet:
    visits: list[Visit] = []
    number = 1
    before, stretch, sweep = dict.fromkeys(UNIT_OF, ""), (0, 0.0, 0.0), ""
    for _, visited in rows.groupby("visit", sort=False):
        first = visited.iloc[0]
        texts = {name: _position(first, name) for name in UNIT_OF}
        changed = {name: text not in (before[name], MOVES) for name, text in texts.items()}
        settings = [Setting(text, _emphasis(changed[name])) for name, text in texts.items()]
        here = (first["joint"], *sorted(first[["start", "stop"]]))
        drives = [
            _drive(number + offset, row, _emphasis(here != stretch))
            for offset, (_, row) in enumerate(visited.iterrows())
        ]
        visits.append(Visit(first["sweep"] if first["sweep"] != sweep else "", settings, drives))
        number, before, stretch, sweep = number + len(visited), texts, here, first["sweep"]
    return SessionSheet(label, begins, pluralize(len(rows), "traverse"), visits)


def _emphasis(changed: bool) -> str:
    return "changed" if changed else "same"


def _position(row: pd.Series, name: str) -> str:
    if name == f"q{row['joint']}":
        return MOVES
    return format_plain(from_si(float(row[name]), UNIT_OF[name]))


def _drive(number: int, row: pd.Series, emphasis: str) -> Drive:
    unit = "mm" if row["joint"] == PRISMATIC else "deg"
    start, stop = (format_plain(from_si(float(row[end]), unit)) for end in ("start", "stop"))
    return Drive(
        number, int(row["joint"]), format_direction(row["direction"]), f"{start} to {stop} {unit}", emphasis
    )
