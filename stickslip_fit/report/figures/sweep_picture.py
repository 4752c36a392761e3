"""A sweep's panels as a picture with its caption."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from stickslip_fit._format import format_configuration as configuration
from stickslip_fit._format import format_direction as way
from stickslip_fit._format import format_percent, joint_name, step_unit
from stickslip_fit._format import pluralize as count
from stickslip_fit.fit import Result
from stickslip_fit.report.figures.panels import Kind, Panel, beyond_scale, draw_panels
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import DIRECTION_COLOURS
from stickslip_fit.report.figures.sweeps import Sweep, held, panels_of
from stickslip_fit.report.figures.traverses import SESSIONS_SHOWN
from stickslip_fit.units import from_si


@dataclass(frozen=True)
class SweepFigure:
    """What one sweep figure shows.

    Attributes
    ----------
    key, title : str
    sweep : Sweep
    fixed : dict of str to float
        Columns held at one value in the whole figure, SI.
    by : tuple of str
        Columns held in each panel.
    needed : str
        The traverses to make where the log has no such sweep.
    note : str
        What to look for.
    """

    key: str
    title: str
    sweep: Sweep
    fixed: dict[str, float]
    by: tuple[str, ...]
    needed: str
    note: str = ""


def sweep_picture(spec: SweepFigure, rows: pd.DataFrame, fit: Result) -> Picture:
    """Draw a sweep from the rows of one joint, or say which traverses it would need."""
    panels, left_out = panels_of(held(rows, spec.fixed), spec.sweep, list(spec.by), fit)
    if not panels:
        return not_drawn(spec.key, spec.title, f"It would need {spec.needed}.")
    joint = int(rows["joint"].iloc[0])
    figure = draw_panels(
        panels,
        direction_kinds(joint),
        x_label=spec.sweep.label,
        unit=step_unit(joint),
        angle=spec.sweep.unit == "deg",
    )
    more = f" {count(left_out, 'further panel')} left out." if left_out else ""
    return picture(spec.key, spec.title, f"{spec.note} {caption(panels, rows, fit)}{more}".strip(), figure)


def direction_kinds(joint: int) -> dict[str, Kind]:
    """The two directions as colours."""
    words = {"+": "outward", "-": "inward"} if joint == 3 else {"+": "increasing", "-": "decreasing"}
    return {sign: Kind(f"{way(sign)} ({words[sign]})", DIRECTION_COLOURS[sign]) for sign in ("+", "-")}


def caption(panels: Sequence[Panel], rows: pd.DataFrame, fit: Result) -> str:
    """What the panels show, in numbers."""
    points = pd.concat([panel.points for panel in panels])
    joint = int(rows["joint"].iloc[0])
    unit = step_unit(joint)
    low, high = (from_si(value, unit) for value in (points["step_size"].min(), points["step_size"].max()))
    shown, left_out = points.index.nunique(), sum(panel.left_out for panel in panels)
    sessions = _of_sessions(points["session"].nunique(), rows["session"].nunique())
    told = [f"{count(shown, 'traverse')} of {joint_name(joint)}{sessions}: {low:,.0f} to {high:,.0f} {unit}."]
    if left_out:
        told.append(f"{left_out:,} more are left out, by lot.")
    if points["departure"].notna().any():
        worst = rows.loc[points["departure"].abs().idxmax()]
        told.append(
            f"Furthest from the law: {format_percent(worst['departure'], signed=True)} in direction "
            f"{way(worst['direction'])}, {configuration(worst, fit.machine.span(joint))}."
        )
    if hidden := beyond_scale(panels):
        told.append(f"{count(hidden, 'point')} beyond the lower scale (×).")
    return " ".join(told)


def _of_sessions(shown: int, all_of_them: int) -> str:
    if all_of_them == 1:
        return ""
    if all_of_them <= SESSIONS_SHOWN:
        return f" in {count(shown, 'session')}"
    return f" in the latest {shown} of {all_of_them} sessions"
