"""Figures of calibration strategies: error against cost, tip errors, studies; spectra of tunings."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from stickslip_fit._format import format_plain as plain
from stickslip_fit._format import format_value, joint_name
from stickslip_fit._format import pluralize as count
from stickslip_fit.capture.tuning import MAX_RELATIVE_FREQUENCY, MIN_FREQUENCY, Tuning
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.plotting._style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    MARKERS,
    PURPLE,
    TITLE_LINE,
    VERMILLION,
    add_legend,
    count_legend_rows,
    make_figure,
    make_legend_entry,
    report_style,
    set_log_ticks,
    set_white_background,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture
from stickslip_fit.strategies import Comparison, TipErrors
from stickslip_fit.studies import SimulationStudy
from stickslip_fit.units import JOINTS, from_si

STRATEGY_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE)
MINUTE_TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
TIME_MARGIN = 1.3  # factor of time beyond the cheapest and the dearest
MIN_SEPARATION = 0.012  # of the figure's width: so far apart stand strategies that cost the same


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
    return make_picture(f"pareto-{joint}", title, caption, draw_pareto(found, [joint]))


def plot_pareto(found: Comparison) -> Figure:
    """The chart by itself, a panel for each joint.

    Raises
    ------
    InputError
        If no session is shared.
    """
    if not found.joints:
        raise InputError("there is nothing to draw: no session is left in which the strategies are compared")
    return set_white_background(draw_pareto(found, found.joints))


def draw_pareto(found: Comparison, joints: Sequence[int]) -> Figure:
    """Panels side by side, each with a scale of its own."""
    accuracy = found.accuracy().merge(found.cost(), on=["joint", "strategy"], suffixes=("", "_made"))
    accuracy = accuracy[accuracy["joint"].isin(joints)]
    marks = {name: _choose_marker(place) for place, name in enumerate(found.strategies)}
    with report_style():
        drawn = set(accuracy["strategy"])
        entries = [make_legend_entry(name, *mark) for name, mark in marks.items() if name in drawn]
        entries += [
            make_legend_entry("Cramer-Rao bound", INK, line="-"),
            make_legend_entry("repeatability", GREY, line="--"),
        ]
        top = count_legend_rows(entries) * LEGEND_LINE + TITLE_LINE + 0.14
        figure, axes = make_figure([2.6], len(joints), top=top, bottom=0.5, across=0.42, share_y="none")
        for axis, joint in zip(axes[0], joints, strict=True):
            axis.set_title(joint_name(joint))
            _draw_limits(axis, found.bounds[found.bounds["joint"] == joint])
            set_log_ticks(axis, MINUTE_TICKS)
            _draw_strategies(axis, accuracy[accuracy["joint"] == joint], marks, len(joints))
            axis.set_yscale("log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
            axis.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
        axes[0, 0].set_ylabel("rms error of the mean step size (%)")
        figure.supxlabel("calibration time of a session (min)", y=0.02, va="bottom", size=8, color=INK)
        add_legend(figure, entries)
    return figure


def _draw_limits(axis: Axes, bounds: pd.DataFrame) -> None:
    if bounds.empty:
        return
    axis.plot(bounds["seconds"] / 60, 100 * bounds["rms_relative"], color=INK, marker=".", ms=3.0)
    axis.axhline(100 * float(bounds["floor_relative"].iloc[0]), color=GREY, ls="--", lw=0.9)


def _draw_strategies(axis: Axes, table: pd.DataFrame, marks: dict[str, tuple[str, str]], panels: int) -> None:
    minutes = table["seconds"].to_numpy(float) / 60
    shown = np.log(minutes.max() / minutes.min() * TIME_MARGIN**2)
    minutes = _separate_times(minutes, MIN_SEPARATION * panels * shown)
    for at, (_, row) in zip(minutes, table.iterrows(), strict=True):
        colour, marker = marks[str(row["strategy"])]
        rms, low, high = (100 * float(row[f"rms_relative{end}"]) for end in ("", "_low", "_high"))
        if np.isfinite(low):
            axis.vlines(at, low, high, color=colour, lw=0.8)
        axis.plot(at, rms, ls="", marker=marker, ms=4.5, color=colour)
    axis.set_xlim(minutes.min() / TIME_MARGIN, minutes.max() * TIME_MARGIN)


def _separate_times(minutes: np.ndarray, gap: float) -> np.ndarray:
    """Times moved as little as keeps their logarithms a gap apart, so that no strategy hides another."""
    from scipy.optimize import isotonic_regression

    order = np.argsort(minutes, kind="stable")
    steps = gap * np.arange(len(minutes))
    apart = np.empty(len(minutes))
    apart[order] = np.exp(isotonic_regression(np.log(minutes[order]) - steps).x + steps)
    return apart


def _choose_marker(place: int) -> tuple[str, str]:
    return STRATEGY_COLOURS[place % len(STRATEGY_COLOURS)], MARKERS[
        place // len(STRATEGY_COLOURS) % len(MARKERS)
    ]


TIP_KEY, TIP_TITLE = "tip-errors", "Where the tip ends after open-loop moves"
JOINT_COLOURS = dict(zip(JOINTS, (VERMILLION, GREEN, PURPLE), strict=True))
BOX_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
MAX_NAME_LENGTH = 40
TIP_LINE_HEIGHT = 0.19  # inches a strategy
MIN_LENGTH = 1e-8  # m; below, a logarithmic axis would show nothing but luck


def tip_errors_picture(found: TipErrors) -> Picture:
    """The distribution of each strategy's errors, and which joint they come from."""
    summary = found.distribution().dropna(subset="rms")
    if summary.empty:
        return make_missing_picture(
            TIP_KEY, TIP_TITLE, "It would need a strategy that calibrates every joint that is driven."
        )
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
    return make_picture(TIP_KEY, TIP_TITLE, caption, draw_tip_errors(found))


