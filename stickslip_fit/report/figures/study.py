"""Which calibration survives what: simulated campaigns, scenario by scenario."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from stickslip_fit._format import format_plain as plain
from stickslip_fit._format import joint_name
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.pareto import COLOURS, MINUTES
from stickslip_fit.report.figures.style import (
    BLUE,
    GREY,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    MARKERS,
    TITLE_LINE,
    canvas,
    key_line,
    legend,
    legend_rows,
    look,
    plain_log,
)
from stickslip_fit.strategies.study import Study
from stickslip_fit.units import from_si

LONGEST_NAME = 40
FAINT = "#b0b0b0"
LINE = 0.16  # inches, of a strategy


def plot_errors(found: Study) -> Figure:
    """The chart of errors by itself."""
    return on_white(draw_errors(found))


def plot_tips(found: Study) -> Figure:
    """The chart of the tip's errors by itself.

    Raises
    ------
    InputError
        If the study made no moves.
    """
    if found.tips().empty:
        raise InputError("there is nothing to draw: the study made no moves; give a count under [moves]")
    return on_white(draw_tips(found))


def draw_errors(found: Study) -> Figure:
    """A row for each scenario, a column for each joint."""
    table, names = found.accuracy(), [strategy.name for strategy in found.plan.strategies]
    marks = {name: _mark(place) for place, name in enumerate(names)}
    with look():
        entries = [key_line(name, *mark) for name, mark in marks.items()]
        entries.append(key_line("good enough", GREY, line="--"))
        entries.append(key_line(f"from {shorten(found.scenarios[0], LONGEST_NAME)}", FAINT, line="-"))
        figure, axes = canvas(
            [1.05] * len(found.scenarios), len(found.joints), top=_top(entries) + 0.1, bottom=0.5,
            down=0.28, across=0.42, share_x="col", share_y="col",
        )  # fmt: skip
        for scenario, row in zip(found.scenarios, axes, strict=True):
            name = shorten(scenario, LONGEST_NAME)
            row[0].annotate(name, (0, 1), (0, 4), "axes fraction", "offset points", weight="bold", color=INK)
            for joint, axis in zip(found.joints, row, strict=True):
                mine = table[table["joint"] == joint]
                _draw_scenario(axis, mine, scenario, found.scenarios[0], marks)
                axis.axhline(100 * found.plan.good_enough, color=GREY, ls="--", lw=0.9)
        for joint, axis in zip(found.joints, axes[0], strict=True):
            axis.set_title(joint_name(joint), pad=17.0)
        figure.supxlabel("calibration time of a session (min)", y=0.01, va="bottom", size=8, color=INK)
        figure.supylabel("rms error of the mean step size (%)", x=0.005, ha="left", size=8, color=INK)
        legend(figure, entries)
    return figure


def draw_tips(found: Study) -> Figure:
    """A panel for each scenario, a line for each strategy."""
    table = found.tips()
    names = list(dict.fromkeys(table["strategy"]))
    with look():
        entries = [
            key_line("half of the moves end within", INK, "o"),
            key_line("95 % of them, in the median campaign", BLUE, "o"),
            key_line("in nine campaigns of ten", BLUE, line="-"),
        ]
        entries[0].set_markerfacecolor("none")
        longest = max(len(shorten(name, LONGEST_NAME)) for name in names)
        figure, axes = canvas(
            [LINE * len(names) + 0.1] * len(found.scenarios), 1, left=0.2 + LETTER_WIDTH * longest,
            top=_top(entries), bottom=0.45, down=0.1 + TITLE_LINE, share_x="all", share_y=False,
        )  # fmt: skip
        for scenario, axis in zip(found.scenarios, axes[:, 0], strict=True):
            axis.set_title(shorten(scenario, LONGEST_NAME), loc="left", color=INK, fontweight="bold")
            mine = table[table["scenario"] == scenario].set_index("strategy").reindex(names)
            _draw_tips(axis, mine, names)
        last = axes[-1, 0]
        last.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        last.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
        last.xaxis.set_minor_locator(NullLocator())
        last.set_xlabel(
            f"tip from where it should be after {plain(from_si(found.plan.length, 'mm'))} mm (µm)"
        )
        legend(figure, entries)
    return figure


def _draw_scenario(
    axis: Axes, table: pd.DataFrame, scenario: str, first: str, marks: dict[str, tuple[str, str]]
) -> None:
    plain_log(axis, MINUTES)
    before = table[table["scenario"] == first].set_index("strategy")["rms_relative"]
    # All scenarios at the same place, so that what is hidden only moves a strategy up.
    minutes = table.groupby("strategy")["seconds"].mean() / 60
    for _, row in table[table["scenario"] == scenario].iterrows():
        name = str(row["strategy"])
        colour, marker = marks[name]
        rms, low, high = (100 * float(row[f"rms_relative{end}"]) for end in ("", "_low", "_high"))
        axis.vlines(minutes[name], 100 * before[name], rms, color=FAINT, lw=1.2)
        if np.isfinite(low):
            axis.vlines(minutes[name], low, high, color=colour, lw=0.8)
        axis.plot(minutes[name], rms, ls="", marker=marker, ms=4.5, color=colour)
    axis.set_xlim(minutes.min() / 1.4, minutes.max() * 1.4)
    axis.set_yscale("log")
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_locator(NullLocator())
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))


def _draw_tips(axis: Axes, table: pd.DataFrame, names: Sequence[str]) -> None:
    places = np.arange(len(names))[::-1]
    shown = from_si(table[["median", "often", "often_low", "often_high"]].to_numpy(float), "µm")
    median, often, low, high = shown.T
    axis.hlines(places, low, high, color=BLUE, lw=1.0)
    axis.plot(often, places, ls="", marker="o", ms=4.0, color=BLUE)
    axis.plot(median, places, ls="", marker="o", ms=4.0, color=INK, mfc="none")
    axis.set_xscale("log")
    axis.set_yticks(places, [shorten(name, LONGEST_NAME) for name in names])
    axis.set_ylim(-0.6, len(names) - 0.4)


def _top(entries: Sequence[Line2D]) -> float:
    return legend_rows(entries) * LEGEND_LINE + TITLE_LINE + 0.14


def _mark(place: int) -> tuple[str, str]:
    return COLOURS[place % len(COLOURS)], MARKERS[place // len(COLOURS) % len(MARKERS)]
