"""The style of all figures: colours, sizes, legends and ticks; writing figures to files.

Figures are made without pyplot.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from stickslip_fit._format import format_plain as plain
from stickslip_fit._io import write_atomically
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.estimation import Result

DPI = 200  # an inch; sharp on any screen, and shown at `SHOWN` an inch
SCREEN_DPI = 100


class DisplayedFigure(Figure):
    """A figure made without pyplot: nothing keeps it open, and a cell that ends with it shows it."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=DPI)
        wide, tall = self.get_size_inches()
        return stream.getvalue(), {"width": round(SCREEN_DPI * wide), "height": round(SCREEN_DPI * tall)}


def set_white_background[Shown: Figure](figure: Shown) -> Shown:
    """The figure with a background of its own: ink on a dark notebook could not be read."""
    figure.set_facecolor("white")
    return figure


AxisSharing = bool | Literal["none", "all", "row", "col"]
LineStyle = Literal["", "-", "--", ":"]

FIGURE_WIDTH = 7.2  # inches; a page shows it between 0.95 (A4) and 1.25 (screen) of this size
ENTRY_WIDTH, LETTER_WIDTH = 0.36, 0.060  # inches, of a legend's entry and each letter of its label
LEGEND_LINE, TITLE_LINE = 0.19, 0.15  # inches

# Okabe and Ito's palette, told apart by colour-blind readers; a marker or line style always says it too.
BLUE, VERMILLION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#AA4499"
INK, GREY = "#222222", "#6f6f6f"
DIRECTION_COLOURS = {"+": BLUE, "-": VERMILLION}
MARKERS = ("o", "s", "^", "D")

_RC_PARAMS: dict[Any, Any] = {
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
def report_style() -> Iterator[None]:
    """Everything drawn inside has the report's look."""
    with mpl.rc_context(_RC_PARAMS), warnings.catch_warnings():
        # The reader's browser has fonts for the scripts that matplotlib's own lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def make_figure(
    heights: Sequence[float],
    columns: int,
    *,
    left: float = 0.62,
    right: float = 0.08,
    top: float = 0.55,
    bottom: float = 0.45,
    across: float = 0.12,
    down: float = 0.12,
    share_x: AxisSharing = "col",
    share_y: AxisSharing = "row",
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
    tall = grid_height(heights, top, bottom, down)
    figure = DisplayedFigure(figsize=(FIGURE_WIDTH, tall))
    margins = {"left": left, "right": right, "top": top, "bottom": bottom, "across": across, "down": down}
    return figure, make_grid(figure, heights, columns, **margins, share_x=share_x, share_y=share_y)


def grid_height(heights: Sequence[float], top: float, bottom: float, down: float) -> float:
    """Inches that a `grid` takes up."""
    return top + bottom + sum(heights) + down * (len(heights) - 1)


def make_grid(
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
    share_x: AxisSharing,
    share_y: AxisSharing,
) -> npt.NDArray[np.object_]:
    """A grid of axes, as `canvas` has it, in a figure or a part of one that is `height` tall."""
    rows, tall = len(heights), grid_height(heights, top, bottom, down)
    wide = (FIGURE_WIDTH - left - right - across * (columns - 1)) / columns
    return parent.subplots(
        rows,
        columns,
        sharex=share_x,
        sharey=share_y,
        squeeze=False,
        gridspec_kw={
            "height_ratios": heights,
            "left": left / FIGURE_WIDTH,
            "right": 1 - right / FIGURE_WIDTH,
            "top": 1 - top / tall,
            "bottom": bottom / tall,
            "wspace": across / wide,
            "hspace": down / (sum(heights) / rows),
        },
    )


def count_legend_rows(entries: Sequence[Line2D]) -> int:
    """Lines that a legend takes up: as few as let its columns, each as wide as its longest label, fit."""
    wide = np.array([ENTRY_WIDTH + LETTER_WIDTH * len(str(entry.get_label())) for entry in entries])

    def across(rows: int) -> float:
        return sum(column.max() for column in np.array_split(wide, -(-len(wide) // rows)))

    return next((rows for rows in range(1, len(wide)) if across(rows) <= FIGURE_WIDTH), max(len(wide), 1))


def add_legend(figure: FigureBase, entries: Sequence[Line2D], top: float = 1.0) -> None:
    """One legend for all axes, along the figure's upper edge or where `top` is, a share of its height."""
    figure.legend(
        handles=list(entries),
        loc="upper left",
        bbox_to_anchor=(0.0, top),
        ncols=int(np.ceil(len(entries) / count_legend_rows(entries))),
        borderaxespad=0.1,
    )


def make_legend_entry(label: str, colour: str, marker: str = "", line: LineStyle = "") -> Line2D:
    """A legend's entry."""
    return Line2D([], [], color=colour, marker=marker, linestyle=line, label=label)


def set_angle_ticks(axes: Axes, low: float, high: float, most: int) -> None:
    """Ticks at angles that people set: every 15, 30, 45, 60, 90 degrees, no more of them than `most`."""
    if high - low < 15:
        axes.locator_params(axis="x", nbins=most)
        return
    step = next((step for step in (15, 30, 45, 60, 90) if (high - low) / step < most), 180)
    axes.set_xticks(np.arange(round(np.ceil(low / step - 1e-6)), high / step + 1e-6) * step)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))


def set_log_ticks(axes: Axes, ticks: Sequence[float]) -> None:
    """A logarithmic x axis with plain numbers at the given ticks."""
    axes.set_xscale("log")
    axes.set_xticks(list(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain(value)))
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))


