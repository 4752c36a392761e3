"""How far the tip ends from where open-loop moves were to take it, and which joint does it."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from stickslip_fit._format import format_plain as plain
from stickslip_fit._format import format_value
from stickslip_fit._format import pluralize as count
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.machine import JOINTS
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    BLUE,
    GREEN,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    PURPLE,
    VERMILLION,
    canvas,
    key_line,
    legend,
    legend_rows,
    look,
)
from stickslip_fit.strategies.tip import TipErrors
from stickslip_fit.units import from_si

KEY, TITLE = "tip-errors", "Where the tip ends after open-loop moves"
COLOURS = dict(zip(JOINTS, (VERMILLION, GREEN, PURPLE), strict=True))
AT = (0.05, 0.25, 0.5, 0.75, 0.95)
LONGEST_NAME = 40
LINE = 0.19  # inches a strategy
SMALLEST = 1e-8  # m; below, a logarithmic axis would show nothing but luck


def tip_errors_picture(found: TipErrors) -> Picture:
    """The distribution of each strategy's errors, and which joint they come from."""
    summary = found.distribution().dropna(subset="rms")
    if summary.empty:
        return not_drawn(KEY, TITLE, "It would need a strategy that calibrates every joint that is driven.")
    one = found.table["strategy"] == summary["strategy"].iloc[0]
    best, worst = (
        f"{format_value(row['often'], 'µm', 1)} with {row['strategy']}"
        for row in (summary.loc[summary["often"].idxmin()], summary.loc[summary["often"].idxmax()])
    )
    caption = (
        f"{count(int(one.sum()), 'move')} with each strategy's steps. The further left, the better: in one "
        f"move of twenty the tip is off by more than {best}, and by more than {worst}. Right: what each "
        "joint has in the mean square."
    )
    return picture(KEY, TITLE, caption, draw_tip_errors(found))


def plot_tip_errors(found: TipErrors) -> Figure:
    """The chart by itself.

    Raises
    ------
    InputError
        If no strategy moved the tip.
    """
    if found.table["size"].isna().all():
        raise InputError("there is nothing to draw: no strategy calibrates every joint that is driven")
    return on_white(draw_tip_errors(found))


def draw_tip_errors(found: TipErrors) -> Figure:
    """A line for each strategy: errors on the left, shares of the joints on the right."""
    summary = found.distribution().dropna(subset="rms")
    names = [shorten(str(name), LONGEST_NAME) for name in summary["strategy"]]
    with look():
        entries = [
            key_line("median", BLUE, "o"),
            key_line("half of the moves", BLUE, line="-"),
            key_line("nine in ten", BLUE, line="-"),
            key_line("worst", BLUE, "x"),
            *(key_line(f"joint {joint}", colour, line="-") for joint, colour in COLOURS.items()),
        ]
        for entry, width in zip(entries[1:3] + entries[4:], (4.0, 1.0, 6.0, 6.0, 6.0), strict=True):
            entry.set_linewidth(width)
        left = 0.2 + LETTER_WIDTH * max(map(len, names))
        top = legend_rows(entries) * LEGEND_LINE + 0.08
        figure, axes = canvas(
            [LINE * len(names) + 0.1], 2, left=left, right=0.2, top=top, bottom=0.45, share_x=False
        )
        errors, shares = axes[0]
        _draw_errors(errors, found.table, list(summary["strategy"]))
        _draw_shares(shares, summary)
        errors.set_yticks(range(len(names)), names)
        errors.set_ylim(len(names) - 0.4, -0.6)
        for axis in (errors, shares):
            axis.grid(visible=False, axis="y")
            axis.tick_params(axis="y", length=0)
        legend(figure, entries)
    return figure


def _draw_errors(axis: Axes, table: pd.DataFrame, strategies: list[str]) -> None:
    for place, name in enumerate(strategies):
        size = table.loc[table["strategy"] == name, "size"].dropna().to_numpy()
        low, early, middle, late, high = from_si(np.maximum(np.quantile(size, AT), SMALLEST), "µm")
        axis.hlines(place, low, high, color=BLUE, lw=1.0)
        axis.hlines(place, early, late, color=BLUE, lw=4.0)
        axis.plot(middle, place, ls="", marker="o", ms=4.0, color=BLUE, mec="white", mew=0.6, zorder=3)
        axis.plot(from_si(max(size.max(), SMALLEST), "µm"), place, ls="", marker="x", color=BLUE)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0,)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("tip from where it should be (µm)", color=INK)


def _draw_shares(axis: Axes, summary: pd.DataFrame) -> None:
    places, before = np.arange(len(summary)), np.zeros(len(summary))
    for joint, colour in COLOURS.items():
        share = 100 * summary[f"share_{joint}"].to_numpy(float)
        axis.barh(places, share, left=before, height=0.55, color=colour, lw=0)
        before = before + share
    axis.set_xlim(0, 100)
    axis.set_xlabel("share in the mean square (%)", color=INK)