def plot_tip_errors(found: TipErrors) -> Figure:
    """The chart by itself.

    Raises
    ------
    InputError
        If no strategy moved the tip.
    """
    if found.table["size"].isna().all():
        raise InputError("there is nothing to draw: no strategy calibrates every joint that is driven")
    return set_white_background(draw_tip_errors(found))


def draw_tip_errors(found: TipErrors) -> Figure:
    """A line for each strategy: errors on the left, shares of the joints on the right."""
    summary = found.distribution().dropna(subset="rms")
    names = [shorten(str(name), MAX_NAME_LENGTH) for name in summary["strategy"]]
    with report_style():
        entries = [
            make_legend_entry("median", BLUE, "o"),
            make_legend_entry("half of the moves", BLUE, line="-"),
            make_legend_entry("nine in ten", BLUE, line="-"),
            make_legend_entry("worst", BLUE, "x"),
            *(
                make_legend_entry(f"joint {joint}", colour, line="-")
                for joint, colour in JOINT_COLOURS.items()
            ),
        ]
        for entry, width in zip(entries[1:3] + entries[4:], (4.0, 1.0, 6.0, 6.0, 6.0), strict=True):
            entry.set_linewidth(width)
        left = 0.2 + LETTER_WIDTH * max(map(len, names))
        top = count_legend_rows(entries) * LEGEND_LINE + 0.08
        figure, axes = make_figure(
            [TIP_LINE_HEIGHT * len(names) + 0.1], 2, left=left, right=0.2, top=top, bottom=0.45, share_x=False
        )
        errors, shares = axes[0]
        _draw_errors(errors, found.table, list(summary["strategy"]))
        _draw_shares(shares, summary)
        errors.set_yticks(range(len(names)), names)
        errors.set_ylim(len(names) - 0.4, -0.6)
        for axis in (errors, shares):
            axis.grid(visible=False, axis="y")
            axis.tick_params(axis="y", length=0)
        add_legend(figure, entries)
    return figure


def _draw_errors(axis: Axes, table: pd.DataFrame, strategies: list[str]) -> None:
    for place, name in enumerate(strategies):
        size = table.loc[table["strategy"] == name, "size"].dropna().to_numpy()
        low, early, middle, late, high = from_si(
            np.maximum(np.quantile(size, BOX_QUANTILES), MIN_LENGTH), "µm"
        )
        axis.hlines(place, low, high, color=BLUE, lw=1.0)
        axis.hlines(place, early, late, color=BLUE, lw=4.0)
        axis.plot(middle, place, ls="", marker="o", ms=4.0, color=BLUE, mec="white", mew=0.6, zorder=3)
        axis.plot(from_si(max(size.max(), MIN_LENGTH), "µm"), place, ls="", marker="x", color=BLUE)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0,)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("tip from where it should be (µm)", color=INK)


def _draw_shares(axis: Axes, summary: pd.DataFrame) -> None:
    places, before = np.arange(len(summary)), np.zeros(len(summary))
    for joint, colour in JOINT_COLOURS.items():
        share = 100 * summary[f"share_{joint}"].to_numpy(float)
        axis.barh(places, share, left=before, height=0.55, color=colour, lw=0)
        before = before + share
    axis.set_xlim(0, 100)
    axis.set_xlabel("share in the mean square (%)", color=INK)


