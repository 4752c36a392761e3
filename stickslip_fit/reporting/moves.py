"""Output for moves and plans: moves and poses as text, printable session sheets."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    format_direction,
    format_plain,
    format_significant,
    format_value,
    pluralize,
    typeset_text,
)
from stickslip_fit._io import write_atomically
from stickslip_fit._summary import Section, Summary, Table, numbers, words
from stickslip_fit.logs.plan import Plan
from stickslip_fit.moves import CalibratedArm, MovePlan, PoseEstimate, steps_before_recalibration
from stickslip_fit.units import PRISMATIC, Z_95, from_si


def summarize_move(arm: CalibratedArm, move: MovePlan) -> Summary:
    """The drives of a move, and where the tip ends."""
    if not move.segments:
        return Summary("Move", ("The joints are there already: nothing to drive.",))
    rows = tuple(
        (
            f"{drive.joint} {format_direction(drive.direction)}",
            format_joint_value(drive.joint, drive.start),
            format_joint_value(drive.joint, drive.stop),
            f"{drive.steps:,}",
            f"{drive.low:,.0f} to {drive.high:,.0f}",
            format_joint_error(drive.joint, drive.error),
        )
        for drive in move.segments
    )
    heads = ("from", "to", "steps", "95 % of moves need", "ends within ±")
    note = "Drive in this order: a step depends on where the other joints stand."
    table = Table("Drives", (*words("joint"), *numbers(*heads)), rows, note=note)
    answer = f"The tip ends at {format_tip(move.tip)}; known within {_format_error(move.tip_radius)} (95 %)."
    return Summary("Move", (answer, _calibration_heading(arm)), (Section(tables=(table,)),))


def summarize_pose(arm: CalibratedArm, at: PoseEstimate, tolerance: float) -> Summary:
    """Where joints and tip are, and how far one may go on before going back to a stop."""
    rows = tuple(
        (
            f"q{joint}",
            format_joint_value(joint, at.q[joint - 1]),
            format_joint_error(joint, at.q_error[joint - 1]),
            "at its stop" if joint in at.at_stop else "",
        )
        for joint in arm.machine.ranges
    )
    columns = (*words("joint"), *numbers("stands at", "known to ±"), *words(""))
    tables = [Table("Joints (95 %)", columns, rows)]
    answer = f"Tip at {format_tip(at.tip)}; known within {_format_error(at.tip_radius)} (95 %)."
    if at.tip_radius > tolerance:
        answer += f" That is more than {_format_error(tolerance)}: go back to a stop now."
    else:
        tables.append(_range_table(arm, at, tolerance))
    return Summary("Position", (answer, _calibration_heading(arm)), (Section(tables=tuple(tables)),))


def format_tip(tip: np.ndarray) -> str:
    """A tip position in mm."""
    return "({}) mm".format(", ".join(f"{from_si(value, 'mm'):.3f}" for value in tip))


def format_joint_value(joint: int, value: float) -> str:
    """A joint's position in people's units."""
    return format_value(float(value), "mm" if joint == PRISMATIC else "deg", 3)


def format_joint_error(joint: int, error: float) -> str:
    """A joint's 95 % error in people's units."""
    return _format_error(Z_95 * float(error), "µm" if joint == PRISMATIC else "mrad")


def _range_table(arm: CalibratedArm, at: PoseEstimate, tolerance: float) -> Table:
    """How many steps each joint may go on for in each direction."""
    sessions = {
        (joint, direction)
        for joint, fit in arm.result.joints.items()
        for session, direction in zip(fit.groups["session"], fit.groups["direction"], strict=True)
        if session == arm.session
    }
    rows = []
    for joint, direction in sorted(sessions):
        further = steps_before_recalibration(arm, at, joint, direction, tolerance)
        text = "all the way to its stop" if further is None else f"{further:,} steps, then go back to a stop"
        rows.append((f"joint {joint} {format_direction(direction)}", text))
    caption = f"How far each may go on, within {_format_error(tolerance)} (95 %)"
    return Table(caption, words("joint", "for"), tuple(rows))


def _calibration_heading(arm: CalibratedArm) -> str:
    theta, psi = (format_value(angle, "deg", 1) for angle in (arm.theta, arm.psi))
    return typeset_text(f"Calibration of session {arm.session}; base at theta = {theta}, psi = {psi}.")


def _format_error(value: float, unit: str = "µm") -> str:
    """An SI error in a unit, to three digits."""
    return f"{format_significant(from_si(value, unit))} {unit}" if value else f"0 {unit}"


UNIT_OF = {"theta": "deg", "psi": "deg", "q1": "deg", "q2": "deg", "q3": "mm"}
MOVES = "moves"


@dataclass(frozen=True)
class Setting:
    """One thing that a person sets before a visit; `emphasis` says whether it differs from the one before."""

    text: str
    emphasis: str


@dataclass(frozen=True)
class SheetTraverse:
    """One traverse: its number within the session, and which joint goes which way between which ends."""

    number: int
    joint: int
    direction: str
    ends: str
    emphasis: str


@dataclass(frozen=True)
class SheetVisit:
    """Traverses in a row for which nothing needs to be set in between; `title` where a sweep begins."""

    title: str
    settings: list[Setting]
    drives: list[SheetTraverse]


@dataclass(frozen=True)
class SessionSheet:
    """What is to be done in one session."""

    label: str
    begins: datetime
    traverses: str
    visits: list[SheetVisit]


def sheet_html(plan: Plan) -> str:
    """The page as HTML, self-contained; each session begins on a sheet of its own."""
    from stickslip_fit._summary import load_page_assets, load_template

    rows = plan.rows()
    by_label = dict(list(rows.groupby("session")))
    sessions = [_make_session(each.label, each.begins, by_label[each.label]) for each in plan.sessions]
    period = f"{from_si(plan.timing.step_period, 'ms'):g} ms"
    assets = load_page_assets("sheet.css", script=False)
    template = load_template("sheet.html.j2")
    return template.render(assets=assets, plan=plan, period=period, sessions=sessions)


def write_sheet_page(plan: Plan, path: str | Path) -> None:
    """Write the page.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_atomically(path, sheet_html(plan))


