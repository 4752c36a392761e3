"""Figures of fitted parameters: control chart by session, forest plot, corner plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from scipy.special import fdtri

from stickslip_fit._format import format_direction, join_words, joint_name, pluralize
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.estimation import JointFit, Result
from stickslip_fit.estimation.prediction import control_chart, has_order
from stickslip_fit.machine import Machine
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    FIGURE_WIDTH,
    GREY,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    MAX_SESSIONS,
    TITLE_LINE,
    DisplayedFigure,
    add_legend,
    grid_height,
    label_sessions,
    make_figure,
    make_grid,
    make_legend_entry,
    report_style,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.bayes import Posterior

MAX_BAR_LENGTH = 2.5  # times the range of the estimates: longer bars and limits are cut
PANEL_HEIGHT, TOP, BOTTOM, DOWN = 1.15, 2 * TITLE_LINE + 0.10, 0.85, 0.12  # inches
LIMITS_COLOUR, LATEST_LIMITS_COLOUR = "#e4e4e0", "#c4c4be"
OUTSIDE_LABEL = "outside"


def control_picture(joint: int, fit: Result, note: str = "") -> Picture:
    """The control chart of one joint's parameters, session by session; `note` ends its caption."""
    key, title = f"parameters-{joint}", f"Parameters of {joint_name(joint, fit.machine)} by session"
    chart = control_chart(fit)
    chart = chart[chart["joint"] == joint]
    sessions = list(fit.joints[joint].groups["session"].unique())
    if len(sessions) < 2:
        return make_missing_picture(key, title, "It would need a second session.")
    if chart.empty:
        return make_missing_picture(key, title, "It would need a session in which a parameter can be known.")
    caption = f"{_write_caption(chart, sessions, has_order(fit))} {note}".rstrip()
    return make_picture(key, title, caption, draw_control(fit, chart))


def plot_control(result: Result) -> Figure:
    """The control chart of all joints of a result."""
    chart = control_chart(result)
    if chart.empty:
        raise InputError(
            "no parameter is known in any session, so there is nothing to chart; see the remarks"
        )
    return draw_control(result, chart)


def draw_control(result: Result, chart: pd.DataFrame) -> Figure:
    """One block for each joint of the chart: directions down, parameters across."""
    blocks = [
        (list(result.joints[int(joint)].groups["session"].unique()[-MAX_SESSIONS:]), subset)
        for joint, subset in chart.groupby("joint", sort=False)
    ]
    legend = [make_legend_entry("session, bar 95 %", GREY, marker="o", line="-")]
    if chart["expected_low"].notna().any():
        label = "expected from the sessions before (99 %)"
        legend += [
            make_legend_entry(label, LATEST_LIMITS_COLOUR, line="-", width=6.0),
            make_legend_entry(OUTSIDE_LABEL, INK, marker="X"),
        ]
    heights = [
        grid_height([PANEL_HEIGHT] * subset["direction"].nunique(), TOP, BOTTOM, DOWN) for _, subset in blocks
    ]
    with report_style():
        heights.insert(0, LEGEND_LINE + 0.08)
        figure = DisplayedFigure(figsize=(FIGURE_WIDTH, sum(heights)))
        top, *parts = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
        add_legend(top, legend)
        for part, (sessions, subset) in zip(parts, blocks, strict=True):
            name = joint_name(int(subset["joint"].iloc[0]), result.machine)
            _draw_control_joint(part, name, subset[subset["session"].isin(sessions)], sessions)
    return figure


def _draw_control_joint(part: SubFigure, title: str, chart: pd.DataFrame, sessions: list[str]) -> None:
    names, directions = chart["name"].unique(), [sign for sign in "+-" if (chart["direction"] == sign).any()]
    axes = make_grid(
        part,
        [PANEL_HEIGHT] * len(directions),
        len(names),
        left=0.62,
        right=0.08,
        top=TOP,
        bottom=BOTTOM,
        across=0.58,
        down=DOWN,
        share_x=True,
        share_y=False,
    )
    part.suptitle(title, x=0.005, y=1.0, ha="left", va="top", fontweight="bold")
    for row, sign in enumerate(directions):
        for column, name in enumerate(names):
            subset = chart[(chart["name"] == name) & (chart["direction"] == sign)]
            _draw_control_panel(axes[row, column], subset, sessions, DIRECTION_COLOURS[sign])
        axes[row, 0].set_ylabel(f"direction {format_direction(sign)}")
    for column, name in enumerate(names):
        unit = chart.loc[chart["name"] == name, "unit"].iloc[0]
        axes[0, column].set_title(name if unit == "1" else f"{name} ({unit})")
        label_sessions(axes[-1, column], sessions)


