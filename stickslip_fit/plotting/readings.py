"""Figures of measured step sizes without a model: in order of time, and against any quantity of the log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import coordinate_unit, joint_name, step_unit
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.errors import InputError, shorten, suggest
from stickslip_fit.laws import expected_steps, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, has_times, position_columns
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    GREY,
    MAX_SESSION_LABELS,
    TITLE_LINE,
    direction_entries,
    make_figure,
    report_style,
    set_angle_ticks,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_picture, name_traverses
from stickslip_fit.units import from_si

DIRECTION_MARKERS = {"+": "o", "-": "s"}
HOURS = "hours"
MAX_POINTS = 900  # of a joint and direction, on a page


def readings_picture(log: Log) -> Picture:
    """The mean step size of each usable traverse, at most `MAX_POINTS` of each joint and direction."""
    rows = log.usable
    most = int(rows.groupby(["joint", "direction"], observed=True).size().max())
    few = f"; of each joint and direction {MAX_POINTS}, chosen at random" * (most > MAX_POINTS)
    order = "time" if has_times(rows) else "the log"
    caption = f"{len(rows):,} usable traverses in order of {order}{few}. Vertical lines separate sessions."
    joints = sorted(int(joint) for joint in rows["joint"].unique())
    step = traverse_length(rows) / expected_steps(rows["steps"], rows["check_every"])
    figure = _draw_in_order(log, joints, step, MAX_POINTS)
    return make_picture("readings", "Mean step size of each traverse", caption, figure)


def plot_step_sizes(log: Log, column: str | None) -> Figure:
    """Mean step sizes of a log's usable traverses, a panel for each joint.

    Parameters
    ----------
    column : str or None
        A position, angle, condition or further column of the log without its unit, or ``hours`` since the
        session began; of the moving joint's own position the middle of the traverse. None: in order of
        time, sessions one after the other.

    Raises
    ------
    InputError
        If no traverse is usable, or there is no such column.
    """
    rows = log.usable
    if rows.empty:
        raise InputError("there is nothing to draw: the log has no usable traverse")
    joints = sorted(int(joint) for joint in rows["joint"].unique())
    step = traverse_length(rows) / expected_steps(rows["steps"], rows["check_every"])
    return _draw_in_order(log, joints, step) if column is None else _draw_against(log, joints, step, column)


def _draw_in_order(log: Log, joints: Sequence[int], step: Array, most: int | None = None) -> Figure:
    """A panel for each joint; `most` points of a joint and direction, named for a page, or all without it."""
    rows = log.usable
    with report_style():
        figure, axes = make_figure([1.15] * len(joints), 1, _direction_legend(), bottom=0.3, down=0.14)
        for axis, joint in zip(axes[:, 0], joints, strict=True):
            for sign in DIRECTION_COLOURS:
                own = rows[(rows["joint"] == joint) & (rows["direction"] == sign)]
                subset = (own if most is None else thin_rows(own, most)).index.to_numpy()
                y = from_si(step[subset], step_unit(joint, log.machine))
                name_traverses(_draw_points(axis, subset, y, sign), subset)
            axis.set_ylabel(f"joint {joint} ({step_unit(joint, log.machine)})")
            axis.grid(visible=False, axis="x")
        _draw_sessions(axes[:, 0], log)
        figure.align_ylabels(axes[:, 0])
    return figure


def _draw_against(log: Log, joints: Sequence[int], step: Array, column: str) -> Figure:
    rows = log.usable
    label, values = _find_column(rows, column, log)
    with report_style():
        figure, axes = make_figure(
            [1.6], len(joints), _direction_legend(), top=TITLE_LINE + 0.14, across=0.5, share_y=False
        )
        for axis, joint in zip(axes[0], joints, strict=True):
            unit, known = step_unit(joint, log.machine), np.isfinite(values)
            for sign in DIRECTION_COLOURS:
                subset = np.flatnonzero((rows["joint"] == joint) & (rows["direction"] == sign) & known)
                _draw_points(axis, values[subset], from_si(step[subset], unit), sign)
            axis.set_title(joint_name(joint, log.machine))
            axis.set_xlabel(label)
            axis.set_ylabel(f"mean step size ({unit})")
            shown = values[known & (rows["joint"] == joint).to_numpy()]
            if "°)" in label and len(shown):
                set_angle_ticks(axis, float(shown.min()), float(shown.max()), 5)
    return figure


def _direction_legend() -> list[Line2D]:
    return [
        *direction_entries(DIRECTION_MARKERS["+"], label="direction {}", signs="+"),
        *direction_entries(DIRECTION_MARKERS["-"], label="direction {}", signs="-"),
    ]


def _draw_points(axis: Axes, x: Array | IntArray, y: Array, sign: str) -> Line2D:
    (points,) = axis.plot(x, y, DIRECTION_MARKERS[sign], color=DIRECTION_COLOURS[sign], ms=2.2, mew=0)
    return points


def _find_column(rows: pd.DataFrame, column: str, log: Log) -> tuple[str, Array]:
    """Axis label and values of a quantity by its name, in people's units."""
    if column in position_columns(rows):
        unit = coordinate_unit(column, log.machine)
        values = rows[column].to_numpy(float)
        if column.startswith("q"):
            middle = ((rows["start"] + rows["stop"]) / 2).to_numpy(float)
            values = np.where(rows["joint"] == int(column[1:]), middle, values)
        return f"{column} ({'°' if unit == 'deg' else unit})", from_si(values, unit)
    if column in CONDITIONS and column in rows:
        condition = CONDITIONS[column]
        return condition.axis, from_si(rows[column].to_numpy(float), condition.unit)
    if column == HOURS and has_times(rows):
        return "hours in session", from_si(rows["session_seconds"].to_numpy(float), "h")
    if COVARIATE_PREFIX + column in rows:
        return column, rows[COVARIATE_PREFIX + column].to_numpy(float)
    raise InputError(_explain_unknown_column(rows, column))


def _explain_unknown_column(rows: pd.DataFrame, column: str) -> str:
    names = [*position_columns(rows), *(name for name in CONDITIONS if name in rows)]
    names += [HOURS] * has_times(rows)
    names += [name.removeprefix(COVARIATE_PREFIX) for name in rows if name.startswith(COVARIATE_PREFIX)]
    return f"no column {column!r} to draw against: columns are {', '.join(names)}{suggest(column, names)}"


def _draw_sessions(axes: np.ndarray, log: Log) -> None:
    """Lines between sessions, and their names below, as many as there is space for."""
    names = log.usable["session"].to_numpy(object)
    begins = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
    ends = np.r_[begins[1:], len(names)]
    for axis in axes:
        for begin in begins[1:]:
            axis.axvline(begin - 0.5, color=GREY, lw=0.7)
        axis.tick_params(axis="x", length=0)
    kept = slice(None, None, -(-len(begins) // MAX_SESSION_LABELS))
    last: Axes = axes[-1]
    labels = [shorten(str(names[begin]), 12) for begin in begins[kept]]
    last.set_xticks((begins[kept] + ends[kept] - 1) / 2, labels)
    last.set_xlim(-1, len(names))
