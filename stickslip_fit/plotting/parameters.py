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
from scipy.ndimage import gaussian_filter
from scipy.stats import f as fisher
from scipy.stats import gaussian_kde
from scipy.stats import t as student_t

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import join_words as listed
from stickslip_fit._format import joint_name
from stickslip_fit._format import pluralize as count
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.estimation import JointFit, Result
from stickslip_fit.estimation.prediction import control_chart
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    FIGURE_WIDTH,
    GREY,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    TITLE_LINE,
    DisplayedFigure,
    add_legend,
    grid_height,
    make_figure,
    make_grid,
    make_legend_entry,
    report_style,
    set_white_background,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.bayes import Posterior

CONTROL_MAX_SESSIONS = 30
MAX_SESSION_LABELS = 12  # session names that an axis has room for
MAX_BAR_LENGTH = 2.5  # of the spread of the estimates: bars and limits that say little are cut there
PANEL_HEIGHT = 1.15  # inches
MARGINS = {
    "left": 0.62, "right": 0.08, "top": 2 * TITLE_LINE + 0.10, "bottom": 0.85, "across": 0.58, "down": 0.12
}  # fmt: skip
LIMITS_COLOUR, LATEST_LIMITS_COLOUR = "#e4e4e0", "#c4c4be"
OUTSIDE_LABEL = "outside"


def control_picture(joint: int, fit: Result) -> Picture:
    """How the parameters of a joint change from session to session, and when that is more than usual."""
    key, title = f"parameters-{joint}", f"Parameters of {joint_name(joint)} by session"
    chart = control_chart(fit)
    chart = chart[chart["joint"] == joint]
    sessions = list(fit.joints[joint].groups["session"].unique())
    if len(sessions) < 2:
        return make_missing_picture(key, title, "It would need a second session.")
    if chart.empty:
        return make_missing_picture(key, title, "It would need a session in which a parameter can be known.")
    return make_picture(key, title, _write_caption(chart, sessions), draw_control(fit, chart))


def plot_control(result: Result) -> Figure:
    """The chart of all joints of a result."""
    chart = control_chart(result)
    if chart.empty:
        raise InputError(
            "no parameter is known in any session, so there is nothing to chart; see the remarks"
        )
    return set_white_background(draw_control(result, chart))


def draw_control(result: Result, chart: pd.DataFrame) -> Figure:
    """One block for each joint of the chart: directions down, parameters across."""
    joints = list(chart["joint"].unique())
    blocks = [
        (
            result.joints[joint].groups["session"].unique()[-CONTROL_MAX_SESSIONS:],
            chart[chart["joint"] == joint],
        )
        for joint in joints
    ]
    with report_style():
        talls = [_figure_height(subset) for _, subset in blocks]
        ratios = [LEGEND_LINE + 0.08, *talls]
        figure = DisplayedFigure(figsize=(FIGURE_WIDTH, sum(ratios)))
        top, *parts = figure.subfigures(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0]
        add_legend(top, _legend_entries(chart))
        for part, (sessions, subset) in zip(parts, blocks, strict=True):
            _draw_control_joint(part, subset[subset["session"].isin(sessions)], list(sessions))
    return figure


def _figure_height(chart: pd.DataFrame) -> float:
    return grid_height(
        [PANEL_HEIGHT] * chart["direction"].nunique(), MARGINS["top"], MARGINS["bottom"], MARGINS["down"]
    )


def _legend_entries(chart: pd.DataFrame) -> list[Line2D]:
    entries = [make_legend_entry("session, bar 95 %", GREY, marker="o", line="-")]
    if chart["expected_low"].notna().any():
        expected = make_legend_entry(
            "expected from the sessions before (99 %)", LATEST_LIMITS_COLOUR, line="-"
        )
        expected.set_linewidth(6)
        entries += [expected, make_legend_entry(OUTSIDE_LABEL, INK, marker="X")]
    return entries


def _draw_control_joint(part: SubFigure, chart: pd.DataFrame, sessions: list[str]) -> None:
    names, directions = chart["name"].unique(), [sign for sign in "+-" if (chart["direction"] == sign).any()]
    axes = make_grid(
        part, [PANEL_HEIGHT] * len(directions), len(names), **MARGINS, share_x=True, share_y=False
    )
    part.suptitle(
        joint_name(int(chart["joint"].iloc[0])), x=0.0, y=1.0, ha="left", va="top", fontweight="bold"
    )
    for row, sign in enumerate(directions):
        for column, name in enumerate(names):
            subset = chart[(chart["name"] == name) & (chart["direction"] == sign)]
            _draw_control_panel(axes[row, column], subset, sessions, DIRECTION_COLOURS[sign])
        axes[row, 0].set_ylabel(f"direction {way(sign)}")
    for column, name in enumerate(names):
        unit = chart.loc[chart["name"] == name, "unit"].iloc[0]
        axes[0, column].set_title(name if unit == "1" else f"{name} ({unit})")
        _label_sessions(axes[-1, column], sessions)


