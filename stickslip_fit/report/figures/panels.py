"""Small multiples of a sweep: step size with the law above, what the law leaves over below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit.errors import shorten
from stickslip_fit.report.figures.style import (
    GREY,
    INK,
    LEGEND_LINE,
    MARKERS,
    TITLE_LINE,
    angle_ticks,
    canvas,
    key_line,
    legend,
    legend_rows,
    look,
)
from stickslip_fit.report.figures.svg import name_traverses
from stickslip_fit.units import from_si

POINTS_A_PANEL = 400
TICKS = {1: 7, 2: 7, 3: 7, 4: 4}  # at most, by how many panels stand side by side
ZOOM = 3.0  # the departures' scale leaves out points that are this much further off than 95 % of them


@dataclass(frozen=True)
class Kind:
    """Points of one colour: label in the legend and the colour."""

    label: str
    colour: str


@dataclass(frozen=True)
class Panel:
    """One column of the figure.

    Attributes
    ----------
    title : str
        What is held fixed in it.
    points : DataFrame
        x (people's unit), step_size, error, model, departure (SI), kind, session; half_width of the
        traverse in x where that means something.
    curves : DataFrame
        x, step_size, kind, session: the law, one curve for each kind and session.
    left_out : int
        Traverses that are not among the points because there are too many to tell apart.
    """

    title: str
    points: pd.DataFrame
    curves: pd.DataFrame
    left_out: int = 0


def overlaid(one: Panel, other: Panel) -> Panel:
    """Two panels in one, under the first one's title."""
    points, curves = pd.concat([one.points, other.points]), pd.concat([one.curves, other.curves])
    return Panel(one.title, points, curves, one.left_out + other.left_out)


def draw_panels(
    panels: Sequence[Panel], kinds: dict[str, Kind], *, x_label: str, unit: str, angle: bool
) -> Figure:
    """Draw panels side by side on common scales.

    Parameters
    ----------
    panels : sequence of Panel
    kinds : dict
        By the name that the points' column kind holds.
    x_label : str
    unit : {"nm", "µrad"}
        Of the step size.
    angle : bool
        Whether x is an angle in degrees.
    """
    sessions = list(dict.fromkeys(session for panel in panels for session in panel.points["session"]))
    lines = max(panel.title.count("\n") + 1 for panel in panels)
    with look():
        entries = _entries(kinds, sessions)
        top = LEGEND_LINE * legend_rows(entries) + TITLE_LINE * lines + 0.14
        figure, axes = canvas([1.75, 1.0], len(panels), top=top)
        limit = _departure_limit(pd.concat([panel.points for panel in panels]))
        for column, panel in enumerate(panels):
            above, below = axes[:, column]
            above.set_title(panel.title)
            _draw_curves(above, panel, kinds, unit)
            _draw_step_sizes(above, panel, kinds, sessions, unit)
            _draw_departures(below, panel, kinds, sessions, limit)
            if angle:
                x = panel.points["x"]
                angle_ticks(below, x.min(), x.max(), TICKS.get(len(panels), 3))
        axes[0, 0].set_ylabel(f"mean step size ({unit})")
        axes[1, 0].set_ylabel("seen less law (%)")
        figure.align_ylabels(axes[:, 0])
        figure.supxlabel(x_label, y=0.02, va="bottom", size=8, color=INK)
        legend(figure, entries)
    return figure


def _draw_curves(axes: Axes, panel: Panel, kinds: dict[str, Kind], unit: str) -> None:
    for (kind, _), curve in panel.curves.groupby(["kind", "session"], sort=False, observed=True):
        axes.plot(curve["x"], from_si(curve["step_size"].to_numpy(), unit), color=kinds[kind].colour, lw=0.9)


def _draw_step_sizes(
    axes: Axes, panel: Panel, kinds: dict[str, Kind], sessions: list[str], unit: str
) -> None:
    for (kind, session), points in panel.points.groupby(["kind", "session"], sort=False, observed=True):
        drawn = axes.errorbar(
            points["x"],
            from_si(points["step_size"].to_numpy(), unit),
            yerr=from_si(points["error"].to_numpy(), unit),
            xerr=points["half_width"] if points["half_width"].any() else None,
            **_style(kinds[kind], sessions.index(session)),
        )
        name_traverses(drawn[0], points.index)


def _draw_departures(
    axes: Axes, panel: Panel, kinds: dict[str, Kind], sessions: list[str], limit: float
) -> None:
    axes.axhline(0.0, color=INK, lw=0.8, zorder=1)
    axes.set_ylim(-limit, limit)
    spread = _spacing(panel.points["x"])
    for (kind, session), points in panel.points.groupby(["kind", "session"], sort=False, observed=True):
        order = list(kinds).index(kind) * len(sessions) + sessions.index(session)
        aside = spread * (order - (len(kinds) * len(sessions) - 1) / 2) / (len(kinds) * len(sessions))
        departure = 100 * points["departure"].to_numpy()
        shown = np.clip(departure, -limit, limit)
        style = _style(kinds[kind], sessions.index(session))
        error = 100 * (points["error"] / points["step_size"]).to_numpy()
        bars = np.where(shown == departure, error, 0.0)
        drawn = axes.errorbar(points["x"] + aside, shown, yerr=bars, **style)
        name_traverses(drawn[0], points.index)
        beyond = shown != departure
        axes.plot(
            (points["x"] + aside)[beyond], shown[beyond], ls="", marker="x", ms=6, color=INK, clip_on=False
        )


def _style(kind: Kind, session: int) -> dict[str, Any]:
    return {
        "linestyle": "",
        "marker": MARKERS[session % len(MARKERS)],
        "color": kind.colour,
        "markerfacecolor": "white",
        "markeredgewidth": 0.8,
        "elinewidth": 0.7,
    }


def _departure_limit(points: pd.DataFrame) -> float:
    """Half the departures' scale, %: wide enough for all points but a few that are far out."""
    reach = 100 * (points["departure"].abs() + points["error"] / points["step_size"]).dropna().to_numpy()
    if not len(reach):
        return 1.0
    return float(1.1 * min(reach.max(), ZOOM * np.quantile(reach, 0.95)))


def beyond_scale(panels: Sequence[Panel]) -> int:
    """How many points the departures' scale leaves out; a caption should say so."""
    points = pd.concat([panel.points for panel in panels])
    return int((100 * points["departure"].abs() > _departure_limit(points)).sum())


def _spacing(x: pd.Series[float]) -> float:
    """Room beside a point before its neighbour's begins."""
    values = np.unique(x.round(6))
    return 0.5 * float(np.min(np.diff(values))) if len(values) > 1 else 1.0


def _entries(kinds: dict[str, Kind], sessions: list[str]) -> list[Line2D]:
    entries = [key_line(kind.label, kind.colour, marker="o", line="-") for kind in kinds.values()]
    if len(sessions) > 1:
        entries += [
            key_line(shorten(session, 18), GREY, marker=MARKERS[index % len(MARKERS)])
            for index, session in enumerate(sessions)
        ]
    return [*entries, key_line("law (least squares)", INK, line="-")]
