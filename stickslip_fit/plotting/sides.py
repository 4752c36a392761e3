"""Residuals by class of a variable, of a log or a table: before and after a finding, and over each column.

Lines are means by class with 95 % bars; the grey band is where noise alone keeps them in 95 of 100 logs or
tables in which nothing is wrong. Sizes are multiplied by the factor of their unit, see `DataInfo`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.diagnosis.finding import DataInfo, Finding
from stickslip_fit.diagnosis.linearized import rms
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.residuals import ResidualComparison, bin_residuals, bin_values
from stickslip_fit.errors import shorten
from stickslip_fit.plotting._style import (
    INK,
    TITLE_LINE,
    make_figure,
    make_legend_entry,
    report_style,
    robust_limit,
    set_angle_ticks,
)
from stickslip_fit.plotting._svg import Picture, make_picture, name_traverses
from stickslip_fit.units import Z_95

ColouredRows = Mapping[str, BoolArray]
"""Which rows are drawn in each colour, shape (n,)."""
Side = tuple[str, Array, Array]
"""Its name, residuals, shape (n,), and those of noise alone, shape (n, samples)."""

MAX_POINTS, FEW_POINTS = 500, 150  # of a colour in a panel; in all panels, drawn larger
LIMIT_QUANTILE, LIMIT_ZOOM = 0.98, 1.35  # of a scale, see `robust_limit`
MIN_LIMIT_SHARE = 0.2  # of the least limit of a scale of points, of one of means
MAX_LIMIT_RATIO = 3.0  # times the residuals after: the scale may cut those before
N_COLUMNS = 4  # panels side by side
MARGIN = 0.3  # beside the two settings of a switch, of their distance
JITTER = 0.12  # of points of one level, whose values would lie on each other
LETTERS = 110  # in all labels below panels side by side
ENVELOPE_COLOUR = "#dcdcd8"


def envelope_entry(data: str) -> Line2D:
    """The legend's entry for the grey band."""
    return make_legend_entry(f"95 % of {data}s with nothing wrong", ENVELOPE_COLOUR, line="-", width=6.0)


def choose_sides(comparison: ResidualComparison, *, without: Array | None, extended: bool) -> list[Side]:
    """Residuals before and after, or after alone where nothing extends the law.

    With the effect of a finding, shape (n,), as `without`, partial residuals stand in place of those before:
    over its own effect one finding would be hidden by all others.
    """
    after = (comparison.after, comparison.null_after)
    if without is not None:
        return [("without", comparison.after + without, comparison.null_after), ("with", *after)]
    before = [("before", comparison.before, comparison.null_before)] if extended else []
    return [*before, ("after", *after)]


