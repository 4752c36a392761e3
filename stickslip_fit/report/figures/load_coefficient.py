"""Joint 2's gamma0 and d against q3, after the thesis's Figs. 6.2, 6.6 and 6.7."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import pluralize as count
from stickslip_fit.errors import shorten
from stickslip_fit.fit import Result
from stickslip_fit.laws import Elbow
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    GREY,
    INK,
    LEGEND_LINE,
    MARKERS,
    canvas,
    key_line,
    legend,
    legend_rows,
    look,
)
from stickslip_fit.report.figures.sweep_picture import direction_kinds
from stickslip_fit.report.figures.traverses import recent
from stickslip_fit.units import from_si

KEY, TITLE = "elbow-d", "Joint 2: gamma0 and d against q3, d in three ways"
APART = 0.25  # mm between sessions at the same q3


def load_coefficient_picture(table: pd.DataFrame, fit: Result) -> Picture:
    """Draw the table of `load_coefficients`, or say what it lacks."""
    if table.empty:
        needed = "full traverses of joint 2 at psi = 0 with theta = −90° and with theta = 0, at the same q3"
        return not_drawn(KEY, TITLE, f"It would need {needed}.")
    shown = recent(table)
    worst_quadratic = from_si(float((table["quadratic"] - table["d"]).abs().max()), "µrad")
    worst_iteration = from_si(float((table["iteration_1"] - table["d"]).abs().max()), "µrad")
    caption = (
        f"{count(len(shown), 'pair')} of full traverses with and without load, replicates averaged; bars: "
        "one standard error. Lines: the least-squares law, which has both linear in q3. Right: what the "
        f"thesis's shortcuts add to d; Eq. 6.6 is off by up to {worst_quadratic:.2g} µrad, the thesis's "
        f"iteration after one pass by up to {worst_iteration:.2g} µrad, solving the integral by nothing "
        "(grey bars: its error from the counts)."
    )
    return picture(KEY, TITLE, caption, draw_load_coefficients(shown, fit))


def draw_load_coefficients(table: pd.DataFrame, fit: Result) -> Figure:
    """gamma0, d, and the shortcuts' errors side by side."""
    sessions = list(table["session"].unique())
    with look():
        entries = _entries(sessions)
        figure, axes = canvas(
            [2.1], 3, top=LEGEND_LINE * legend_rows(entries) + 0.3, across=0.55, share_y=False, left=0.5
        )
        for direction, colour in DIRECTION_COLOURS.items():
            for index, session in enumerate(sessions):
                mine = table[(table["session"] == session) & (table["direction"] == direction)]
                x = from_si(mine["q3"].to_numpy(), "mm") + APART * (index - (len(sessions) - 1) / 2)
                style: dict[str, Any] = {
                    "marker": MARKERS[index],
                    "color": colour,
                    "markerfacecolor": "white",
                    "ls": "",
                }
                _bars(axes[0, 0], x, mine["gamma0"], mine["gamma0_error"], style)
                _bars(axes[0, 1], x, mine["d"], mine["d_error"], style)
                _draw_shortcuts(axes[0, 2], x + (0.06 if direction == "+" else -0.06), mine, colour)
        _draw_law(axes[0, 0], axes[0, 1], sessions, fit)
        for axis, title in zip(
            axes[0], ("gamma0 (µrad)", "d (µrad)", "shortcut less exact d (µrad)"), strict=True
        ):
            axis.set_title(title)
            axis.set_xlabel("q3 (mm)")
        axes[0, 1].axhline(0.0, color=INK, lw=0.6)
        axes[0, 2].axhline(0.0, color=INK, lw=0.6)
        legend(figure, entries)
    return figure


def _bars(axes: Axes, x: np.ndarray, value: pd.Series, error: pd.Series, style: dict[str, Any]) -> None:
    axes.errorbar(
        x,
        from_si(value.to_numpy(), "µrad"),
        yerr=from_si(np.nan_to_num(error.to_numpy()), "µrad"),
        elinewidth=0.7,
        markeredgewidth=0.8,
        **style,
    )


def _draw_shortcuts(axes: Axes, x: np.ndarray, table: pd.DataFrame, colour: str) -> None:
    error = from_si(np.nan_to_num(table["d_error"].to_numpy()), "µrad")
    axes.errorbar(x, np.zeros(len(x)), yerr=error, ls="", color="#d9d9d9", elinewidth=2.0, zorder=1)
    for column, marker in (("quadratic", "x"), ("iteration_1", "+")):
        off = from_si((table[column] - table["d"]).to_numpy(), "µrad")
        axes.plot(x, off, ls="", marker=marker, color=colour, ms=4.5, mew=1.0)


def _draw_law(left: Axes, right: Axes, sessions: list[str], fit: Result) -> None:
    elbow = fit.joints[Elbow.joint]
    law = Elbow(fit.machine)
    ends = np.array(fit.machine.ranges[3])
    for group in elbow.groups.itertuples():
        if group.session in sessions:
            gamma0, d = law.coefficients({"q3": ends}, elbow.values[group.Index, : len(law.parameters)])
            colour = DIRECTION_COLOURS[group.direction]
            left.plot(from_si(ends, "mm"), from_si(gamma0, "µrad"), color=colour, lw=0.8, zorder=1)
            right.plot(from_si(ends, "mm"), from_si(d, "µrad"), color=colour, lw=0.8, zorder=1)


def _entries(sessions: list[str]) -> list[Line2D]:
    entries = [
        key_line(kind.label, kind.colour, marker="o", line="-") for kind in direction_kinds(2).values()
    ]
    if len(sessions) > 1:
        entries += [key_line(shorten(name, 18), GREY, marker=MARKERS[k]) for k, name in enumerate(sessions)]
    return [
        *entries,
        key_line("Eq. 6.6", INK, marker="x"),
        key_line("iteration, one pass", INK, marker="+"),
    ]