class AxesArray(np.ndarray):
    """The axes of one figure, row by row: numpy's array of them, shape (panels,).

    A figure is made without pyplot, so that nothing keeps it open. A cell that ends with its panels shows it
    once; a cell that changes them first shows it changed.

    Examples
    --------
    >>> figure = DisplayedFigure()
    >>> _ = figure.subplots(1, 2)
    >>> both = collect_axes(figure)
    >>> both
    2 panels of a figure
    >>> both[0].set_title("left").get_text()
    'left'
    """

    @property
    def figure(self) -> DisplayedFigure:
        """The figure that they are of."""
        first: Any = self.flat[0]
        return first.get_figure(root=True)

    def savefig(self, *arguments: Any, **options: Any) -> None:
        """Write the figure to a file; see `matplotlib.figure.Figure.savefig`."""
        self.figure.savefig(*arguments, **options)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        return self.figure._repr_png_()

    def __repr__(self) -> str:
        return f"{self.size} panel{'s' * (self.size > 1)} of a figure"

    __str__ = __repr__


def collect_axes(figure: Figure) -> AxesArray:
    """The axes of a drawn figure that have something in them."""
    shown = [axes for axes in figure.axes if axes.axison and axes.get_visible()]
    found = np.empty(len(shown), dtype=object)
    found[:] = shown
    return found.view(AxesArray)


# What would make the same chart differ from one writing to the next.
DATE_METADATA = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def check_suffix(path: Path) -> None:
    """Refuse a file of a kind that cannot be drawn.

    Raises
    ------
    InputError
    """
    if path.suffix.lower() not in DATE_METADATA:
        raise InputError(
            InputIssue(
                "is no kind of picture that can be drawn: end its name in .png, .svg or .pdf", str(path)
            )
        )


def write_chart(result: Result, path: Path) -> None:
    """Draw the control chart of all joints.

    Raises
    ------
    InputError
        If the file cannot be written, its suffix is none of png, svg and pdf, or no parameter is known.
    """
    from stickslip_fit.plotting.parameters import plot_control

    write_figure(plot_control(result), path, "control")


def write_figure(figure: Figure, path: Path, key: str) -> None:
    """Write a figure; the same figure and key give the same file.

    Raises
    ------
    InputError
        If the file cannot be written, or its suffix is none of png, svg and pdf.
    """
    import matplotlib as mpl

    check_suffix(path)
    kind, stream = path.suffix.lower(), io.BytesIO()
    with report_style(), mpl.rc_context({"svg.hashsalt": key}):
        figure.savefig(stream, format=kind[1:], dpi=DPI, metadata=DATE_METADATA[kind])
    write_atomically(path, stream.getvalue())


MAX_SESSIONS = 3


def select_recent(rows: pd.DataFrame, most: int = MAX_SESSIONS) -> pd.DataFrame:
    """The rows of the most recent sessions; more of them would hide each other."""
    sessions = rows["session"].astype(object).unique()
    return rows[rows["session"].isin(list(sessions[-most:]))]


def thin_rows(rows: pd.DataFrame, most: int) -> pd.DataFrame:
    """At most `most` of the rows, chosen at random but the same each time.

    Every k-th row would not do: directions take turns, so that an even k would leave only one.
    """
    return rows if len(rows) <= most else rows.sample(most, random_state=0).sort_index()