FAINT_COLOUR = "#b0b0b0"
STUDY_LINE_HEIGHT = 0.16  # inches, of a strategy


def plot_study_errors(found: SimulationStudy) -> Figure:
    """The chart of errors by itself."""
    return set_white_background(draw_study_errors(found))


def plot_study_tips(found: SimulationStudy) -> Figure:
    """The chart of the tip's errors by itself.

    Raises
    ------
    InputError
        If the study made no moves.
    """
    if found.tips().empty:
        raise InputError("there is nothing to draw: the study made no moves; give a count under [moves]")
    return set_white_background(draw_study_tips(found))


def draw_study_errors(found: SimulationStudy) -> Figure:
    """A row for each scenario, a column for each joint."""
    table, names = found.accuracy(), [strategy.name for strategy in found.plan.strategies]
    marks = {name: _choose_marker(place) for place, name in enumerate(names)}
    with report_style():
        entries = [make_legend_entry(name, *mark) for name, mark in marks.items()]
        entries.append(make_legend_entry("good enough", GREY, line="--"))
        entries.append(
            make_legend_entry(f"from {shorten(found.scenarios[0], MAX_NAME_LENGTH)}", FAINT_COLOUR, line="-")
        )
        figure, axes = make_figure(
            [1.05] * len(found.scenarios), len(found.joints), top=_top_margin(entries) + 0.1, bottom=0.5,
            down=0.28, across=0.42, share_x="col", share_y="col",
        )  # fmt: skip
        for scenario, row in zip(found.scenarios, axes, strict=True):
            name = shorten(scenario, MAX_NAME_LENGTH)
            row[0].annotate(name, (0, 1), (0, 4), "axes fraction", "offset points", weight="bold", color=INK)
            for joint, axis in zip(found.joints, row, strict=True):
                subset = table[table["joint"] == joint]
                _draw_scenario(axis, subset, scenario, found.scenarios[0], marks)
                axis.axhline(100 * found.plan.good_enough, color=GREY, ls="--", lw=0.9)
        for joint, axis in zip(found.joints, axes[0], strict=True):
            axis.set_title(joint_name(joint), pad=17.0)
        figure.supxlabel("calibration time of a session (min)", y=0.01, va="bottom", size=8, color=INK)
        figure.supylabel("rms error of the mean step size (%)", x=0.005, ha="left", size=8, color=INK)
        add_legend(figure, entries)
    return figure


def draw_study_tips(found: SimulationStudy) -> Figure:
    """A panel for each scenario, a line for each strategy."""
    table = found.tips()
    names = list(dict.fromkeys(table["strategy"]))
    with report_style():
        entries = [
            make_legend_entry("half of the moves end within", INK, "o"),
            make_legend_entry("95 % of them, in the median campaign", BLUE, "o"),
            make_legend_entry("in nine campaigns of ten", BLUE, line="-"),
        ]
        entries[0].set_markerfacecolor("none")
        longest = max(len(shorten(name, MAX_NAME_LENGTH)) for name in names)
        figure, axes = make_figure(
            [STUDY_LINE_HEIGHT * len(names) + 0.1] * len(found.scenarios), 1, left=0.2 + LETTER_WIDTH * longest,
            top=_top_margin(entries), bottom=0.45, down=0.1 + TITLE_LINE, share_x="all", share_y=False,
        )  # fmt: skip
        for scenario, axis in zip(found.scenarios, axes[:, 0], strict=True):
            axis.set_title(shorten(scenario, MAX_NAME_LENGTH), loc="left", color=INK, fontweight="bold")
            subset = table[table["scenario"] == scenario].set_index("strategy").reindex(names)
            _draw_tip_panel(axis, subset, names)
        last = axes[-1, 0]
        last.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        last.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
        last.xaxis.set_minor_locator(NullLocator())
        last.set_xlabel(
            f"tip from where it should be after {plain(from_si(found.plan.length, 'mm'))} mm (µm)"
        )
        add_legend(figure, entries)
    return figure