def _draw_control_panel(axes: Axes, chart: pd.DataFrame, sessions: list[str], colour: str) -> None:
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(visible=False, axis="x")
    if chart.empty:
        _write_not_known(axes)
        axes.set_yticks([])
        return
    unit = chart["unit"].iloc[0]
    x = np.array([sessions.index(session) for session in chart["session"]])
    numbers = chart[["estimate", "low", "high", "expected_low", "expected_high"]]
    y, low, high, expected_low, expected_high = from_si(numbers.to_numpy(float), unit).T
    latest = x == len(sessions) - 1
    for selected, shade in ((~latest, LIMITS_COLOUR), (latest, LATEST_LIMITS_COLOUR)):
        height, bottom = (expected_high - expected_low)[selected], expected_low[selected]
        axes.bar(x[selected], height, 1.0, bottom, color=shade, lw=0.4)
    axes.vlines(x, low, high, color=colour, lw=0.7)
    outside = chart["surprising"].to_numpy(bool)
    axes.plot(x[~outside], y[~outside], ls="", marker="o", color=colour)
    axes.plot(x[outside], y[outside], ls="", marker="X", ms=6.0, mec="white", mew=0.5, color=INK)
    _limit_view(axes, y, np.concatenate([low, high, expected_low, expected_high]))


def _write_not_known(axes: Axes) -> None:
    axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", va="center", color=GREY)


def _limit_view(axes: Axes, y: np.ndarray, ends: np.ndarray) -> None:
    """Limits from the estimates, so that one long bar does not flatten the others."""
    ends = ends[np.isfinite(ends)]
    extent = MAX_BAR_LENGTH * np.ptp(y) if len(y) > 1 and np.ptp(y) > 0 else np.inf
    low = max(min(ends, default=y.min()), y.min() - extent)
    high = min(max(ends, default=y.max()), y.max() + extent)
    low, high = min(low, y.min()), max(high, y.max())
    margin = 0.08 * (high - low) if high > low else 0.01 * abs(high) or 1.0
    axes.set_ylim(low - margin, high + margin)


def _write_caption(chart: pd.DataFrame, sessions: list[str], in_order: bool) -> str:
    recent = sessions[-MAX_SESSIONS:]
    of_latest = "" if recent == sessions else f"The latest {len(recent)} of "
    order = "in order of time" if in_order else "whose order is not known"
    points = (
        f"{of_latest}{pluralize(len(sessions), 'session')} {order}, each parameter by least squares "
        "over all the session's traverses; bars: 95 %, cut short where they would hide the rest."
    )
    limited = chart[chart["expected_low"].notna()]
    if not in_order:
        return points
    if limited.empty:
        return f"{points} Limits, from what the sessions before lead one to expect, begin with the fourth."
    band = (
        "Grey: where the sessions before it lead one to expect it, dark for the latest; in 99 of 100 "
        "sessions all parameters lie there."
    )
    return f"{points} {band} {_describe_outliers(limited[limited['session'].isin(recent)], recent[-1])}"


def _describe_outliers(limited: pd.DataFrame, latest: str) -> str:
    outside = limited[limited["surprising"]]
    points = f"Of {pluralize(len(limited), 'point')} with limits"
    if outside.empty:
        return f"{points} none is outside."
    points += f" {len(outside):,} {'is' if len(outside) == 1 else 'are'} outside (crosses)"
    today = outside[outside["session"] == latest].itertuples(index=False)
    names = join_words([f"{row.name} ({format_direction(row.direction)})" for row in today])
    if not names:
        return f"{points}, none of them in the latest session."
    return f"{points}; in the latest session {names}: calibrate again, or look for what changed."


FOREST_MAX_SESSIONS = 24
LINE_HEIGHT = 0.15  # inches a session
MAX_NAME_LENGTH = 18
BAND_COLOUR = "#d9d9d4"


