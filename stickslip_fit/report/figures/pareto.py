"""What accuracy costs: calibration time against the error of traverses that were not calibrated on."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from stickslip_fit.errors import InputError
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LEGEND_LINE,
    MARKERS,
    PURPLE,
    TITLE_LINE,
    VERMILLION,
    canvas,
    key_line,
    legend,
    legend_rows,
    look,
    plain_log,
)
from stickslip_fit.report.wording import joint_name, plain
from stickslip_fit.strategies import Comparison

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE)
KEY, TITLE = "pareto", "What accuracy costs: calibration time against held-out error"
MINUTES = (1, 3, 10, 30, 100, 300, 1000)
SIDE_BY_SIDE = 1.07  # factor by which strategies that cost the same are set apart


def pareto_picture(found: Comparison) -> Picture:
    """Each strategy's cost and error; the Cramer-Rao bound and the repeatability floor."""
    if not found.joints:
        return not_drawn(KEY, TITLE, "It would need a session that every strategy can calibrate.")
    caption = (
        "Rms error of traverses that no strategy calibrates from, with 95 % intervals, over the time that a "
        "session's calibration takes in both directions. The further down and left, the better. Solid: the "
        "least that any unbiased calibration from as many traverses of today can reach under the law "
        "(Cramer-Rao, the best choice of traverses). Dashed: repeatability, which no law can beat. What "
        "looks back on other sessions may lie below the solid line."
    )
    return picture(KEY, TITLE, caption, draw_pareto(found))


def plot_pareto(found: Comparison) -> Figure:
    """The chart by itself.

    Raises
    ------
    InputError
        If no session is shared.
    """
    if not found.joints:
        raise InputError("there is nothing to draw: no session is left in which the strategies are compared")
    return on_white(draw_pareto(found))


def draw_pareto(found: Comparison) -> Figure:
    """One panel for each joint."""
    accuracy = found.accuracy().merge(found.cost(), on=["joint", "strategy"], suffixes=("", "_made"))
    marks = {name: _mark(place) for place, name in enumerate(found.strategies)}
    with look():
        drawn = set(accuracy["strategy"])
        entries = [key_line(name, *mark) for name, mark in marks.items() if name in drawn]
        entries += [key_line("Cramer-Rao bound", INK, line="-"), key_line("repeatability", GREY, line="--")]
        top = legend_rows(entries) * LEGEND_LINE + TITLE_LINE + 0.14
        figure, axes = canvas([2.6], len(found.joints), top=top, bottom=0.5, across=0.42, share_y="none")
        for axis, joint in zip(axes[0], found.joints, strict=True):
            axis.set_title(joint_name(joint))
            _draw_limits(axis, found.bounds[found.bounds["joint"] == joint])
            plain_log(axis, MINUTES)
            _draw_strategies(axis, accuracy[accuracy["joint"] == joint], marks)
            axis.set_yscale("log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
            axis.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
        axes[0, 0].set_ylabel("rms error of the mean step size (%)")
        figure.supxlabel("calibration time of a session (min)", y=0.02, va="bottom", size=8, color=INK)
        legend(figure, entries)
    return figure


def _draw_limits(axis: Axes, bounds: pd.DataFrame) -> None:
    if bounds.empty:
        return
    axis.plot(bounds["seconds"] / 60, 100 * bounds["rms_relative"], color=INK, marker=".", ms=3.0)
    axis.axhline(100 * float(bounds["floor_relative"].iloc[0]), color=GREY, ls="--", lw=0.9)


def _draw_strategies(axis: Axes, table: pd.DataFrame, marks: dict[str, tuple[str, str]]) -> None:
    minutes = _apart(table["seconds"].to_numpy(float) / 60)
    for at, (_, row) in zip(minutes, table.iterrows(), strict=True):
        colour, marker = marks[str(row["strategy"])]
        rms, low, high = (100 * float(row[f"rms_relative{end}"]) for end in ("", "_low", "_high"))
        if np.isfinite(low):
            axis.vlines(at, low, high, color=colour, lw=0.8)
        axis.plot(at, rms, ls="", marker=marker, ms=4.5, color=colour)
    axis.set_xlim(minutes.min() / 1.3, minutes.max() * 1.3)


def _apart(minutes: np.ndarray) -> np.ndarray:
    """Times spread a little, so that no strategy hides another that costs the same."""
    apart = minutes.copy()
    for place in range(len(apart)):
        while np.any(np.abs(np.log(apart[place] / apart[:place])) < np.log(SIDE_BY_SIDE) - 1e-9):
            apart[place] *= SIDE_BY_SIDE
    return apart


def _mark(place: int) -> tuple[str, str]:
    return COLOURS[place % len(COLOURS)], MARKERS[place // len(COLOURS) % len(MARKERS)]