def _draw_scenario(
    axis: Axes, table: pd.DataFrame, scenario: str, first: str, marks: dict[str, tuple[str, str]]
) -> None:
    set_log_ticks(axis, MINUTE_TICKS)
    before = table[table["scenario"] == first].set_index("strategy")["rms_relative"]
    # All scenarios at the same place, so that what is hidden only moves a strategy up.
    minutes = table.groupby("strategy")["seconds"].mean() / 60
    for _, row in table[table["scenario"] == scenario].iterrows():
        name = str(row["strategy"])
        colour, marker = marks[name]
        rms, low, high = (100 * float(row[f"rms_relative{end}"]) for end in ("", "_low", "_high"))
        axis.vlines(minutes[name], 100 * before[name], rms, color=FAINT_COLOUR, lw=1.2)
        if np.isfinite(low):
            axis.vlines(minutes[name], low, high, color=colour, lw=0.8)
        axis.plot(minutes[name], rms, ls="", marker=marker, ms=4.5, color=colour)
    axis.set_xlim(minutes.min() / 1.4, minutes.max() * 1.4)
    axis.set_yscale("log")
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_locator(NullLocator())
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))


def _draw_tip_panel(axis: Axes, table: pd.DataFrame, names: Sequence[str]) -> None:
    places = np.arange(len(names))[::-1]
    shown = from_si(table[["median", "often", "often_low", "often_high"]].to_numpy(float), "µm")
    median, often, low, high = shown.T
    axis.hlines(places, low, high, color=BLUE, lw=1.0)
    axis.plot(often, places, ls="", marker="o", ms=4.0, color=BLUE)
    axis.plot(median, places, ls="", marker="o", ms=4.0, color=INK, mfc="none")
    axis.set_xscale("log")
    axis.set_yticks(places, [shorten(name, MAX_NAME_LENGTH) for name in names])
    axis.set_ylim(-0.6, len(names) - 0.4)


def _top_margin(entries: Sequence[Line2D]) -> float:
    return count_legend_rows(entries) * LEGEND_LINE + TITLE_LINE + 0.14


SMOOTHING_HZ = 100.0  # Hz: what is drawn is averaged over so much
CAPTION_LINE_HEIGHT, CAPTION_LETTERS = 0.14, 118  # inches, and letters in a line


def plot_spectrum(tuning: Tuning) -> Figure:
    """Spectra above, their difference below with the tuned band and the limit; the finding as a caption."""
    shown = (tuning.frequencies >= MIN_FREQUENCY / 2) & (
        tuning.frequencies <= MAX_RELATIVE_FREQUENCY * tuning.rate
    )
    kilohertz = tuning.frequencies[shown] / 1000
    moving, at_stop = (_to_decibels(spectrum, tuning)[shown] for spectrum in (tuning.moving, tuning.at_stop))
    limit = 10 * np.log10(tuning.limits.pair_threshold[-1])
    caption = textwrap.wrap(tuning.conclusion, CAPTION_LETTERS)
    with report_style():
        entries = [
            make_legend_entry("moving", BLUE, line="-"),
            make_legend_entry("at the stop", VERMILLION, line="--"),
            make_legend_entry("limit, mean over the band", INK, line=":"),
        ]
        top = count_legend_rows(entries) * LEGEND_LINE + 0.14
        figure, axes = make_figure(
            [1.9, 1.2], 1, top=top, bottom=0.55 + CAPTION_LINE_HEIGHT * len(caption), share_x="col"
        )
        above, below = axes[:, 0]
        above.plot(kilohertz, moving, color=BLUE, lw=0.9)
        above.plot(kilohertz, at_stop, color=VERMILLION, lw=0.9, ls="--")
        above.set_ylabel("power (dB of full scale / Hz)")
        below.plot(kilohertz, at_stop - moving, color=INK, lw=0.9)
        below.axhline(0.0, color=GREY, lw=0.8)
        low, high = (tuning.frequency + side * tuning.width / 2 for side in (-1, 1))
        below.plot([low / 1000, high / 1000], [limit, limit], color=INK, ls=":", lw=1.4)
        for axis in (above, below):
            axis.axvspan(low / 1000, high / 1000, color=GREY, alpha=0.2, lw=0)
        below.set_ylabel("stop less moving (dB)")
        below.set_xlabel("frequency (kHz); shaded: the tuned band")
        below.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        above.set_xlim(kilohertz[0], kilohertz[-1])
        figure.align_ylabels(axes[:, 0])
        figure.text(0.02, 0.02, "\n".join(caption), va="bottom", size=7.5, color=INK)
        add_legend(figure, entries)
    return set_white_background(figure)


def _to_decibels(spectrum: np.ndarray, tuning: Tuning) -> np.ndarray:
    bins = max(round(SMOOTHING_HZ * tuning.seconds), 1)
    even = np.convolve(np.pad(spectrum, bins, mode="edge"), np.ones(bins) / bins, mode="same")[bins:-bins]
    return 10 * np.log10(even)
