"""Figures of calibration strategies: error against cost, tip errors, studies; spectra of tunings."""

from __future__ import annotations

import textwrap
from collections.abc import Hashable, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stickslip_fit._format import format_plain, joint_name
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.plotting._style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LETTER_WIDTH,
    MARKERS,
    PURPLE,
    TITLE_LINE,
    VERMILLION,
    make_figure,
    make_legend_entry,
    report_style,
    set_log_axis,
)
from stickslip_fit.plotting._svg import Picture, make_picture
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.capture.tuning import Tuning
    from stickslip_fit.strategies import Comparison
    from stickslip_fit.studies import SimulationStudy

STRATEGY_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE)
MINUTE_TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
TIME_MARGIN = 1.3  # factor of time beyond the cheapest and the dearest
MIN_SEPARATION = 0.012  # of the figure's width, between strategies that cost the same
MAX_NAME_LENGTH = 40


def pareto_picture(comparison: Comparison) -> Picture:
    """Each strategy's cost and error for each joint; the Cramer-Rao bound and the replicate scatter."""
    caption = (
        "The further down and left, the better; bars: 95 %. Solid: the least that any unbiased calibration "
        "from as many traverses of today can reach under the law (Cramer-Rao). Dashed: replicate scatter, or "
        "residual scatter for want of replicates. Below a line lies what was lucky in this log; below the "
        "solid one also what looks back on other sessions."
    )
    title = "What accuracy costs: calibration time against held-out error"
    return make_picture("pareto", title, caption, plot_pareto(comparison))


def plot_pareto(comparison: Comparison) -> Figure:
    """A panel for each joint, with a scale of its own.

    Raises
    ------
    InputError
        If no session is shared.
    """
    joints = comparison.joints
    if not joints:
        raise InputError("there is nothing to draw: no session is left in which the strategies are compared")
    cost = comparison.cost()
    accuracy = comparison.accuracy().merge(cost, on=["joint", "strategy"], suffixes=("", "_made"))
    accuracy = accuracy[accuracy["joint"].isin(joints)]
    markers = _choose_markers(comparison.strategies)
    drawn = set(accuracy["strategy"])
    with report_style():
        legend = [
            *(make_legend_entry(name, *marker) for name, marker in markers.items() if name in drawn),
            make_legend_entry("Cramer-Rao bound", INK, line="-"),
            make_legend_entry("replicate scatter", GREY, line="--"),
        ]
        figure, axes = make_figure(
            [2.2], len(joints), legend, top=TITLE_LINE + 0.14, bottom=0.5, across=0.42, share_y="none"
        )
        for axis, joint in zip(axes[0], joints, strict=True):
            axis.set_title(joint_name(joint, comparison.machine))
            _draw_limits(axis, comparison.bounds[comparison.bounds["joint"] == joint])
            set_log_axis(axis.xaxis, ticks=MINUTE_TICKS)
            _draw_strategies(axis, accuracy[accuracy["joint"] == joint], markers, len(joints))
            set_log_axis(axis.yaxis, subs=(1.0, 2.0, 5.0))
        axes[0, 0].set_ylabel("rms error of the mean step size (%)")
        figure.supxlabel("calibration time of a session (min)", y=0.02, va="bottom", size=8, color=INK)
    return figure


def _draw_limits(axis: Axes, bounds: pd.DataFrame) -> None:
    if bounds.empty:
        return
    axis.plot(bounds["seconds"] / 60, 100 * bounds["rms_relative"], color=INK, marker=".", ms=3.0)
    axis.axhline(100 * float(bounds["floor_relative"].iloc[0]), color=GREY, ls="--", lw=0.9)


def _draw_strategies(
    axis: Axes, table: pd.DataFrame, markers: dict[str, tuple[str, str]], n_panels: int
) -> None:
    minutes = table["seconds"].to_numpy(float) / 60
    extent = np.log(minutes.max() / minutes.min() * TIME_MARGIN**2)
    minutes = _separate_times(minutes, MIN_SEPARATION * n_panels * extent)
    for x, row in zip(minutes, table.to_dict("records"), strict=True):
        _draw_strategy(axis, x, row, *markers[str(row["strategy"])])
    axis.set_xlim(minutes.min() / TIME_MARGIN, minutes.max() * TIME_MARGIN)