def _draw_control_panel(axes: Axes, chart: pd.DataFrame, sessions: list[str], colour: str) -> None:
    axes.set_xlim(-0.5, len(sessions) - 0.5)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(visible=False, axis="x")
    if chart.empty:
        axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", va="center", color=GREY)
        axes.set_yticks([])
        return
    unit = chart["unit"].iloc[0]
    x = np.array([sessions.index(session) for session in chart["session"]])
    numbers = chart[["estimate", "low", "high", "expected_low", "expected_high"]]
    y, low, high, expected_low, expected_high = from_si(numbers.to_numpy(float), unit).T
    latest = x == len(sessions) - 1
    for which, shade in ((~latest, LIMITS_COLOUR), (latest, LATEST_LIMITS_COLOUR)):
        axes.bar(
            x[which], (expected_high - expected_low)[which], 1.0, expected_low[which], color=shade, lw=0.4
        )
    axes.vlines(x, low, high, color=colour, lw=0.7)
    odd = chart["surprising"].to_numpy(bool)
    axes.plot(x[~odd], y[~odd], ls="", marker="o", color=colour)
    axes.plot(x[odd], y[odd], ls="", marker="X", ms=6.0, mec="white", mew=0.5, color=INK)
    _limit_view(axes, y, np.concatenate([low, high, expected_low, expected_high]))


def _limit_view(axes: Axes, y: np.ndarray, ends: np.ndarray) -> None:
    """Estimates decide what is in view: what hardly anything is known of must not flatten all else."""
    ends = ends[np.isfinite(ends)]
    room = MAX_BAR_LENGTH * np.ptp(y) if len(y) > 1 and np.ptp(y) > 0 else np.inf
    low = max(min(ends, default=y.min()), y.min() - room)
    high = min(max(ends, default=y.max()), y.max() + room)
    low, high = min(low, y.min()), max(high, y.max())
    margin = 0.08 * (high - low) if high > low else 0.01 * abs(high) or 1.0
    axes.set_ylim(low - margin, high + margin)


def _label_sessions(axes: Axes, sessions: list[str]) -> None:
    every = -(-len(sessions) // MAX_SESSION_LABELS)
    places = list(range(len(sessions) - 1, -1, -every))
    axes.set_xticks(places, [shorten(str(sessions[k]), 12) for k in places], rotation=90)


def _write_caption(chart: pd.DataFrame, sessions: list[str]) -> str:
    shown = sessions[-CONTROL_MAX_SESSIONS:]
    latest = "" if shown == sessions else f"The latest {len(shown)} of "
    points = (
        f"{latest}{count(len(sessions), 'session')} in order of time, each parameter by least squares over "
        "all the session's traverses; bars: 95 %, cut short where they would hide the rest."
    )
    told = chart[chart["expected_low"].notna()]
    if told.empty:
        return f"{points} Limits, from what the sessions before lead one to expect, begin with the fourth."
    band = (
        "Grey: where the sessions before it lead one to expect it, dark for the latest; in 99 of 100 "
        "sessions all parameters lie there."
    )
    return f"{points} {band} {_describe_outliers(told[told['session'].isin(shown)], shown[-1])}"


def _describe_outliers(told: pd.DataFrame, latest: str) -> str:
    odd = told[told["surprising"]]
    if odd.empty:
        return f"Of {count(len(told), 'point')} with limits none is outside."
    outside = (
        f"Of {count(len(told), 'point')} with limits {len(odd):,} {'is' if len(odd) == 1 else 'are'} outside"
    )
    today = odd[odd["session"] == latest]
    if today.empty:
        return f"{outside} (crosses), none of them in the latest session."
    names = listed([f"{row.name} ({way(row.direction)})" for row in today.itertuples(index=False)])
    return f"{outside} (crosses); in the latest session {names}: calibrate again, or look for what changed."


FOREST_MAX_SESSIONS = 24
LINE_HEIGHT = 0.15  # inches a session
MAX_NAME_LENGTH = 18
BAND_COLOUR = "#d9d9d4"


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
    shown = sessions[-FOREST_MAX_SESSIONS:]
    title = joint_name(joint)
    if len(shown) < len(sessions):
        title += f", the latest {len(shown)} of {len(sessions):,} sessions"
    return set_white_background(draw_forest(table, bands, shown, title))


def draw_forest(table: pd.DataFrame, bands: pd.DataFrame, sessions: list[str], title: str) -> Figure:
    """Directions and, within them, sessions down, the latest at the bottom; parameters across."""
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
                    each[(each["name"] == name) & (each["direction"] == sign)] for each in (table, bands)
                )
                _draw_forest_panel(axes[row, column], subset, band, sessions, DIRECTION_COLOURS[sign])
            axes[row, 0].set_ylabel(f"direction {way(sign)}")
        for axis, name in zip(axes[0], names, strict=True):
            unit = table.loc[table["name"] == name, "unit"].iloc[0]
            axis.set_title(name if unit == "1" else f"{name}\n({unit})")
        figure.text(0.005, 1 - 0.02 / figure.get_figheight(), title, va="top", fontweight="bold")
        _add_forest_legend(figure, bands)
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
        axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", va="center", color=GREY)
        axes.set_xticks([])
    axes.set_yticks(range(len(sessions)), [shorten(name, MAX_NAME_LENGTH) for name in sessions])
    axes.set_ylim(len(sessions) - 0.4, -0.6)
    axes.margins(x=0.15)
    axes.locator_params(axis="x", nbins=4)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.grid(visible=False, axis="y")


