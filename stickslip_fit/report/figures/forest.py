"""Forest: each parameter of a joint over its sessions, beside what holds for all of them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import joint_name
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.fit import Result
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    GREY,
    LEGEND_LINE,
    LETTER_WIDTH,
    TITLE_LINE,
    canvas,
    key_line,
    legend,
    look,
)
from stickslip_fit.units import from_si

MOST_SESSIONS = 24
LINE = 0.15  # inches a session
LONGEST_NAME = 18
BAND = "#d9d9d4"


def plot_forest(result: Result, joint: int, campaign: pd.DataFrame | None = None) -> Figure:
    """Draw one joint of a result.

    Parameters
    ----------
    result : Result
    joint : int
    campaign : DataFrame, optional
        Means that sessions scatter about: name, joint, direction, estimate, low, high, SI.

    Raises
    ------
    InputError
        If the joint was not fitted.
    """
    if joint not in result.joints:
        raise InputError(f"joint {joint} was not fitted; this result knows joints {list(result.joints)}")
    table = result.parameters
    table = table[table["joint"] == joint]
    bands = table[table["session"].isna()]
    if campaign is not None:
        bands = pd.concat([bands, campaign[campaign["joint"] == joint]])
    sessions = [str(name) for name in result.joints[joint].groups["session"].unique()]
    shown = sessions[-MOST_SESSIONS:]
    title = joint_name(joint)
    if len(shown) < len(sessions):
        title += f", the latest {len(shown)} of {len(sessions):,} sessions"
    return on_white(draw_forest(table, bands, shown, title))


def draw_forest(table: pd.DataFrame, bands: pd.DataFrame, sessions: list[str], title: str) -> Figure:
    """Directions and, within them, sessions down, the latest at the bottom; parameters across."""
    names = list(table["name"].unique())
    directions = [sign for sign in "+-" if (table["direction"] == sign).any()]
    longest = max(min(len(name), LONGEST_NAME) for name in sessions)
    with look():
        figure, axes = canvas(
            [LINE * len(sessions) + 0.15] * len(directions),
            len(names),
            left=0.45 + LETTER_WIDTH * longest,
            top=2 * LEGEND_LINE + 2 * TITLE_LINE + 0.08,
            bottom=0.28,
            across=0.14,
            down=0.38,
            share_x=False,
            share_y=True,
        )
        for row, sign in enumerate(directions):
            for column, name in enumerate(names):
                mine, band = (
                    each[(each["name"] == name) & (each["direction"] == sign)] for each in (table, bands)
                )
                _draw(axes[row, column], mine, band, sessions, DIRECTION_COLOURS[sign])
            axes[row, 0].set_ylabel(f"direction {way(sign)}")
        for axis, name in zip(axes[0], names, strict=True):
            unit = table.loc[table["name"] == name, "unit"].iloc[0]
            axis.set_title(name if unit == "1" else f"{name}\n({unit})")
        figure.text(0.005, 1 - 0.02 / figure.get_figheight(), title, va="top", fontweight="bold")
        _legend(figure, bands)
    return figure


def _draw(axes: Axes, table: pd.DataFrame, band: pd.DataFrame, sessions: list[str], colour: str) -> None:
    unit = table["unit"].iloc[0]
    own = table[table["session"].isin(sessions) & table["estimate"].notna()]
    y = np.array([sessions.index(session) for session in own["session"]])
    estimate, low, high = from_si(own[["estimate", "low", "high"]].to_numpy(float), unit).T
    for row in from_si(band[["estimate", "low", "high"]].to_numpy(float), unit):
        axes.axvspan(row[1], row[2], color=BAND, lw=0)
        axes.axvline(row[0], color=GREY, lw=0.9)
    axes.hlines(y, low, high, color=colour)
    axes.plot(estimate, y, ls="", marker="o", color=colour)
    if own.empty and band.empty:
        axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", va="center", color=GREY)
        axes.set_xticks([])
    axes.set_yticks(range(len(sessions)), [shorten(name, LONGEST_NAME) for name in sessions])
    axes.set_ylim(len(sessions) - 0.4, -0.6)
    axes.margins(x=0.15)
    axes.locator_params(axis="x", nbins=4)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.grid(visible=False, axis="y")


def _legend(figure: Figure, bands: pd.DataFrame) -> None:
    entries = [key_line("session, bar 95 %", GREY, marker="o", line="-")]
    if len(bands):
        entries.append(key_line("campaign, 95 %", BAND, line="-"))
        entries[-1].set_linewidth(6)
    below_title = 1 - LEGEND_LINE / figure.get_figheight()
    legend(figure, entries, below_title)
