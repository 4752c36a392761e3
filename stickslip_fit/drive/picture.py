"""The arm from two sides: what lies where in each view, the error ellipse, and both as a picture of text.

From above, x points right and y up; in the arm's own plane, the distance from joint 1's axis in the
direction of joint 1 points right and the height up. The error ellipse is micrometres where the arm is
centimetres, and is drawn by a magnification of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, inf, log10

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.drive.state import DriveState
from stickslip_fit.machine import Machine, forward
from stickslip_fit.moves.error_ellipsoid import error_ellipse
from stickslip_fit.units import from_si

Point = tuple[float, float]
IntArray = npt.NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class ArmView:
    """The arm seen from one side; lengths in m.

    Attributes
    ----------
    axes : (str, str)
        What points right, and what up.
    extent : array, shape (2, 2)
        Lowest and highest of each coordinate that any configuration reaches.
    base, elbow, tip : (float, float)
    near, far : (float, float)
        The tip with joint 3 at the lowest and the highest of its range.
    projection : array, shape (2, 3)
        From the base's frame to the view's coordinates.
    covariance : array, shape (2, 2)
        Of the tip, m^2.
    """

    title: str
    axes: tuple[str, str]
    extent: Array
    base: Point
    elbow: Point
    tip: Point
    near: Point
    far: Point
    projection: Array
    covariance: Array


def view_arm(state: DriveState, machine: Machine) -> tuple[ArmView, ArmView]:
    """The arm from above, and in its own plane.

    Raises
    ------
    InputError
        If the machine has no published geometry.
    """
    machine.require_geometry("a picture of the arm")
    q1, q2, _ = state.q
    ends = forward(machine, [[q1, q2, q3] for q3 in machine.ranges[3]])
    elbow = machine.a1 * np.array([np.cos(q1), np.sin(q1), 0.0])
    places = np.stack([np.zeros(3), elbow, state.tip, *ends])
    above = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    plane = np.array([[np.cos(q1), np.sin(q1), 0.0], [0.0, 0.0, 1.0]])
    around, across = _extents(machine)
    return (
        _view("from above", ("x", "y"), around, above, places, state.tip_covariance),
        _view("in the arm's plane", ("radius", "height"), across, plane, places, state.tip_covariance),
    )


def _view(
    title: str, axes: tuple[str, str], extent: Array, projection: Array, places: Array, covariance: Array
) -> ArmView:
    base, elbow, tip, near, far = ((float(x), float(y)) for x, y in places @ projection.T)
    return ArmView(
        title, axes, extent, base, elbow, tip, near, far, projection, projection @ covariance @ projection.T
    )


def _extents(machine: Machine) -> tuple[Array, Array]:
    """What the arm reaches at all, in each view; a grid of 3 degrees misses 0.1 % of it at most."""
    q1, q2 = (np.linspace(*machine.ranges[joint], 81) for joint in (1, 2))
    lengths = machine.l2 + np.array(machine.ranges[3])
    radius = _ends(machine.a1 - np.outer(lengths, np.sin(q2)))
    around = [_ends(np.outer(radius, turned(q1))) for turned in (np.cos, np.sin)]
    return np.array(around), np.array([radius, _ends(np.outer(lengths, np.cos(q2)))])


def _ends(values: Array) -> Point:
    """The lowest and the highest, with the base's 0 between them."""
    return min(float(values.min()), 0.0), max(float(values.max()), 0.0)


def round_down(value: float) -> float:
    """The next lower number of the series 1, 2, 5, 10, 20, ...

    Examples
    --------
    >>> [round_down(value) for value in (3.7, 0.0199, 512.0)]
    [2.0, 0.01, 500.0]
    """
    decade = 10.0 ** floor(log10(value))
    # A number of the series itself must not fall by the rounding of the logarithm.
    fitting = [digit * decade for digit in (1.0, 2.0, 5.0, 10.0) if digit * decade <= value * (1 + 1e-9)]
    return fitting[-1] if fitting else decade


BRAILLE = 0x2800
DOTS = np.array([(0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80)])  # of a character, from the top
DOT_COLUMNS, DOT_ROWS = 2, 4
MARKS = {"base": "■", "elbow": "○", "tip": "●"}
LEGEND = (
    *(f"{mark} {name}" for name, mark in MARKS.items()),
    "⠂⠐⠂ range of q3",
    "ellipse: 95 % of the tip's errors",
)
ARM_WIDTH, ELLIPSE_WIDTH, MIN_HEIGHT = 24, 13, 7  # below which there is nothing to be seen
GAP = 2
ELLIPSE_POINTS = 256  # enough for a closed line of dots
RANGE_SPACING = 3  # dots between those of joint 3's range
BAR_SHARE = 0.6  # of the width, at most, for the bar that shows the scale