def plot_forest(result: Result, joint: int, campaign: pd.DataFrame | None = None) -> Figure:
    """One joint's parameters across; directions and, within them, sessions down, the latest at the bottom.

    Parameters
    ----------
    campaign : DataFrame, optional
        Means of the campaign: name, joint, direction, estimate, low, high, SI.

    Raises
    ------
    InputError
        If the joint was not fitted.
    """
    if joint not in result.joints:
        raise InputError(f"joint {joint} was not fitted; this result knows joints {list(result.joints)}")
    table = result.si.parameters
    table = table[table["joint"] == joint]
    bands = table[table["session"].isna()]
    if campaign is not None:
        bands = pd.concat([bands, campaign[campaign["joint"] == joint]])
    sessions = [str(name) for name in result.joints[joint].groups["session"].unique()]
    title = joint_name(joint, result.machine)
    if len(sessions) > FOREST_MAX_SESSIONS:
        title += f", the latest {FOREST_MAX_SESSIONS} of {len(sessions):,} sessions"
        sessions = sessions[-FOREST_MAX_SESSIONS:]
    names = list(table["name"].unique())
    directions = [sign for sign in "+-" if (table["direction"] == sign).any()]
    longest = max(min(len(name), MAX_NAME_LENGTH) for name in sessions)
    with report_style():
        figure, axes = make_figure(
            [LINE_HEIGHT * len(sessions) + 0.15] * len(directions),
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
                subset, band = (
                    rows[(rows["name"] == name) & (rows["direction"] == sign)] for rows in (table, bands)
                )
                _draw_forest_panel(axes[row, column], subset, band, sessions, DIRECTION_COLOURS[sign])
            axes[row, 0].set_ylabel(f"direction {format_direction(sign)}")
        for axis, name in zip(axes[0], names, strict=True):
            unit = table.loc[table["name"] == name, "unit"].iloc[0]
            axis.set_title(name if unit == "1" else f"{name}\n({unit})")
        figure.text(0.005, 1 - 0.02 / figure.get_figheight(), title, va="top", fontweight="bold")
        legend = [make_legend_entry("session, bar 95 %", GREY, marker="o", line="-")]
        if len(bands):
            legend.append(make_legend_entry("campaign, 95 %", BAND_COLOUR, line="-", width=6.0))
        add_legend(figure, legend, top=1 - LEGEND_LINE / figure.get_figheight())
    return figure


def _draw_forest_panel(
    axes: Axes, table: pd.DataFrame, band: pd.DataFrame, sessions: list[str], colour: str
) -> None:
    unit = table["unit"].iloc[0]
    own = table[table["session"].isin(sessions) & table["estimate"].notna()]
    y = np.array([sessions.index(session) for session in own["session"]])
    estimate, low, high = from_si(own[["estimate", "low", "high"]].to_numpy(float), unit).T
    for row in from_si(band[["estimate", "low", "high"]].to_numpy(float), unit):
        axes.axvspan(row[1], row[2], color=BAND_COLOUR, lw=0)
        axes.axvline(row[0], color=GREY, lw=0.9)
    axes.hlines(y, low, high, color=colour)
    axes.plot(estimate, y, ls="", marker="o", color=colour)
    if own.empty and band.empty:
        _write_not_known(axes)
        axes.set_xticks([])
    axes.set_yticks(range(len(sessions)), [shorten(name, MAX_NAME_LENGTH) for name in sessions])
    axes.set_ylim(len(sessions) - 0.4, -0.6)
    axes.margins(x=0.15)
    axes.locator_params(axis="x", nbins=4)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.grid(visible=False, axis="y")


REGION_LEVELS = (0.68, 0.95)
MAX_CELL_SIZE = 1.55  # inches
VIEW_HALF_WIDTH = 4.0  # standard errors in view
N_BINS, SMOOTHING_BINS = 36, 1.2  # of a histogram in two dimensions, and its blur in bins


@dataclass(frozen=True, eq=False)
class CornerData:
    """Estimates of p parameters, in the labels' units.

    Attributes
    ----------
    centre, error : array, shape (p,)
    interval : array, shape (p, 2)
        95 %.
    title, kind : str
        Of which session, and what the curves are.
    """

    labels: tuple[str, ...]
    centre: Array
    error: Array
    interval: Array
    title: str
    kind: str
    colour: str


def plot_covariance_corner(result: Result, joint: int, direction: str, session: str | None = None) -> Figure:
    """Regions and curves that a result's covariance gives; see `Result.plot_corner`."""
    from scipy.stats import t as student_t

    fit, index, which = _find_group(result, joint, direction, session)
    data = _make_corner_data(result.machine, fit, index, which, "from the covariance (Student's t, ellipses)")
    factor = data.error / np.sqrt(np.diagonal(fit.covariance[index])[which])
    covariance = fit.covariance[index][np.ix_(which, which)] * factor * factor[:, None]
    df = fit.repeatability[direction].df
    with report_style():
        figure, axes = _draw_corner(data, [make_legend_entry("68 % and 95 %", data.colour, line="-")])
        for k in range(len(which)):
            x = data.centre[k] + data.error[k] * np.linspace(-VIEW_HALF_WIDTH, VIEW_HALF_WIDTH, 201)
            density = student_t.pdf(x, df, data.centre[k], data.error[k])
            axes[k, k].plot(x, density, color=data.colour)
            for j in range(k):
                for level in REGION_LEVELS:
                    x, y = _compute_ellipse(data.centre, covariance, [j, k], level, df)
                    axes[k, j].plot(x, y, color=data.colour)
                axes[k, j].plot(data.centre[j], data.centre[k], "+", color=INK)
    return figure


def plot_draws_corner(posterior: Posterior, joint: int, direction: str, session: str | None = None) -> Figure:
    """Histograms of a posterior's draws over the prior's; see `Posterior.plot_corner`."""
    from scipy.stats import gaussian_kde

    fit, index, which = _find_group(posterior.result, joint, direction, session)
    name = str(fit.groups["session"].iloc[index])
    data = _make_corner_data(posterior.result.machine, fit, index, which, "draws of the posterior")
    place = posterior.sessions(joint, direction).index(name)
    scale = data.error / np.sqrt(np.diagonal(fit.covariance[index])[which])
    draws = posterior.draws(joint, direction, "parameters")[:, place, which] * scale
    prior = posterior.prior_draws(joint, direction, "parameters")[:, place, which] * scale
    entries = [
        make_legend_entry("68 % and 95 %", data.colour, line="-"),
        make_legend_entry("prior", GREY, line=":"),
    ]
    with report_style():
        figure, axes = _draw_corner(data, entries)
        for k in range(len(which)):
            axes[k, k].hist(draws[:, k], N_BINS, density=True, color=data.colour, alpha=0.35)
            low, high = axes[k, k].get_xlim()
            x = np.linspace(low, high, 201)
            axes[k, k].plot(x, gaussian_kde(prior[:, k])(x), color=GREY, ls=":")
            for j in range(k):
                _draw_contours(axes[k, j], draws[:, j], draws[:, k], data.colour)
    return figure


def _find_group(
    result: Result, joint: int, direction: str, session: str | None
) -> tuple[JointFit, int, npt.NDArray[np.intp]]:
    """A joint's fit, the group of a session and direction, and which of its parameters have error bars."""
    fit = result.joints.get(joint)
    if fit is None or not (fit.groups["direction"] == direction).any():
        fitted = ", ".join(
            f"{fitted_joint} {sign}"
            for fitted_joint, joint_fit in result.joints.items()
            for sign in joint_fit.groups["direction"].unique()
        )
        raise InputError(f"joint {joint}, direction {direction} was not fitted; fitted were {fitted}")
    subset = np.flatnonzero(fit.groups["direction"] == direction)
    names = [str(name) for name in fit.groups["session"].iloc[subset]]
    if session is not None and session not in names:
        raise InputError(f"session {session!r} was not fitted; sessions fitted: {', '.join(names)}")
    index = int(subset[names.index(session) if session is not None else -1])
    which = np.flatnonzero(fit.known[index] & (np.diagonal(fit.covariance[index]) > 0))
    if not len(which):
        reasons = [
            flag.message for flag in result.flags if (flag.joint, flag.direction) == (joint, direction)
        ]
        raise InputError(reasons[0] if reasons else "no parameter of this session has an error bar")
    return fit, index, which


def _make_corner_data(
    machine: Machine, fit: JointFit, index: int, which: npt.NDArray[np.intp], kind: str
) -> CornerData:
    parameters = [fit.law.parameters[k] for k in which]
    numbers = np.column_stack(
        [fit.values[index], np.sqrt(np.diagonal(fit.covariance[index])), fit.interval[index]]
    )[which]
    centre, error, *interval = np.array(
        [from_si(row, parameter.unit) for row, parameter in zip(numbers, parameters, strict=True)], float
    ).T
    session, sign = (str(fit.groups[name].iloc[index]) for name in ("session", "direction"))
    where = f"{joint_name(fit.law.joint, machine)}, direction {format_direction(sign)}"
    return CornerData(
        labels=tuple(
            parameter.name if parameter.unit == "1" else f"{parameter.name} ({parameter.unit})"
            for parameter in parameters
        ),
        centre=centre,
        error=error,
        interval=np.column_stack(interval),
        title=f"{where}\nsession {shorten(session, 30)}",
        kind=kind,
        colour=DIRECTION_COLOURS[sign],
    )


def _draw_corner(data: CornerData, entries: Sequence[Line2D]) -> tuple[Figure, npt.NDArray[np.object_]]:
    """Empty axes with limits and labels; the 95 % intervals marked."""
    p = len(data.labels)
    left, across = 0.75, 0.12
    cell = min((FIGURE_WIDTH - left - 0.1 - across * (p - 1)) / p, MAX_CELL_SIZE)
    rest = FIGURE_WIDTH - left - cell * p - across * (p - 1)
    figure, axes = make_figure(
        [cell] * p, p, left=left, right=rest, top=0.12, bottom=0.45, across=across, down=across,
        share_x=False, share_y=False,
    )  # fmt: skip
    low, high = data.centre - VIEW_HALF_WIDTH * data.error, data.centre + VIEW_HALF_WIDTH * data.error
    for row in range(p):
        for column in range(p):
            axis: Axes = axes[row, column]
            axis.set_visible(column <= row)
            axis.set_xlim(low[column], high[column])
            axis.locator_params(nbins=3)
            axis.ticklabel_format(useOffset=False)
            axis.tick_params(axis="x", labelbottom=row == p - 1)
            if column == row:
                axis.set_yticks([])
                axis.spines["left"].set_visible(False)
                for end in data.interval[row]:
                    axis.axvline(end, color=INK, lw=0.7, ls="--")
            else:
                axis.set_ylim(low[row], high[row])
                axis.tick_params(axis="y", labelleft=column == 0)
        axes[-1, row].set_xlabel(data.labels[row])
        if row:
            axes[row, 0].set_ylabel(data.labels[row])
    figure.align_ylabels(axes[:, 0])
    _annotate_corner(figure, data, entries, (left + cell + 0.25) / FIGURE_WIDTH)
    return figure, axes


def _annotate_corner(figure: Figure, data: CornerData, entries: Sequence[Line2D], x: float) -> None:
    """Title and legend in the upper right, where a corner plot has nothing to show."""
    top = 1 - 0.1 / figure.get_figheight()
    figure.text(x, top, data.title, va="top", fontweight="bold", linespacing=1.4)
    figure.legend(
        handles=[*entries, make_legend_entry("95 % interval", INK, line="--")],
        title=data.kind,
        title_fontsize=7.5,
        alignment="left",
        loc="upper left",
        bbox_to_anchor=(x - 0.01, top - 0.36 / figure.get_figheight()),
    )


def _compute_ellipse(
    centre: Array, covariance: Array, pair: list[int], level: float, df: int
) -> tuple[Array, Array]:
    """The edge of the region that holds both parameters of a pair with the given probability."""
    size = np.sqrt(2.0 * fdtri(2, df, level))
    values, vectors = np.linalg.eigh(covariance[np.ix_(pair, pair)])
    turn = np.linspace(0.0, 2 * np.pi, 181)
    circle = np.sqrt(np.maximum(values, 0.0))[:, None] * np.stack([np.cos(turn), np.sin(turn)])
    x, y = centre[pair][:, None] + size * vectors @ circle
    return x, y


def _draw_contours(axes: Axes, x: Array, y: Array, colour: str) -> None:
    """Lines around the densest 68 and 95 % of draws."""
    from scipy.ndimage import gaussian_filter

    counts, x_edges, y_edges = np.histogram2d(x, y, N_BINS, [axes.get_xlim(), axes.get_ylim()])
    density = gaussian_filter(counts, SMOOTHING_BINS)
    places = [
        np.clip(np.digitize(draws, edges) - 1, 0, N_BINS - 1) for draws, edges in ((x, x_edges), (y, y_edges))
    ]
    levels = [float(np.quantile(density[places[0], places[1]], 1 - level)) for level in REGION_LEVELS[::-1]]
    centres = [(edges[1:] + edges[:-1]) / 2 for edges in (x_edges, y_edges)]
    axes.contour(*centres, density.T, levels=levels, colors=colour)
