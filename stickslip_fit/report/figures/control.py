"""Control chart: each parameter by session, within the limits that the sessions before it set."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import join_words as listed
from stickslip_fit._format import joint_name
from stickslip_fit._format import pluralize as count
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.fit import Result
from stickslip_fit.fit.expectation import control_chart
from stickslip_fit.report.figures.drawing import Drawing, on_white
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    GREY,
    INK,
    LEGEND_LINE,
    TITLE_LINE,
    WIDTH,
    grid,
    height,
    key_line,
    legend,
    look,
)
from stickslip_fit.units import from_si

MOST_SESSIONS = 30
LABELS = 12  # session names that an axis has room for
LONGEST = 2.5  # of the spread of the estimates: bars and limits that say little are cut there
PANEL = 1.15  # inches
MARGINS = {
    "left": 0.62, "right": 0.08, "top": 2 * TITLE_LINE + 0.10, "bottom": 0.85, "across": 0.58, "down": 0.12
}  # fmt: skip
LIMITS, LATEST_LIMITS = "#e4e4e0", "#c4c4be"
OUTSIDE = "outside"


def control_picture(joint: int, fit: Result) -> Picture:
    """How the parameters of a joint change from session to session, and when that is more than usual."""
    key, title = f"parameters-{joint}", f"Parameters of {joint_name(joint)} by session"
    chart = control_chart(fit)
    chart = chart[chart["joint"] == joint]
    sessions = list(fit.joints[joint].groups["session"].unique())
    if len(sessions) < 2:
        return not_drawn(key, title, "It would need a second session.")
    if chart.empty:
        return not_drawn(key, title, "It would need a session in which a parameter can be known.")
    return picture(key, title, _caption(chart, sessions), draw_control(fit, chart))


def plot_control(result: Result) -> Figure:
    """The chart of all joints of a result."""
    chart = control_chart(result)
    if chart.empty:
        raise InputError(
            "no parameter is known in any session, so there is nothing to chart; see the remarks"
        )
    return on_white(draw_control(result, chart))


def draw_control(result: Result, chart: pd.DataFrame) -> Figure:
    """One block for each joint of the chart: directions down, parameters across."""
    joints = list(chart["joint"].unique())
    blocks = [
        (result.joints[joint].groups["session"].unique()[-MOST_SESSIONS:], chart[chart["joint"] == joint])
        for joint in joints
    ]
    with look():
        talls = [_height(mine) for _, mine in blocks]
        ratios = [LEGEND_LINE + 0.08, *talls]
        figure = Drawing(figsize=(WIDTH, sum(ratios)))
        top, *parts = figure.subfigures(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0]
        legend(top, _entries(chart))
        for part, (sessions, mine) in zip(parts, blocks, strict=True):
            _draw_joint(part, mine[mine["session"].isin(sessions)], list(sessions))
    return figure


def _height(chart: pd.DataFrame) -> float:
    return height([PANEL] * chart["direction"].nunique(), MARGINS["top"], MARGINS["bottom"], MARGINS["down"])


def _entries(chart: pd.DataFrame) -> list[Line2D]:
    entries = [key_line("session, bar 95 %", GREY, marker="o", line="-")]
    if chart["expected_low"].notna().any():
        expected = key_line("expected from the sessions before (99 %)", LATEST_LIMITS, line="-")
        expected.set_linewidth(6)
        entries += [expected, key_line(OUTSIDE, INK, marker="X")]
    return entries


def _draw_joint(part: SubFigure, chart: pd.DataFrame, sessions: list[str]) -> None:
    names, directions = chart["name"].unique(), [sign for sign in "+-" if (chart["direction"] == sign).any()]
    axes = grid(part, [PANEL] * len(directions), len(names), **MARGINS, share_x=True, share_y=False)
    part.suptitle(
        joint_name(int(chart["joint"].iloc[0])), x=0.0, y=1.0, ha="left", va="top", fontweight="bold"
    )
    for row, sign in enumerate(directions):
        for column, name in enumerate(names):
            mine = chart[(chart["name"] == name) & (chart["direction"] == sign)]
            _draw(axes[row, column], mine, sessions, DIRECTION_COLOURS[sign])
        axes[row, 0].set_ylabel(f"direction {way(sign)}")
    for column, name in enumerate(names):
        unit = chart.loc[chart["name"] == name, "unit"].iloc[0]
        axes[0, column].set_title(name if unit == "1" else f"{name} ({unit})")
        _name_sessions(axes[-1, column], sessions)


def _draw(axes: Axes, chart: pd.DataFrame, sessions: list[str], colour: str) -> None:
    axes.set_xlim(-0.5, len(sessions) - 0.5)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(visible=False, axis="x")
    if chart.empty:
        axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", va="center", color=GREY)
        axes.set_yticks([])
        return
    unit = chart["unit"].iloc[0]
    x = np.array([sessions.index(session) for session in chart["session"]])
    numbers = chart[["estimate", "low", "high", "expected_low", "expected_high"]]
    y, low, high, expected_low, expected_high = from_si(numbers.to_numpy(float), unit).T
    latest = x == len(sessions) - 1
    for which, shade in ((~latest, LIMITS), (latest, LATEST_LIMITS)):
        axes.bar(
            x[which], (expected_high - expected_low)[which], 1.0, expected_low[which], color=shade, lw=0.4
        )
    axes.vlines(x, low, high, color=colour, lw=0.7)
    odd = chart["surprising"].to_numpy(bool)
    axes.plot(x[~odd], y[~odd], ls="", marker="o", color=colour)
    axes.plot(x[odd], y[odd], ls="", marker="X", ms=6.0, mec="white", mew=0.5, color=INK)
    _keep_in_view(axes, y, np.concatenate([low, high, expected_low, expected_high]))


def _keep_in_view(axes: Axes, y: np.ndarray, ends: np.ndarray) -> None:
    """Estimates decide what is in view: what hardly anything is known of must not flatten all else."""
    ends = ends[np.isfinite(ends)]
    room = LONGEST * np.ptp(y) if len(y) > 1 and np.ptp(y) > 0 else np.inf
    low = max(min(ends, default=y.min()), y.min() - room)
    high = min(max(ends, default=y.max()), y.max() + room)
    low, high = min(low, y.min()), max(high, y.max())
    margin = 0.08 * (high - low) if high > low else 0.01 * abs(high) or 1.0
    axes.set_ylim(low - margin, high + margin)


def _name_sessions(axes: Axes, sessions: list[str]) -> None:
    every = -(-len(sessions) // LABELS)
    places = list(range(len(sessions) - 1, -1, -every))
    axes.set_xticks(places, [shorten(str(sessions[k]), 12) for k in places], rotation=90)


def _caption(chart: pd.DataFrame, sessions: list[str]) -> str:
    shown = sessions[-MOST_SESSIONS:]
    latest = "" if shown == sessions else f"The latest {len(shown)} of "
    points = (
        f"{latest}{count(len(sessions), 'session')} in order of time, each parameter by least squares over "
        "all the session's traverses; bars: 95 %, cut short where they would hide the rest."
    )
    told = chart[chart["expected_low"].notna()]
    if told.empty:
        return f"{points} Limits, from what the sessions before lead one to expect, begin with the fourth."
    band = (
        "Grey: where the sessions before it lead one to expect it, dark for the latest; in 99 of 100 "
        "sessions all parameters lie there."
    )
    return f"{points} {band} {_surprises(told[told['session'].isin(shown)], shown[-1])}"


def _surprises(told: pd.DataFrame, latest: str) -> str:
    odd = told[told["surprising"]]
    if odd.empty:
        return f"Of {count(len(told), 'point')} with limits none is outside."
    outside = (
        f"Of {count(len(told), 'point')} with limits {len(odd):,} {'is' if len(odd) == 1 else 'are'} outside"
    )
    today = odd[odd["session"] == latest]
    if today.empty:
        return f"{outside} (crosses), none of them in the latest session."
    names = listed([f"{row.name} ({way(row.direction)})" for row in today.itertuples(index=False)])
    return f"{outside} (crosses); in the latest session {names}: calibrate again, or look for what changed."