def _draw_strategy(axis: Axes, minutes: float, row: Mapping[Hashable, Any], colour: str, marker: str) -> None:
    """A strategy's rms error with its interval."""
    rms, low, high = (100 * float(row[f"rms_relative{end}"]) for end in ("", "_low", "_high"))
    if np.isfinite(low):
        axis.vlines(minutes, low, high, color=colour, lw=0.8)
    axis.plot(minutes, rms, ls="", marker=marker, ms=4.5, color=colour)


def _separate_times(minutes: np.ndarray, gap: float) -> np.ndarray:
    """Times moved as little as keeps their logarithms a gap apart, so that no strategy hides another."""
    from scipy.optimize import isotonic_regression

    order = np.argsort(minutes, kind="stable")
    steps = gap * np.arange(len(minutes))
    separated = np.empty(len(minutes))
    separated[order] = np.exp(isotonic_regression(np.log(minutes[order]) - steps).x + steps)
    return separated


def _choose_markers(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each strategy."""
    styles = cycle([(colour, marker) for marker in MARKERS for colour in STRATEGY_COLOURS])
    return dict(zip(names, styles, strict=False))


FAINT_COLOUR = "#b0b0b0"
STUDY_LINE_HEIGHT = 0.16  # inches, of a strategy


def plot_study_errors(study: SimulationStudy) -> Figure:
    """A row for each scenario, a column for each joint."""
    table, first = study.accuracy(), study.scenarios[0]
    markers = _choose_markers([strategy.name for strategy in study.plan.strategies])
    with report_style():
        legend = [
            *(make_legend_entry(name, *marker) for name, marker in markers.items()),
            make_legend_entry("good enough", GREY, line="--"),
            make_legend_entry(f"from {shorten(first, MAX_NAME_LENGTH)}", FAINT_COLOUR, line="-"),
        ]
        figure, axes = make_figure(
            [1.05] * len(study.scenarios),
            len(study.joints),
            legend,
            top=TITLE_LINE + 0.24,
            bottom=0.5,
            down=0.28,
            across=0.42,
            share_y="col",
        )
        for scenario, row in zip(study.scenarios, axes, strict=True):
            name = shorten(scenario, MAX_NAME_LENGTH)
            row[0].annotate(name, (0, 1), (0, 4), "axes fraction", "offset points", weight="bold", color=INK)
            for joint, axis in zip(study.joints, row, strict=True):
                _draw_scenario(axis, table[table["joint"] == joint], scenario, first, markers)
                axis.axhline(100 * study.plan.good_enough, color=GREY, ls="--", lw=0.9)
        for joint, axis in zip(study.joints, axes[0], strict=True):
            axis.set_title(joint_name(joint, study.plan.machine), pad=17.0)
        figure.supxlabel("calibration time of a session (min)", y=0.01, va="bottom", size=8, color=INK)
        figure.supylabel("rms error of the mean step size (%)", x=0.005, ha="left", size=8, color=INK)
    return figure


def plot_study_tips(study: SimulationStudy) -> Figure:
    """A panel for each scenario, a line for each strategy.

    Raises
    ------
    InputError
        If the study made no moves.
    """
    table = study.tips()
    if table.empty:
        raise InputError("there is nothing to draw: the study made no moves; give a count under [moves]")
    names = list(dict.fromkeys(table["strategy"]))
    with report_style():
        legend = [
            make_legend_entry("half of the moves end within", INK, "o"),
            make_legend_entry("95 % of them, in the median campaign", BLUE, "o"),
            make_legend_entry("in nine campaigns of ten", BLUE, line="-"),
        ]
        legend[0].set_markerfacecolor("none")
        figure, axes = make_figure(
            [STUDY_LINE_HEIGHT * len(names) + 0.1] * len(study.scenarios),
            1,
            legend,
            left=0.2 + LETTER_WIDTH * max(len(shorten(name, MAX_NAME_LENGTH)) for name in names),
            top=TITLE_LINE + 0.14,
            bottom=0.45,
            down=0.1 + TITLE_LINE,
            share_y=False,
        )
        for scenario, axis in zip(study.scenarios, axes[:, 0], strict=True):
            axis.set_title(shorten(scenario, MAX_NAME_LENGTH), loc="left", color=INK, fontweight="bold")
            subset = table[table["scenario"] == scenario].set_index("strategy").reindex(names)
            _draw_tip_panel(axis, subset, names)
        set_log_axis(axes[-1, 0].xaxis, subs=(1.0, 2.0, 5.0))
        length = format_plain(from_si(study.plan.length, "mm"))
        axes[-1, 0].set_xlabel(f"tip from where it should be after {length} mm (µm)")
    return figure


def _draw_scenario(
    axis: Axes, table: pd.DataFrame, scenario: str, first: str, markers: dict[str, tuple[str, str]]
) -> None:
    set_log_axis(axis.xaxis, ticks=MINUTE_TICKS)
    before = table[table["scenario"] == first].set_index("strategy")["rms_relative"]
    # The same place in all scenarios, so that a hidden cause moves a strategy only upwards.
    minutes = table.groupby("strategy")["seconds"].mean() / 60
    for _, row in table[table["scenario"] == scenario].iterrows():
        name = str(row["strategy"])
        change = (100 * before[name], 100 * row["rms_relative"])
        axis.vlines(minutes[name], *change, color=FAINT_COLOUR, lw=1.2)
        _draw_strategy(axis, minutes[name], row, *markers[name])
    axis.set_xlim(minutes.min() / 1.4, minutes.max() * 1.4)
    set_log_axis(axis.yaxis, subs=(1.0, 3.0))


def _draw_tip_panel(axis: Axes, table: pd.DataFrame, names: Sequence[str]) -> None:
    places = np.arange(len(names))[::-1]
    lengths = table[["median", "often", "often_low", "often_high"]].to_numpy(float)
    median, often, low, high = from_si(lengths, "µm").T
    axis.hlines(places, low, high, color=BLUE, lw=1.0)
    axis.plot(often, places, ls="", marker="o", ms=4.0, color=BLUE)
    axis.plot(median, places, ls="", marker="o", ms=4.0, color=INK, mfc="none")
    axis.set_yticks(places, [shorten(name, MAX_NAME_LENGTH) for name in names])
    axis.set_ylim(-0.6, len(names) - 0.4)


SMOOTHING_HZ = 100.0  # width of the moving average over a spectrum
CAPTION_LINE_HEIGHT, CAPTION_LETTERS = 0.14, 118  # inches, and letters in a line


def plot_spectrum(tuning: Tuning) -> Figure:
    """Spectra above, their difference below with the tuned band and the limit, and the conclusion."""
    from stickslip_fit.capture.tuning import MAX_RELATIVE_FREQUENCY, MIN_FREQUENCY

    high = MAX_RELATIVE_FREQUENCY * tuning.rate
    shown = (tuning.frequencies >= MIN_FREQUENCY / 2) & (tuning.frequencies <= high)
    kilohertz = tuning.frequencies[shown] / 1000
    moving, at_stop = (_to_decibels(spectrum, tuning)[shown] for spectrum in (tuning.moving, tuning.at_stop))
    limit = 10 * np.log10(tuning.limits.pair_threshold[-1])
    caption = textwrap.wrap(tuning.conclusion, CAPTION_LETTERS)
    with report_style():
        legend = [
            make_legend_entry("moving", BLUE, line="-"),
            make_legend_entry("at the stop", VERMILLION, line="--"),
            make_legend_entry("limit, mean over the band", INK, line=":"),
        ]
        figure, axes = make_figure([1.9, 1.2], 1, legend, bottom=0.55 + CAPTION_LINE_HEIGHT * len(caption))
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
        above.set_xlim(kilohertz[0], kilohertz[-1])
        figure.align_ylabels(axes[:, 0])
        figure.text(0.02, 0.02, "\n".join(caption), va="bottom", size=7.5, color=INK)
    return figure


def _to_decibels(spectrum: np.ndarray, tuning: Tuning) -> np.ndarray:
    bins = max(round(SMOOTHING_HZ * tuning.seconds), 1)
    padded = np.pad(spectrum, bins, mode="edge")
    return 10 * np.log10(np.convolve(padded, np.ones(bins) / bins, mode="same")[bins:-bins])
