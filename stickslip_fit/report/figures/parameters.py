"""Calibrated parameters session by session, both estimators with their error bars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stickslip_fit.errors import shorten
from stickslip_fit.fit import Result
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    GREY,
    LEGEND_LINE,
    TITLE_LINE,
    canvas,
    key_line,
    legend,
    look,
)
from stickslip_fit.report.wording import count, joint_name, way
from stickslip_fit.units import from_si

MOST_SESSIONS = 30
LABELS = 12  # session names that an axis has room for
LONGEST_BAR = 1.5  # of the spread of the estimates: a bar that few replicates make huge is cut there


def parameters_picture(joint: int, calibration: Result, fit: Result) -> Picture:
    """How much the parameters of a joint change from session to session, beside their uncertainty."""
    key, title = f"parameters-{joint}", f"Parameters of {joint_name(joint)} by session"
    tables = [_of_joint(calibration, joint), _of_joint(fit, joint)]
    all_sessions = list(fit.joints[joint].groups["session"].unique())
    sessions = all_sessions[-MOST_SESSIONS:]
    tables = [table[table["session"].isin(sessions)] for table in tables]
    if len(sessions) < 2:
        return not_drawn(key, title, "It would need a second session.")
    latest = "" if sessions == all_sessions else f"The latest {len(sessions)} of "
    no_bars = " A point without a bar: no replicates tell how large it would be."
    caption = (
        f"{latest}{count(len(all_sessions), 'session')} in order of time. Open: closed form, from the "
        "session's calibration traverses; filled: least squares over all its traverses; bars: one standard "
        "error (cut short where they would hide the rest). Changes between sessions beyond the bars are "
        "what a new calibration is for." + (no_bars if _lacks_bars(tables) else "")
    )
    return picture(key, title, caption, draw_parameters(tables, sessions))


def draw_parameters(tables: Sequence[pd.DataFrame], sessions: list[str]) -> Figure:
    """One row of axes for each direction, one column for each parameter."""
    names = list(dict.fromkeys(name for table in tables for name in table["name"]))
    directions = [sign for sign in ("+", "-") if any((table["direction"] == sign).any() for table in tables)]
    with look():
        entries = [
            key_line("closed form", GREY, marker="o"),
            key_line("least squares", GREY, marker="s"),
        ]
        entries[0].set_markerfacecolor("white")
        figure, axes = canvas(
            [1.15] * len(directions),
            len(names),
            top=LEGEND_LINE + TITLE_LINE + 0.14,
            bottom=0.85,
            across=0.58,
            share_y=False,
            share_x=True,
        )
        for row, direction in enumerate(directions):
            for column, name in enumerate(names):
                mine = [
                    table[(table["name"] == name) & (table["direction"] == direction)] for table in tables
                ]
                _draw(axes[row, column], mine, sessions, DIRECTION_COLOURS[direction])
            axes[row, 0].set_ylabel(f"direction {way(direction)}")
        for column, name in enumerate(names):
            unit = tables[0].loc[tables[0]["name"] == name, "unit"].iloc[0]
            axes[0, column].set_title(name if unit == "1" else f"{name} ({unit})")
            _name_sessions(axes[-1, column], sessions)
        legend(figure, entries)
    return figure


def _of_joint(result: Result, joint: int) -> pd.DataFrame:
    table = result.parameters
    return table[table["joint"] == joint]


def _lacks_bars(tables: Sequence[pd.DataFrame]) -> bool:
    return any(bool((table["estimate"].notna() & table["standard_error"].isna()).any()) for table in tables)


def _draw(axes: Axes, tables: Sequence[pd.DataFrame], sessions: list[str], colour: str) -> None:
    for table, aside, fill, marker in zip(tables, (-0.12, 0.12), ("white", colour), "os", strict=True):
        unit = table["unit"].iloc[0]
        x = np.array([sessions.index(session) for session in table["session"]]) + aside
        axes.errorbar(
            x,
            from_si(table["estimate"].to_numpy(), unit),
            yerr=np.nan_to_num(from_si(table["standard_error"].to_numpy(), unit)),
            ls="", marker=marker, color=colour, markerfacecolor=fill, markeredgewidth=0.8, elinewidth=0.7,
        )  # fmt: skip
    axes.set_xlim(-0.5, len(sessions) - 0.5)
    _keep_in_view(axes, tables)


def _keep_in_view(axes: Axes, tables: Sequence[pd.DataFrame]) -> None:
    """Bars that few replicates make huge must not flatten everything else."""
    both = pd.concat(tables)
    unit = both["unit"].iloc[0]
    estimates = from_si(both["estimate"].dropna().to_numpy(), unit)
    errors = from_si(both["standard_error"].dropna().to_numpy(), unit)
    if not len(estimates):
        axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", va="center", color=GREY)
        axes.set_yticks([])
    elif len(errors):
        room = LONGEST_BAR * max(np.ptp(estimates), np.median(errors))
        low, high = axes.get_ylim()
        axes.set_ylim(max(low, estimates.min() - room), min(high, estimates.max() + room))


def _name_sessions(axes: Axes, sessions: list[str]) -> None:
    every = -(-len(sessions) // LABELS)
    places = list(range(0, len(sessions), every))
    axes.set_xticks(places, [shorten(sessions[k], 12) for k in places], rotation=90)