def draw_sides(
    sides: Sequence[Side],
    label: str,
    values: Array,
    panels: Mapping[str, ColouredRows],
    entries: Sequence[Line2D],
    info: DataInfo,
    *,
    effect: Array | None = None,
    levels: Sequence[str] = (),
    numbers: pd.Index | None = None,
) -> Figure:
    """Sides below one another, over values of a variable, shape (n,); panels, by their titles, side by side.

    An effect, shape (n,), is dashed in the first side. Levels are the names of values 0, 1, ...; numbers are
    those of rows among the usable traverses of a log, for the page's script.
    """
    sides = [(name, info.factor * residual, info.factor * null) for name, residual, null in sides]
    with report_style():
        figure, axes = make_figure([1.5] * len(sides), len(panels), entries, top=TITLE_LINE + 0.14)
        sizes = np.abs(np.concatenate([residual for _, residual, _ in sides]))
        limit = max(robust_limit(sizes, LIMIT_QUANTILE, LIMIT_ZOOM), info.least_limit)
        for column, (title, kinds) in zip(axes.T, panels.items(), strict=True):
            column[0].set_title(title)
            _label_values(column[-1], label, values, kinds, len(panels), 4 if len(panels) > 2 else 7)
            for axis, (_, residual, null) in zip(column, sides, strict=True):
                limit = max(limit, 1.1 * draw_means(axis, values, residual, null, kinds))
            if effect is not None:
                _draw_effect(column[0], values, info.factor * effect, kinds)
        spread = np.random.default_rng(0).uniform(-JITTER, JITTER, len(values)) if levels else 0.0
        for column, kinds in zip(axes.T, panels.values(), strict=True):
            for axis, (_, residual, _) in zip(column, sides, strict=True):
                _draw_points(axis, values + spread, np.clip(residual, -limit, limit), kinds, numbers)
        for axis, (name, _, _) in zip(axes[:, 0], sides, strict=True):
            axis.set_ylim(-limit, limit)
            axis.set_ylabel(info.label(f"{name}: residual" if len(sides) > 1 else "residual"))
        if levels:
            names = [shorten(level, LETTERS // len(levels)) for level in levels]
            axes[-1, 0].set_xticks(range(len(levels)), names)
        figure.align_ylabels(axes[:, 0])
    return figure


def draw_overview(
    columns: Mapping[str, Array],
    comparison: ResidualComparison,
    kinds: ColouredRows,
    entries: Sequence[Line2D],
    info: DataInfo,
) -> Figure:
    """A panel for each column, by its label: means after, and before where that differs, dotted."""
    (_, before, null_before), (_, after, null_after) = (
        (name, info.factor * residual, info.factor * null)
        for name, residual, null in choose_sides(comparison, without=None, extended=True)
    )
    across = min(N_COLUMNS, len(columns))
    heights = [1.15] * -(-len(columns) // across)
    with report_style():
        figure, axes = make_figure(
            heights, across, entries, top=0.12, right=0.16, down=0.55, share_x="none", share_y="all"
        )
        largest, largest_before = 0.0, 0.0
        for axis, (label, values) in zip(axes.ravel(), columns.items(), strict=False):
            largest = max(largest, draw_means(axis, values, after, null_after, kinds))
            if np.any(before != after):
                size = draw_means(axis, values, before, null_before, kinds, dotted=True)
                largest_before = max(largest_before, size)
            _label_values(axis, label, values, kinds, across, 4)
        for axis in axes.ravel()[len(columns) :]:
            axis.set_axis_off()
        least = MIN_LIMIT_SHARE * info.least_limit
        limit = 1.1 * max(largest, min(largest_before, MAX_LIMIT_RATIO * largest), least)
        axes[0, 0].set_ylim(-limit, limit)
        for axis in axes[:, 0]:
            axis.set_ylabel(info.label("residual"))
    return figure


def caption_overview(comparison: ResidualComparison, rows: BoolArray, info: DataInfo) -> str:
    """What `draw_overview` shows of some rows."""
    extended = bool(np.any(comparison.before != comparison.after))
    return (
        f"Mean residuals{' with all that was found in the law' * extended}, by classes of each quantity; "
        f"{info.format_size(rms(comparison.after[rows]))} rms. Grey: where all means of a panel lie in 95 of "
        f"100 {info.data}s in which nothing is wrong."
        + " Dotted: the means under the law as it was."
        * extended
    )


def picture_sides(
    finding: Finding, title: str, over: str, above: str, left: float, info: DataInfo, figure: Figure
) -> Picture:
    """The drawn sides of a finding with a caption: what is above, and the rms that is left."""
    points = "values" if info.data == "table" else f"{info.row}s"
    caption = f"Residuals over {over}. Points: {points}; lines: means by class with 95 % bars. "
    after = f"{info.format_size(left)} rms"
    if above:
        caption += (
            f"Above: {above}. Below: with all that was found in the law ({after}); the lines should lie "
            "within the grey band, where noise alone would keep them."
        )
    else:
        caption += f"{after}; noise alone would keep the lines within the grey band."
    return make_picture(find_key("finding", finding), title, caption, figure)


def find_key(kind: str, finding: Finding) -> str:
    """Of a finding's picture of some kind, unlike those of others."""
    name = finding.cause if finding.cause != UNKNOWN else f"{finding.cause} {finding.carrier}"
    return f"{kind}-" + "".join(letter if letter.isalnum() else "-" for letter in name)


def _draw_points(
    axis: Axes, values: Array, residual: Array, kinds: ColouredRows, numbers: pd.Index | None
) -> None:
    for colour, kind in kinds.items():
        index = np.flatnonzero(kind & np.isfinite(values))
        if len(index) > MAX_POINTS:
            index = np.sort(np.random.default_rng(0).choice(index, MAX_POINTS, replace=False))
        size, alpha = (3.5, 0.6) if len(values) <= FEW_POINTS else (1.8, 0.35)
        # Not cut at the edge, where residuals beyond the limits are drawn.
        dots: dict[str, Any] = {"ls": "", "marker": "o", "ms": size, "mew": 0, "alpha": alpha}
        (points,) = axis.plot(values[index], residual[index], color=colour, clip_on=False, **dots)
        if numbers is not None:
            name_traverses(points, numbers[index])


def draw_means(
    axis: Axes, values: Array, residual: Array, null: Array, kinds: ColouredRows, *, dotted: bool = False
) -> float:
    """Means by class, dotted or with their errors over the envelope; the largest size drawn."""
    classes, largest = bin_values(_known(values, kinds)), 0.0
    if not dotted:
        axis.axhline(0.0, color=INK, lw=0.7, zorder=1)
    for colour, kind in kinds.items():
        if not (kind & (classes >= 0)).any():
            continue
        binned = bin_residuals(residual, null, values, classes, kind)
        x, y, band = binned.centre, binned.mean, binned.envelope
        if dotted:
            axis.plot(x, y, color=colour, ls=":", lw=0.9)
            band = np.zeros(len(band))
        else:
            error = Z_95 * binned.error
            axis.errorbar(x, y, yerr=error, color=colour, marker="o", ms=3.0, lw=0.9, elinewidth=0.8)
            axis.fill_between(x, -band, band, color=ENVELOPE_COLOUR, lw=0, zorder=0.5)
        largest = max(largest, float(np.max(np.maximum(np.abs(y), band))))
    return largest


def _draw_effect(axis: Axes, values: Array, effect: Array, kinds: ColouredRows) -> None:
    """Means of an effect by the classes of the residuals, dashed."""
    classes = bin_values(_known(values, kinds))
    for kind in kinds.values():
        inside = kind & (classes >= 0)
        means = pd.DataFrame({"x": values[inside], "y": effect[inside]}).groupby(classes[inside]).mean()
        axis.plot(means["x"], means["y"], color=INK, ls="--", lw=1.1, zorder=4)


def _known(values: Array, kinds: ColouredRows) -> Array:
    return np.where(np.any(list(kinds.values()), axis=0), values, np.nan)


def _label_values(axis: Axes, label: str, values: Array, kinds: ColouredRows, across: int, most: int) -> None:
    """The label below a panel, one of `across`, and at most `most` ticks, at angles that people set."""
    known = _known(values, kinds)
    short = label.replace("time since the session's first row", "time in session") if across > 1 else label
    axis.set_xlabel(shorten(short, min(LETTERS // across, 60)))
    if "°)" in label:
        set_angle_ticks(axis, float(np.nanmin(known)), float(np.nanmax(known)), most)
    elif len(pair := np.unique(known[np.isfinite(known)])) == 2:  # nothing lies between a switch's settings
        axis.set_xticks(pair)
        axis.set_xlim(*(pair + np.array([-MARGIN, MARGIN]) * np.ptp(pair)))
    else:
        axis.locator_params(axis="x", nbins=most)