class _Canvas:
    """Characters of 2 x 4 dots, which are as far apart in a row as in a column; lengths in m."""

    def __init__(self, width: int, height: int, centre: Array, scale: float) -> None:
        self.width, self.height = width, height
        self.scale = scale  # dots per m
        self._centre = centre
        self._dots = np.zeros((height, width), int)
        self._letters: dict[tuple[int, int], str] = {}

    def cells(self, points: npt.ArrayLike) -> tuple[IntArray, IntArray]:
        """Column and row of the dots at points, shape (n, 2), from the top left; shapes (n,) and (n,)."""
        right, up = ((np.asarray(points) - self._centre) * self.scale).T
        columns = (DOT_COLUMNS * self.width - 1) / 2 + right
        rows = (DOT_ROWS * self.height - 1) / 2 - up
        return np.rint(columns).astype(int), np.rint(rows).astype(int)

    def put(self, points: npt.ArrayLike) -> None:
        """Dots at points, shape (n, 2); none outside."""
        columns, rows = self.cells(points)
        inside = (columns >= 0) & (columns < DOT_COLUMNS * self.width)
        inside &= (rows >= 0) & (rows < DOT_ROWS * self.height)
        columns, rows = columns[inside], rows[inside]
        places = rows // DOT_ROWS, columns // DOT_COLUMNS
        np.bitwise_or.at(self._dots, places, DOTS[rows % DOT_ROWS, columns % DOT_COLUMNS])

    def line(self, start: Point, end: Point, spacing: int = 1) -> None:
        """A line of dots."""
        columns, rows = self.cells([start, end])
        length = max(abs(int(columns[1] - columns[0])), abs(int(rows[1] - rows[0])), 1)
        share = np.append(np.arange(0, length, spacing) / length, 1.0)[:, None]
        self.put(np.array(start) + share * np.subtract(end, start))

    def mark(self, point: Point, letter: str) -> None:
        """A letter in place of the dots."""
        (column,), (row,) = self.cells([point])
        self._letters[int(column) // DOT_COLUMNS, int(row) // DOT_ROWS] = letter

    def lines(self) -> list[str]:
        """The picture, one string for each row."""
        return [
            "".join(
                self._letters.get((column, row)) or (chr(BRAILLE + dots) if dots else " ")
                for column, dots in enumerate(dots_of_row)
            )
            for row, dots_of_row in enumerate(self._dots.tolist())
        ]

    def bar(self, unit: str, longest: float = inf) -> str:
        """A bar of a round length, in m at most `longest`, with that length."""
        length = round_down(min(BAR_SHARE * DOT_COLUMNS * self.width / self.scale, longest))
        dashes = "─" * max(round(length * self.scale / DOT_COLUMNS) - 2, 0)
        return f"├{dashes}┤ {from_si(length, unit):g} {unit}"


def draw_arm(state: DriveState, machine: Machine, width: int, height: int) -> list[str]:
    """A picture of the arm from two sides, each with the error ellipse of the tip, enlarged, beside it.

    Where there is no room for both sides, the arm's own plane is drawn alone.

    Parameters
    ----------
    width, height : int
        Of the picture, in characters.

    Returns
    -------
    list of str
        As many lines as `height`, none longer than `width`; empty where there is no room for one side.

    Raises
    ------
    InputError
        If the machine has no published geometry.
    """
    views: tuple[ArmView, ...] = view_arm(state, machine)
    wide = (width - GAP) // 2
    if wide < ARM_WIDTH + ELLIPSE_WIDTH:
        views, wide = views[1:], min(width, 2 * ARM_WIDTH)
    if wide < ARM_WIDTH + ELLIPSE_WIDTH or height < MIN_HEIGHT:
        return []
    enlarged = _choose_ellipse_scale(views, height - 3)
    panels = [_draw_view(view, wide, height - 1, enlarged) for view in views]
    rows = [(" " * GAP).join(row).rstrip() for row in zip(*panels, strict=True)]
    return [*rows, _write_legend(width)]


def _write_legend(width: int) -> str:
    """Without its last entries where there is no room."""
    legend = ""
    for entry in LEGEND:
        longer = f"{legend}  {entry}" if legend else entry
        legend = longer if len(longer) <= width else legend
    return legend


def _choose_ellipse_scale(views: tuple[ArmView, ...], height: int) -> float:
    """Dots per m, the same in all views, of a coarse series so that growth is seen; 0 where none is known."""
    ellipses = [error_ellipse(view.covariance) for view in views]
    longest = max((ellipse.longer for ellipse in ellipses if ellipse), default=0.0)
    room = min(DOT_COLUMNS * ELLIPSE_WIDTH, DOT_ROWS * height) / 2 - 1
    return round_down(room / longest) if longest > 0.0 else 0.0


def _draw_view(view: ArmView, width: int, height: int, enlarged: float) -> list[str]:
    """Titles; the arm, and the ellipse beside it; their scales."""
    narrow = width - ELLIPSE_WIDTH
    arm, arm_bar = _draw_arm_alone(view, narrow, height - 2)
    ellipse, ellipse_bar = _draw_ellipse(view, height - 2, enlarged)
    right, up = view.axes
    left = [f"{view.title}: {right} →, {up} ↑", *arm, arm_bar]
    beside = ["", *ellipse, ellipse_bar]
    return [f"{one:{narrow}}{other}".ljust(width)[:width] for one, other in zip(left, beside, strict=True)]


def _draw_arm_alone(view: ArmView, width: int, height: int) -> tuple[list[str], str]:
    spans = view.extent[:, 1] - view.extent[:, 0]
    sides = np.array([DOT_COLUMNS * width - 1, DOT_ROWS * height - 1])
    canvas = _Canvas(width, height, view.extent.mean(axis=1), float(np.min(sides / spans)))
    canvas.line(view.base, view.elbow)
    canvas.line(view.elbow, view.tip)
    canvas.line(view.near, view.far, RANGE_SPACING)
    for name, letter in MARKS.items():
        canvas.mark(getattr(view, name), letter)
    return canvas.lines(), canvas.bar("mm", float(np.max(spans)))


def _draw_ellipse(view: ArmView, height: int, scale: float) -> tuple[list[str], str]:
    ellipse = error_ellipse(view.covariance)
    if ellipse is None or not scale:
        return [""] * height, ""
    canvas = _Canvas(ELLIPSE_WIDTH, height, np.zeros(2), scale)
    canvas.put(ellipse.points(ELLIPSE_POINTS))
    canvas.mark((0.0, 0.0), MARKS["tip"])
    return canvas.lines(), canvas.bar("µm")