def _add_forest_legend(figure: Figure, bands: pd.DataFrame) -> None:
    entries = [make_legend_entry("session, bar 95 %", GREY, marker="o", line="-")]
    if len(bands):
        entries.append(make_legend_entry("campaign, 95 %", BAND_COLOUR, line="-"))
        entries[-1].set_linewidth(6)
    below_title = 1 - LEGEND_LINE / figure.get_figheight()
    add_legend(figure, entries, below_title)


REGION_LEVELS = (0.68, 0.95)
MAX_CELL_SIZE = 1.55  # inches
VIEW_HALF_WIDTH = 4.0  # standard errors in view
N_BINS, SMOOTHING_BINS = 36, 1.2  # of a histogram in two dimensions, and its blur in bins


@dataclass(frozen=True, eq=False)
class CornerData:
    """What a fit knows of p parameters, in people's units.

    Attributes
    ----------
    labels : tuple of str
    centre, error : array, shape (p,)
    interval : array, shape (p, 2)
        95 %.
    title, kind : str
        Of which session, and what the curves are.
    colour : str
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
    fit, index, which = _find_group(result, joint, direction, session)
    cloud = _make_corner_data(fit, index, which, "from the covariance (Student's t, ellipses)")
    factor = cloud.error / np.sqrt(np.diagonal(fit.covariance[index])[which])
    covariance = fit.covariance[index][np.ix_(which, which)] * factor * factor[:, None]
    df = fit.repeatability[direction].df
    with report_style():
        figure, axes = _draw_corner(cloud, [make_legend_entry("68 % and 95 %", cloud.colour, line="-")])
        for k in range(len(which)):
            x = cloud.centre[k] + cloud.error[k] * np.linspace(-VIEW_HALF_WIDTH, VIEW_HALF_WIDTH, 201)
            density = student_t.pdf(x, df, cloud.centre[k], cloud.error[k])
            axes[k, k].plot(x, density, color=cloud.colour)
            for j in range(k):
                for level in REGION_LEVELS:
                    x, y = _compute_ellipse(cloud.centre, covariance, [j, k], level, df)
                    axes[k, j].plot(x, y, color=cloud.colour)
                axes[k, j].plot(cloud.centre[j], cloud.centre[k], "+", color=INK)
    return set_white_background(figure)


def plot_draws_corner(posterior: Posterior, joint: int, direction: str, session: str | None = None) -> Figure:
    """Histograms of a posterior's draws over the prior's; see `Posterior.plot_corner`."""
    fit, index, which = _find_group(posterior.result, joint, direction, session)
    name = str(fit.groups["session"].iloc[index])
    cloud = _make_corner_data(fit, index, which, "draws of the posterior")
    place = posterior.sessions(joint, direction).index(name)
    scale = cloud.error / np.sqrt(np.diagonal(fit.covariance[index])[which])
    draws = posterior.draws(joint, direction, "parameters")[:, place, which] * scale
    prior = posterior.prior_draws(joint, direction, "parameters")[:, place, which] * scale
    entries = [
        make_legend_entry("68 % and 95 %", cloud.colour, line="-"),
        make_legend_entry("prior", GREY, line=":"),
    ]
    with report_style():
        figure, axes = _draw_corner(cloud, entries)
        for k in range(len(which)):
            axes[k, k].hist(draws[:, k], N_BINS, density=True, color=cloud.colour, alpha=0.35)
            low, high = axes[k, k].get_xlim()
            x = np.linspace(low, high, 201)
            axes[k, k].plot(x, gaussian_kde(prior[:, k])(x), color=GREY, ls=":")
            for j in range(k):
                _draw_contours(axes[k, j], draws[:, j], draws[:, k], cloud.colour)
    return set_white_background(figure)


def _find_group(
    result: Result, joint: int, direction: str, session: str | None
) -> tuple[JointFit, int, npt.NDArray[np.intp]]:
    """A joint's fit, the group of a session and direction, and which of its parameters have error bars."""
    fit = result.joints.get(joint)
    if fit is None or not (fit.groups["direction"] == direction).any():
        fitted = ", ".join(
            f"{joint} {sign}"
            for joint, each in result.joints.items()
            for sign in each.groups["direction"].unique()
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


def _make_corner_data(fit: JointFit, index: int, which: npt.NDArray[np.intp], kind: str) -> CornerData:
    parameters = [fit.law.parameters[k] for k in which]
    numbers = np.column_stack(
        [fit.values[index], np.sqrt(np.diagonal(fit.covariance[index])), fit.interval[index]]
    )[which]
    shown = np.array(
        [from_si(row, each.unit) for row, each in zip(numbers, parameters, strict=True)], dtype=float
    )
    session, sign = (str(fit.groups[name].iloc[index]) for name in ("session", "direction"))
    return CornerData(
        labels=tuple(each.name if each.unit == "1" else f"{each.name} ({each.unit})" for each in parameters),
        centre=shown[:, 0],
        error=shown[:, 1],
        interval=shown[:, 2:],
        title=f"{joint_name(fit.law.joint)}, direction {way(sign)}\nsession {shorten(session, 30)}",
        kind=kind,
        colour=DIRECTION_COLOURS[sign],
    )


def _draw_corner(cloud: CornerData, entries: Sequence[Line2D]) -> tuple[Figure, npt.NDArray[np.object_]]:
    """Empty axes that show what lies within reach, labelled; the 95 % intervals marked."""
    p = len(cloud.labels)
    left, across = 0.75, 0.12
    cell = min((FIGURE_WIDTH - left - 0.1 - across * (p - 1)) / p, MAX_CELL_SIZE)
    rest = FIGURE_WIDTH - left - cell * p - across * (p - 1)
    figure, axes = make_figure(
        [cell] * p, p, left=left, right=rest, top=0.12, bottom=0.45, across=across, down=across,
        share_x=False, share_y=False,
    )  # fmt: skip
    low, high = cloud.centre - VIEW_HALF_WIDTH * cloud.error, cloud.centre + VIEW_HALF_WIDTH * cloud.error
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
                for end in cloud.interval[row]:
                    axis.axvline(end, color=INK, lw=0.7, ls="--")
            else:
                axis.set_ylim(low[row], high[row])
                axis.tick_params(axis="y", labelleft=column == 0)
        axes[-1, row].set_xlabel(cloud.labels[row])
        if row:
            axes[row, 0].set_ylabel(cloud.labels[row])
    figure.align_ylabels(axes[:, 0])
    _annotate_corner(figure, cloud, entries, (left + cell + 0.25) / FIGURE_WIDTH)
    return figure, axes


def _annotate_corner(figure: Figure, cloud: CornerData, entries: Sequence[Line2D], x: float) -> None:
    """Title and legend in the upper right, where a corner plot has nothing to show."""
    top = 1 - 0.1 / figure.get_figheight()
    figure.text(x, top, cloud.title, va="top", fontweight="bold", linespacing=1.4)
    figure.legend(
        handles=[*entries, make_legend_entry("95 % interval", INK, line="--")],
        title=cloud.kind,
        title_fontsize=7.5,
        alignment="left",
        loc="upper left",
        bbox_to_anchor=(x - 0.01, top - 0.36 / figure.get_figheight()),
    )


def _compute_ellipse(
    centre: Array, covariance: Array, pair: list[int], level: float, df: int
) -> tuple[Array, Array]:
    """The edge of the region that holds both parameters of a pair with the given probability."""
    size = np.sqrt(2.0 * fisher.ppf(level, 2, df))
    values, vectors = np.linalg.eigh(covariance[np.ix_(pair, pair)])
    turn = np.linspace(0.0, 2 * np.pi, 181)
    circle = np.sqrt(np.maximum(values, 0.0))[:, None] * np.stack([np.cos(turn), np.sin(turn)])
    x, y = centre[pair][:, None] + size * vectors @ circle
    return x, y


def _draw_contours(axes: Axes, x: Array, y: Array, colour: str) -> None:
    """Lines around the densest 68 and 95 % of draws."""
    counts, x_edges, y_edges = np.histogram2d(x, y, N_BINS, [axes.get_xlim(), axes.get_ylim()])
    density = gaussian_filter(counts, SMOOTHING_BINS)
    places = [
        np.clip(np.digitize(draws, edges) - 1, 0, N_BINS - 1) for draws, edges in ((x, x_edges), (y, y_edges))
    ]
    around = [float(np.quantile(density[places[0], places[1]], 1 - level)) for level in REGION_LEVELS[::-1]]
    middles = [(each[1:] + each[:-1]) / 2 for each in (x_edges, y_edges)]
    axes.contour(*middles, density.T, levels=around, colors=colour)
