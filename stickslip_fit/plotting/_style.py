"""The style of all figures: colours, sizes, legends, scales and ticks; writing figures to files.

Figures are made without pyplot, so that nothing keeps them open.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, Locator, LogLocator, NullFormatter

from stickslip_fit._format import format_direction, format_plain
from stickslip_fit._io import write_atomically
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.machine import Machine

DPI = 200  # an inch; sharp on any screen, and shown at `SHOWN` an inch
SCREEN_DPI = 100


class DisplayedFigure(Figure):
    """A figure made without pyplot; a notebook's cell that ends with it shows it."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=DPI)
        wide, tall = self.get_size_inches()
        return stream.getvalue(), {"width": round(SCREEN_DPI * wide), "height": round(SCREEN_DPI * tall)}


AxisSharing = bool | Literal["none", "all", "row", "col"]
LineStyle = Literal["", "-", "--", ":"]

FIGURE_WIDTH = 7.2  # inches; a page shows it between 0.95 (A4) and 1.25 (screen) of this size
ENTRY_WIDTH, LETTER_WIDTH = 0.36, 0.060  # inches, of a legend's entry and each letter of its label
LEGEND_LINE, TITLE_LINE = 0.19, 0.15  # inches

# Okabe and Ito's palette, safe for colour-blind readers; a marker or line style always says it too.
BLUE, VERMILLION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#AA4499"
INK, GREY = "#222222", "#6f6f6f"
DIRECTION_COLOURS = {"+": BLUE, "-": VERMILLION}
MARKERS = ("o", "s", "^", "D")
MAX_SESSIONS, MAX_SESSION_LABELS, MAX_HORIZONTAL_LABELS = 30, 12, 6  # along an axis

_RC_PARAMS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titley": 1.0,  # no axis has ticks above, which a title would have to avoid
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
    "figure.facecolor": "white",  # ink on a dark notebook could not be read; pages leave it out
    "axes.facecolor": "none",
    # Session names come from logs: a dollar sign in one must not start a formula.
    "text.parse_math": False,
    "svg.fonttype": "none",
}


@contextmanager
def report_style() -> Iterator[None]:
    """Everything drawn inside has the report's style."""
    with mpl.rc_context(_RC_PARAMS), warnings.catch_warnings():
        # The reader's browser has fonts for the scripts that matplotlib's own lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def make_figure(
    heights: Sequence[float],
    columns: int,
    legend: Sequence[Line2D] = (),
    *,
    left: float = 0.62,
    right: float = 0.08,
    top: float = 0.14,
    bottom: float = 0.45,
    across: float = 0.12,
    down: float = 0.12,
    share_x: AxisSharing = "col",
    share_y: AxisSharing = "row",
) -> tuple[Figure, npt.NDArray[np.object_]]:
    """A figure of the page's width with a grid of axes below one legend; all lengths in inches.

    Parameters
    ----------
    heights : sequence of float
        Of each row of axes.
    legend : sequence of Line2D, optional
        Entries along the upper edge.
    left, right, top, bottom : float
        Margins; the legend's height is added to the top one.
    across, down : float
        Gaps between axes.

    Returns
    -------
    Figure, array of Axes with shape (rows, columns)
    """
    top += LEGEND_LINE * count_legend_rows(legend) if legend else 0.0
    figure = DisplayedFigure(figsize=(FIGURE_WIDTH, grid_height(heights, top, bottom, down)))
    if legend:
        add_legend(figure, legend)
    margins = {"left": left, "right": right, "top": top, "bottom": bottom, "across": across, "down": down}
    return figure, make_grid(figure, heights, columns, **margins, share_x=share_x, share_y=share_y)


