"""What accuracy costs: calibration time against the error of traverses that were not calibrated on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from stickslip_fit._format import format_plain as plain
from stickslip_fit._format import joint_name
from stickslip_fit.errors import InputError
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.picture import Picture, picture
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
from stickslip_fit.strategies import Comparison

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE)
MINUTES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
MARGIN = 1.3  # factor of time beyond the cheapest and the dearest
SIDE_BY_SIDE = 0.012  # of the figure's width: so far apart stand strategies that cost the same


def pareto_picture(found: Comparison, joint: int) -> Picture:
    """Each strategy's cost and error for a joint; the Cramer-Rao bound and the repeatability floor."""
    caption = (
        "Rms error of traverses that no strategy calibrates from, with 95 % intervals, over the time that a "
        "session's calibration takes in both directions; strategies that cost the same are set a little "
        "apart. The further down and left, the better. Solid: the least that any unbiased calibration from "
        "as many traverses of today can reach under the law (Cramer-Rao, the best choice of traverses). "
        "Dashed: repeatability. Below either line lies what was lucky in this log; below the solid one also "
        "what looks back on other sessions."
    )
    title = f"What accuracy costs, {joint_name(joint)}: calibration time against held-out error"
    return picture(f"pareto-{joint}", title, caption, draw_pareto(found, [joint]))


def plot_pareto(found: Comparison) -> Figure:
    """The chart by itself, a panel for each joint.

    Raises
    ------
    InputError
        If no session is shared.
    """
    if not found.joints:
        raise InputError("there is nothing to draw: no session is left in which the strategies are compared")
    return on_white(draw_pareto(found, found.joints))


def draw_pareto(found: Comparison, joints: Sequence[int]) -> Figure:
    """Panels side by side, each with a scale of its own."""
    accuracy = found.accuracy().merge(found.cost(), on=["joint", "strategy"], suffixes=("", "_made"))
    accuracy = accuracy[accuracy["joint"].isin(joints)]
    marks = {name: _mark(place) for place, name in enumerate(found.strategies)}
    with look():
        drawn = set(accuracy["strategy"])
        entries = [key_line(name, *mark) for name, mark in marks.items() if name in drawn]
        entries += [key_line("Cramer-Rao bound", INK, line="-"), key_line("repeatability", GREY, line="--")]
        top = legend_rows(entries) * LEGEND_LINE + TITLE_LINE + 0.14
        figure, axes = canvas([2.6], len(joints), top=top, bottom=0.5, across=0.42, share_y="none")
        for axis, joint in zip(axes[0], joints, strict=True):
            axis.set_title(joint_name(joint))
            _draw_limits(axis, found.bounds[found.bounds["joint"] == joint])
            plain_log(axis, MINUTES)
            _draw_strategies(axis, accuracy[accuracy["joint"] == joint], marks, len(joints))
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


def _draw_strategies(axis: Axes, table: pd.DataFrame, marks: dict[str, tuple[str, str]], panels: int) -> None:
    minutes = table["seconds"].to_numpy(float) / 60
    shown = np.log(minutes.max() / minutes.min() * MARGIN**2)
    minutes = _apart(minutes, SIDE_BY_SIDE * panels * shown)
    for at, (_, row) in zip(minutes, table.iterrows(), strict=True):
        colour, marker = marks[str(row["strategy"])]
        rms, low, high = (100 * float(row[f"rms_relative{end}"]) for end in ("", "_low", "_high"))
        if np.isfinite(low):
            axis.vlines(at, low, high, color=colour, lw=0.8)
        axis.plot(at, rms, ls="", marker=marker, ms=4.5, color=colour)
    axis.set_xlim(minutes.min() / MARGIN, minutes.max() * MARGIN)


def _apart(minutes: np.ndarray, gap: float) -> np.ndarray:
    """Times moved as little as keeps their logarithms a gap apart, so that no strategy hides another."""
    from scipy.optimize import isotonic_regression

    order = np.argsort(minutes, kind="stable")
    steps = gap * np.arange(len(minutes))
    apart = np.empty(len(minutes))
    apart[order] = np.exp(isotonic_regression(np.log(minutes[order]) - steps).x + steps)
    return apart


def _mark(place: int) -> tuple[str, str]:
    return COLOURS[place % len(COLOURS)], MARKERS[place // len(COLOURS) % len(MARKERS)]
