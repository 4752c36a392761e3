"""A log as it was read: the mean step size of every traverse, in the order in which they were made."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import step_unit
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.laws import expected_steps, travel
from stickslip_fit.logs import Log
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    GREY,
    LEGEND_LINE,
    canvas,
    key_line,
    legend,
    look,
)
from stickslip_fit.units import from_si

MARKS = {"+": "o", "-": "s"}
MOST_LABELS = 10  # session names that there is room for, side by side


def plot_readings(log: Log) -> Figure:
    """A panel for each joint, sessions one after the other; what may not be fitted is left out.

    Raises
    ------
    InputError
        If no traverse is usable.
    """
    rows = log.usable
    if rows.empty:
        raise InputError("there is nothing to draw: the log has no usable traverse")
    joints = sorted(int(joint) for joint in rows["joint"].unique())
    step = travel(rows) / expected_steps(rows["steps"], rows["check_every"])
    with look():
        figure, axes = canvas(
            [1.15] * len(joints), 1, top=LEGEND_LINE + 0.14, bottom=0.3, down=0.14, share_x="col"
        )
        for axis, joint in zip(axes[:, 0], joints, strict=True):
            for sign, colour in DIRECTION_COLOURS.items():
                mine = np.flatnonzero((rows["joint"] == joint) & (rows["direction"] == sign))
                axis.plot(
                    mine, from_si(step[mine], step_unit(joint)), MARKS[sign], color=colour, ms=2.2, mew=0
                )
            axis.set_ylabel(f"joint {joint} ({step_unit(joint)})")
            axis.grid(visible=False, axis="x")
        _sessions(axes[:, 0], log)
        figure.align_ylabels(axes[:, 0])
        legend(
            figure,
            [
                key_line(f"mean step, direction {way(sign)}", colour, marker=MARKS[sign])
                for sign, colour in DIRECTION_COLOURS.items()
            ],
        )
    return on_white(figure)


def _sessions(axes: np.ndarray, log: Log) -> None:
    """Lines between sessions, and their names below, as many as there is room for."""
    names = log.usable["session"].to_numpy(object)
    begins = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
    ends = np.r_[begins[1:], len(names)]
    for axis in axes:
        for begin in begins[1:]:
            axis.axvline(begin - 0.5, color=GREY, lw=0.7)
        axis.tick_params(axis="x", length=0)
    kept = slice(None, None, -(-len(begins) // MOST_LABELS))
    last: Axes = axes[-1]
    labels = [shorten(str(names[begin]), 12) for begin in begins[kept]]
    last.set_xticks((begins[kept] + ends[kept] - 1) / 2, labels)
    last.set_xlim(-1, len(names))
