"""One look for all figures: colours, sizes, axes with room for their labels."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from stickslip_fit._format import format_plain as plain
from stickslip_fit.report.figures.drawing import Drawing

Shared = bool | Literal["none", "all", "row", "col"]
Line = Literal["", "-", "--", ":"]

WIDTH = 7.2  # inches; a page shows it between 0.95 (A4) and 1.25 (screen) of this size
ENTRY_WIDTH, LETTER_WIDTH = 0.36, 0.060  # inches, of a legend's entry and each letter of its label
LEGEND_LINE, TITLE_LINE = 0.19, 0.15  # inches

# Okabe and Ito's palette, told apart by colour-blind readers; a marker or line style always says it too.
BLUE, VERMILLION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#AA4499"
INK, GREY = "#222222", "#6f6f6f"
DIRECTION_COLOURS = {"+": BLUE, "-": VERMILLION}
MARKERS = ("o", "s", "^", "D")

_LOOK: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.4,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.columnspacing": 1.3,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    # Session names come from logs: a dollar sign in one must not start a formula.
    "text.parse_math": False,
    "svg.fonttype": "none",
}


@contextmanager
def look() -> Iterator[None]:
    """Everything drawn inside has the report's look."""
    with mpl.rc_context(_LOOK), warnings.catch_warnings():
        # The reader's browser has fonts for the scripts that matplotlib's own lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def canvas(
    heights: Sequence[float],
    columns: int,
    *,
    left: float = 0.62,
    right: float = 0.08,
    top: float = 0.55,
    bottom: float = 0.45,
    across: float = 0.12,
    down: float = 0.12,
    share_x: Shared = "col",
    share_y: Shared = "row",
) -> tuple[Figure, npt.NDArray[np.object_]]:
    """A figure of the page's width with a grid of axes; all lengths in inches.

    Parameters
    ----------
    heights : sequence of float
        Of each row of axes.
    columns : int
    left, right, top, bottom : float
        Margins; the top one holds the legend.
    across, down : float
        Gaps between axes.

    Returns
    -------
    Figure, array of Axes with shape (rows, columns)
    """
    tall = height(heights, top, bottom, down)
    figure = Drawing(figsize=(WIDTH, tall))
    margins = {"left": left, "right": right, "top": top, "bottom": bottom, "across": across, "down": down}
    return figure, grid(figure, heights, columns, **margins, share_x=share_x, share_y=share_y)


def height(heights: Sequence[float], top: float, bottom: float, down: float) -> float:
    """Inches that a `grid` takes up."""
    return top + bottom + sum(heights) + down * (len(heights) - 1)


def grid(
    parent: FigureBase,
    heights: Sequence[float],
    columns: int,
    *,
    left: float,
    right: float,
    top: float,
    bottom: float,
    across: float,
    down: float,
    share_x: Shared,
    share_y: Shared,
) -> npt.NDArray[np.object_]:
    """A grid of axes, as `canvas` has it, in a figure or a part of one that is `height` tall."""
    rows, tall = len(heights), height(heights, top, bottom, down)
    wide = (WIDTH - left - right - across * (columns - 1)) / columns
    return parent.subplots(
        rows,
        columns,
        sharex=share_x,
        sharey=share_y,
        squeeze=False,
        gridspec_kw={
            "height_ratios": heights,
            "left": left / WIDTH,
            "right": 1 - right / WIDTH,
            "top": 1 - top / tall,
            "bottom": bottom / tall,
            "wspace": across / wide,
            "hspace": down / (sum(heights) / rows),
        },
    )


def legend_rows(entries: Sequence[Line2D]) -> int:
    """Lines that a legend takes up: as few as let its columns, each as wide as its longest label, fit."""
    wide = np.array([ENTRY_WIDTH + LETTER_WIDTH * len(str(entry.get_label())) for entry in entries])

    def across(rows: int) -> float:
        return sum(column.max() for column in np.array_split(wide, -(-len(wide) // rows)))

    return next((rows for rows in range(1, len(wide)) if across(rows) <= WIDTH), max(len(wide), 1))


def legend(figure: FigureBase, entries: Sequence[Line2D], top: float = 1.0) -> None:
    """One legend for all axes, along the figure's upper edge or where `top` is, a share of its height."""
    figure.legend(
        handles=list(entries),
        loc="upper left",
        bbox_to_anchor=(0.0, top),
        ncols=int(np.ceil(len(entries) / legend_rows(entries))),
        borderaxespad=0.1,
    )


def key_line(label: str, colour: str, marker: str = "", line: Line = "") -> Line2D:
    """A legend's entry."""
    return Line2D([], [], color=colour, marker=marker, linestyle=line, label=label)


def angle_ticks(axes: Axes, low: float, high: float, most: int) -> None:
    """Ticks at angles that people set: every 15, 30, 45, 60, 90 degrees, no more of them than `most`."""
    if high - low < 15:
        axes.locator_params(axis="x", nbins=most)
        return
    step = next((step for step in (15, 30, 45, 60, 90) if (high - low) / step < most), 180)
    axes.set_xticks(np.arange(round(np.ceil(low / step - 1e-6)), high / step + 1e-6) * step)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))


def plain_log(axes: Axes, ticks: Sequence[float]) -> None:
    """A logarithmic x axis with plain numbers at the given ticks."""
    axes.set_xscale("log")
    axes.set_xticks(list(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