def grid_height(heights: Sequence[float], top: float, bottom: float, down: float) -> float:
    """Inches that a `make_grid` takes up."""
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
    """A grid of axes as in `make_figure`, in a figure or a subfigure that is `grid_height` tall."""
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
    """The fewest lines at which a legend's columns, each as wide as its longest label, fit the figure."""
    wide = np.array([ENTRY_WIDTH + LETTER_WIDTH * len(str(entry.get_label())) for entry in entries])

    def across(rows: int) -> float:
        return sum(column.max() for column in np.array_split(wide, -(-len(wide) // rows)))

    return next((rows for rows in range(1, len(wide)) if across(rows) <= FIGURE_WIDTH), max(len(wide), 1))


def add_legend(figure: FigureBase, entries: Sequence[Line2D], top: float = 1.0) -> None:
    """One legend for all axes, along the figure's upper edge or at `top`, a share of its height."""
    figure.legend(
        handles=list(entries),
        loc="upper left",
        bbox_to_anchor=(0.0, top),
        ncols=int(np.ceil(len(entries) / count_legend_rows(entries))),
        borderaxespad=0.1,
    )


def make_legend_entry(
    label: str, colour: str, marker: str = "", line: LineStyle = "", width: float | None = None
) -> Line2D:
    """A legend's entry; a wide line stands for a band."""
    with report_style():
        return Line2D([], [], color=colour, marker=marker, linestyle=line, linewidth=width, label=label)


def direction_entries(
    marker: str = "", line: LineStyle = "", label: str = "direction {}", signs: Iterable[str] = "+-"
) -> list[Line2D]:
    """A legend's entries for the directions."""
    return [
        make_legend_entry(label.format(format_direction(sign)), DIRECTION_COLOURS[sign], marker, line)
        for sign in signs
    ]


@dataclass(frozen=True)
class PointStyle:
    """Points of one colour: their label in the legend and the colour."""

    label: str
    colour: str


def direction_styles(joint: int, machine: Machine) -> dict[str, PointStyle]:
    """The two directions of a joint as colours."""
    slides = machine.is_prismatic(joint)
    words = {"+": "outward", "-": "inward"} if slides else {"+": "increasing", "-": "decreasing"}
    return {
        sign: PointStyle(f"{format_direction(sign)} ({words[sign]})", DIRECTION_COLOURS[sign])
        for sign in "+-"
    }


def sweep_entries(kinds: dict[str, PointStyle], sessions: list[str]) -> list[Line2D]:
    """A legend's entries for kinds of points and, where there are several, for sessions."""
    entries = [make_legend_entry(kind.label, kind.colour, marker="o", line="-") for kind in kinds.values()]
    if len(sessions) > 1:
        entries += [
            make_legend_entry(shorten(session, 18), GREY, marker=MARKERS[index % len(MARKERS)])
            for index, session in enumerate(sessions)
        ]
    return entries


def robust_limit(sizes: Array, quantile: float, zoom: float, margin: float = 1.05) -> float:
    """Half a symmetric scale: `margin` times the largest size, but at most `zoom` times a quantile."""
    return margin * min(float(sizes.max()), zoom * float(np.quantile(sizes, quantile)))


def _elide(name: str) -> str:
    """A name without its middle, as sessions differ by their ends."""
    return name if len(name) <= 12 else f"{name[:5]}…{name[-6:]}"


def label_sessions(axes: Axes, sessions: Sequence[str], *, vertical: bool = True) -> None:
    """An x axis of sessions: the latest is named and as many others as there is space for."""
    every = -(-len(sessions) // MAX_SESSION_LABELS)
    places = range(len(sessions) - 1, -1, -every)
    names = [_elide(str(sessions[place])) for place in places]
    axes.set_xticks(places, names, rotation=90 if vertical else 0)
    axes.set_xlim(-0.5, len(sessions) - 0.5)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(visible=False, axis="x")


def set_angle_ticks(axes: Axes, low: float, high: float, most: int) -> None:
    """At most `most` ticks, at angles that people set: every 15, 30, 45, 60 or 90 degrees."""
    if high - low < 15:
        axes.locator_params(axis="x", nbins=most)
        return
    step = next((step for step in (15, 30, 45, 60, 90) if (high - low) / step < most), 180)
    axes.set_xticks(np.arange(round(np.ceil(low / step - 1e-6)), high / step + 1e-6) * step)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))


class VisibleTicks(Locator):
    """Another locator's ticks within the view: each costs as much as a curve, drawn or beyond it."""

    def __init__(self, locator: Locator) -> None:
        self.locator = locator

    def set_axis(self, axis: Any) -> None:
        super().set_axis(axis)
        self.locator.set_axis(axis)

    def __call__(self) -> list[float]:
        """The ticks."""
        assert self.axis is not None
        low, high = sorted(self.axis.get_view_interval())
        return [tick for tick in self.locator() if low <= tick <= high]

    def nonsingular(self, vmin: float, vmax: float) -> tuple[float, float]:
        return self.locator.nonsingular(vmin, vmax)


def set_log_axis(axis: Axis, *, ticks: Sequence[float] = (), subs: Sequence[float] = (1.0,)) -> None:
    """A logarithmic axis with plain numbers at `ticks`, or at `subs` times each power of ten."""
    (axis.axes.set_xscale if isinstance(axis, XAxis) else axis.axes.set_yscale)("log")
    axis.set_major_locator(VisibleTicks(FixedLocator(list(ticks)) if ticks else LogLocator(subs=subs)))
    axis.set_minor_locator(VisibleTicks(axis.get_minor_locator()))
    axis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axis.set_minor_formatter(NullFormatter())


class AxesArray(np.ndarray):
    """The axes of one figure, row by row: an array of them, shape (panels,), that a notebook shows.

    Examples
    --------
    >>> figure = DisplayedFigure()
    >>> _ = figure.subplots(1, 2)
    >>> axes = collect_axes(figure)
    >>> axes
    2 panels of a figure
    >>> axes[0].set_title("left").get_text()
    'left'
    """

    @property
    def figure(self) -> DisplayedFigure:
        """The figure."""
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
    visible = [axes for axes in figure.axes if axes.axison and axes.get_visible()]
    panels = np.empty(len(visible), dtype=object)
    panels[:] = visible
    return panels.view(AxesArray)


# What would make the same chart differ from one writing to the next.
DATE_METADATA = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def check_suffix(path: Path) -> None:
    """Raise InputError unless the file's suffix is one of png, svg and pdf."""
    if path.suffix.lower() not in DATE_METADATA:
        raise InputError(
            InputIssue(
                "is no kind of picture that can be drawn: end its name in .png, .svg or .pdf", str(path)
            )
        )


def write_figure(figure: Figure, path: Path, key: str) -> None:
    """Write a figure; the same figure and key give the same file.

    Raises
    ------
    InputError
        If the file cannot be written, or its suffix is none of png, svg and pdf.
    """
    check_suffix(path)
    kind, stream = path.suffix.lower(), io.BytesIO()
    with report_style(), mpl.rc_context({"svg.hashsalt": key}):
        figure.savefig(stream, format=kind[1:], dpi=DPI, metadata=DATE_METADATA[kind])
    write_atomically(path, stream.getvalue())


MAX_RECENT_SESSIONS = 3


def select_recent(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of the most recent sessions; more of them would hide each other."""
    sessions = rows["session"].astype(object).unique()
    return rows[rows["session"].isin(list(sessions[-MAX_RECENT_SESSIONS:]))]


def thin_rows(rows: pd.DataFrame, most: int) -> pd.DataFrame:
    """At most `most` of the rows, chosen at random but the same each time.

    Every k-th row would not do: directions take turns, so that an even k would leave only one.
    """
    return rows if len(rows) <= most else rows.sample(most, random_state=0).sort_index()