def _make_session(label: str, begins: datetime, rows: pd.DataFrame) -> SessionSheet:
    visits: list[SheetVisit] = []
    number = 1
    before, stretch, sweep = dict.fromkeys(UNIT_OF, ""), (0, 0.0, 0.0), ""
    for _, visited in rows.groupby("visit", sort=False):
        first = visited.iloc[0]
        texts = {name: _format_position(first, name) for name in UNIT_OF}
        changed = {name: text not in (before[name], MOVES) for name, text in texts.items()}
        settings = [Setting(text, _emphasize_changes(changed[name])) for name, text in texts.items()]
        here = (first["joint"], *sorted(first[["start", "stop"]]))
        drives = [
            _make_traverse(number + offset, row, _emphasize_changes(here != stretch))
            for offset, (_, row) in enumerate(visited.iterrows())
        ]
        visits.append(SheetVisit(first["sweep"] if first["sweep"] != sweep else "", settings, drives))
        number, before, stretch, sweep = number + len(visited), texts, here, first["sweep"]
    return SessionSheet(label, begins, pluralize(len(rows), "traverse"), visits)


def _emphasize_changes(changed: bool) -> str:
    return "changed" if changed else "same"


def _format_position(row: pd.Series, name: str) -> str:
    if name == f"q{row['joint']}":
        return MOVES
    return format_plain(from_si(float(row[name]), UNIT_OF[name]))


def _make_traverse(number: int, row: pd.Series, emphasis: str) -> SheetTraverse:
    unit = "mm" if row["joint"] == PRISMATIC else "deg"
    start, stop = (format_plain(from_si(float(row[end]), unit)) for end in ("start", "stop"))
    return SheetTraverse(
        number, int(row["joint"]), format_direction(row["direction"]), f"{start} to {stop} {unit}", emphasis
    )
