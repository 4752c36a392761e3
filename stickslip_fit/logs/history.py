"""History of each traverse: the joint's previous direction and load, its steps, time in the session."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, Int64Array
from stickslip_fit.logs._table import label_codes, run_in_threads
from stickslip_fit.logs.fading import Fading, previous_rows
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.machine import Machine, load_machine, mean_load
from stickslip_fit.units import unit_of_difference

# What was driven not long ago: of any joint, of the same joint and of the others, and s in which it is
# forgotten.
USE = {f"use_{minutes}min": 60.0 * minutes for minutes in (5, 20, 80)}
JOINT_USE = {f"joint_{name}": seconds for name, seconds in USE.items()}
OTHER_USE = {f"other_{name}": seconds for name, seconds in USE.items()}
RECENT_USE = USE | JOINT_USE | OTHER_USE
# The same with the sign of the direction: what has crept, charged or moved one way and not yet come back.
NET_USE = {f"net_{name}": seconds for name, seconds in USE.items()}
JOINT_NET_USE = {f"joint_{name}": seconds for name, seconds in NET_USE.items()}
# The room's temperature as a body has it that follows so many s late.
LATE_TEMPERATURE = {f"temperature_{minutes}min": 60.0 * minutes for minutes in (10, 20, 40, 80)}
# How far a logged condition is from what it was: its name, and s in which a change is forgotten.
CHANGES = {
    f"{condition}_change_{minutes}min": (condition, 60.0 * minutes)
    for condition in CONDITIONS
    for minutes in (10, 40)
}
# The same of angles and of where the other joints stand: what gives way or relaxes after a move.
MOVES = {
    f"{coordinate}_change_{minutes}min": (coordinate, 60.0 * minutes)
    for coordinate in ("theta", "psi", "q1", "q2", "q3")
    for minutes in (10, 40)
}
# What conditions and coordinates were, which follows from their course, and its time constants, s.
PAST_SCALES = LATE_TEMPERATURE | {name: seconds for name, (_, seconds) in (CHANGES | MOVES).items()}
PAST = tuple(PAST_SCALES)
TIME_OF_DAY = "time_of_day"  # s since midnight: what the building, its sun and its people do
# Times since something, s.
PAUSES = ("pause", "joint_pause", "other_pause", "tilt_age")
# History on which no published cause depends.
FURTHER_HISTORY = (
    *("before_length", "before_gap", "before_joint", "other_load", *PAUSES),
    *("session_order", TIME_OF_DAY, "joint_travel"),
    *RECENT_USE,
    *NET_USE,
    *JOINT_NET_USE,
    *PAST,
)
# What the step size of the traverse before had beyond its law, and the time since that traverse.
DEPARTURES = {"departure_before": "pause", "joint_departure_before": "joint_pause"}
MAX_PASSES, DEPARTURE_TOL = 30, 1e-9  # of laws that follow departures
CLOSE_IN_TIME = 1e-3  # s
DAY_NS = 86_400 * 10**9


def condition_of(column: str) -> str:
    """The condition or coordinate whose past a column of history is; any other column itself."""
    return "temperature" if column in LATE_TEMPERATURE else (CHANGES | MOVES).get(column, (column,))[0]


def unit_of(column: str) -> str:
    """The unit in which a condition, a past or the time of day is shown; empty for any other column.

    Examples
    --------
    >>> unit_of("temperature_40min"), unit_of("temperature_change_40min")
    ('°C', 'K')
    """
    if column == TIME_OF_DAY:
        return "h"
    if column in MOVES:
        return "mm" if condition_of(column) == "q3" else "deg"
    condition = CONDITIONS.get(condition_of(column))
    unit = condition.unit if condition is not None else ""
    return unit_of_difference(unit) if column in CHANGES else unit


def add_history(rows: pd.DataFrame) -> pd.DataFrame:
    """Add the history columns to the rows of a whole log.

    Rows of every status count, since each wore the joint and left its load.

    Parameters
    ----------
    rows : DataFrame
        Of an arm of the published geometry, sorted by time; session, time, joint, direction, steps, q1, q2,
        theta, psi, start, stop.

    Returns
    -------
    DataFrame
        With ``steps_before`` (of the same joint in the whole log) and what `add_session_history` adds.
    """
    driven = steps_before(rows["joint"].to_numpy(), rows["steps"].to_numpy())
    session, _ = pd.factorize(rows["session"])
    return add_session_history(rows, session).assign(steps_before=driven)


def add_session_history(
    rows: pd.DataFrame, session: Int64Array, machine: Machine | None = None
) -> pd.DataFrame:
    """Add the history within sessions, which `session`, shape (n,), numbers; rows of whole sessions only.

    Of the same joint's traverse before: ``before_direction`` ('+', '-', or '' for a joint's first in its
    session), ``before_load`` (its published load, averaged over its positions; 0 for the first, NaN on a
    machine without the published geometry), ``before_length`` and ``before_gap`` (how long it was, and how
    far from its stop this one starts, as shares of the joint's travel), ``joint_pause`` (s from its start).
    Of the traverse before of any joint: ``before_joint`` and ``pause`` (s from its start); of any other one:
    ``other_pause`` and ``other_load`` (s from its start, and its published load). All but the first two are
    NaN for a first traverse. Of the session: ``session_seconds`` and ``session_order``, time and traverses
    since its first one; ``time_of_day``, s since midnight; ``joint_travel``, the lengths of the joint's own
    traverses in it so far together, as shares of its travel; ``tilt_age``, time since the first one with this
    theta and psi without another tilt between; the columns of `RECENT_USE`: the lengths of its traverses so
    far, as shares of their joints' travel, each times exp(-age / s), see `Fading.sum_before`; those of
    `NET_USE` and `JOINT_NET_USE`, the same with the sign of each direction; those of `LATE_TEMPERATURE`, see
    `Fading.follow`; those of `CHANGES`, a condition less what it is with such a lag; and those of `MOVES`,
    the same of an angle or of where a joint stands, NaN where that joint moves and on a machine without the
    published geometry.
    """
    joint = rows["joint"].to_numpy()
    time = rows["time"].to_numpy(dtype="datetime64[ns]").view(np.int64)
    backwards = (rows["direction"] == "-").to_numpy()
    has_load = machine is None or machine.has_published_geometry
    direction, load = np.full(len(rows), -1), np.full(len(rows), 0.0 if has_load else np.nan)
    loads = np.full(len(rows), np.nan)

    def fill_joint(number: int) -> None:
        subset = np.flatnonzero(joint == number)
        before = previous_rows(session[subset])
        has_previous = before >= 0
        direction[subset] = np.where(has_previous, backwards[subset][before], -1)
        if not has_load:
            return
        names = ("start", "stop", "q1", "q2", "theta", "psi")
        loads[subset] = mean_load(number, *(rows[name].to_numpy()[subset] for name in names))
        load[subset] = np.where(has_previous, loads[subset][before], 0.0)

    # No two joints share a row, so that threads never write the same one.
    run_in_threads({f"q{number}": partial(fill_joint, int(number)) for number in np.unique(joint)}, len(rows))
    began = np.zeros(session.max(initial=0) + 1, np.int64)
    # Rows are in the order of time: assigned from last to first, each session keeps its first time.
    began[session[::-1]] = time[::-1]
    number = pd.Series(session).groupby(session).cumcount().to_numpy()
    seconds, of_day = (np.asarray(one, np.float64) / 1e9 for one in (time - began[session], time % DAY_NS))
    start, stop = (rows[name].to_numpy(float) for name in ("start", "stop"))
    span = np.array([(machine or load_machine()).span(int(one)) for one in np.unique(joint)])
    travel = span[np.searchsorted(np.unique(joint), joint)]
    of_joint = session * (joint.max(initial=0) + 1) + joint
    own, last = previous_rows(of_joint), previous_rows(session)
    length = np.abs(stop - start) / travel
    signed = np.where(backwards, -length, length)
    series = {name: rows[name].to_numpy(float) for name in ("temperature", *CONDITIONS) if name in rows}
    series.setdefault("temperature", np.full(len(rows), np.nan))
    moving = {f"q{number}": joint == number for number in (1, 2, 3)}
    if has_load:
        series |= {name: rows[name].to_numpy(float) for name in ("theta", "psi")}
        series |= {name: np.where(own, start, rows[name].to_numpy(float)) for name, own in moving.items()}
    scales = sorted({*USE.values(), *PAST_SCALES.values()})
    tasks = {
        **{f"{s} s": partial(_fade, Fading(seconds, session, s), length, signed, "", series) for s in scales},
        **{
            f"{s} s, each joint": partial(_fade, Fading(seconds, of_joint, s), length, signed, "joint_", {})
            for s in USE.values()
        },
    }
    fades = {
        name: values for one in run_in_threads(tasks, len(rows)).values() for name, values in one.items()
    }
    fades |= {
        name: np.where(moving[of], np.nan, fades[name])
        for name, (of, _) in MOVES.items()
        if name in fades and of in moving
    }
    others = {f"other_{name}": np.maximum(fades[name] - fades[f"joint_{name}"], 0.0) for name in USE}
    other = last[first_of_run(session, joint)]
    since = seconds - seconds[first_of_run(session, _number_tilts(rows))]
    return rows.assign(
        before_direction=label_codes(direction, ("+", "-")).set_axis(rows.index),
        before_load=load,
        before_length=np.where(own >= 0, length[own], np.nan),
        before_gap=np.where(own >= 0, np.abs(start - stop[own]) / travel, np.nan),
        before_joint=np.where(last >= 0, joint[last], np.nan),
        pause=np.where(last >= 0, seconds - seconds[last], np.nan),
        joint_pause=np.where(own >= 0, seconds - seconds[own], np.nan),
        session_seconds=seconds,
        session_order=number.astype(float),
        time_of_day=of_day,
        joint_travel=pd.Series(length).groupby(of_joint).cumsum().to_numpy() - length,
        other_load=np.where(other >= 0, loads[other], np.nan),
        other_pause=np.where(other >= 0, seconds - seconds[other], np.nan),
        tilt_age=since if has_load else np.nan,
        **fades,
        **others,
    )


def _fade(
    fading: Fading, length: Array, signed: Array, whose: str, series: Mapping[str, Array]
) -> dict[str, Array]:
    """The columns of one time constant: of what was driven, and of what conditions and coordinates were.

    Lengths with and without the sign of the direction, and series by name, have shape (n,).
    """
    columns = {}
    for name, scale in USE.items():
        if scale == fading.scale:
            columns[f"{whose}{name}"] = fading.sum_before(length)
            columns[f"{whose}net_{name}"] = fading.sum_before(signed)
    for of, values in series.items():
        own = [name for name, s in PAST_SCALES.items() if s == fading.scale and condition_of(name) == of]
        if own:
            late = fading.follow(values) if np.isfinite(values).any() else np.full(len(values), np.nan)
            columns |= {name: late if name in LATE_TEMPERATURE else values - late for name in own}
    return columns


def _number_tilts(rows: pd.DataFrame) -> Int64Array:
    """The same number for the same theta and psi, shape (n,); 0 where there are none."""
    tilts = [pd.factorize(rows[name])[0].astype(np.int64) for name in ("theta", "psi") if name in rows]
    return sum((len(rows) ** k * codes for k, codes in enumerate(tilts)), np.zeros(len(rows), np.int64))


def first_of_run(group: Int64Array, value: Int64Array) -> Int64Array:
    """Index of the first of the rows in the same group since when the value is what it is.

    Examples
    --------
    >>> first_of_run(np.array([0, 0, 1, 0, 0]), np.array([3, 3, 3, 2, 3]))
    array([0, 0, 2, 3, 4])
    """
    order = np.argsort(group, kind="stable")
    changed = (np.diff(group[order]) != 0) | (np.diff(value[order]) != 0)
    place = np.where(np.append(True, changed)[: len(order)], np.arange(len(order)), 0)
    first = np.empty_like(order)
    first[order] = order[np.maximum.accumulate(place)]
    return first


def add_departures(rows: pd.DataFrame, departures: Array) -> pd.DataFrame:
    """Add the columns of `DEPARTURES` from the departure of each traverse, shape (n,).

    A traverse whose predecessor is not among the rows keeps what the columns have; 0 without them.
    """
    columns = {}
    for name, pause in DEPARTURES.items():
        known = rows[name].to_numpy(float) if name in rows else np.zeros(len(rows))
        if not {"session_seconds", pause} <= {*rows.columns}:
            columns[name] = known
            continue
        chain = ["session"] if pause == "pause" else ["session", "joint"]
        before = previous_rows(rows.groupby(chain, observed=True).ngroup().to_numpy(np.int64))
        at = rows["session_seconds"].to_numpy(float)
        is_before = np.abs(at - at[before] - rows[pause].to_numpy(float)) < CLOSE_IN_TIME
        columns[name] = np.where((before >= 0) & is_before, departures[before], known)
    return rows.assign(**columns)


def follow_departures(
    rows: pd.DataFrame, depart: Callable[[pd.DataFrame], Array], n_passes: int = MAX_PASSES
) -> pd.DataFrame:
    """Rows with the columns of `DEPARTURES` that agree with the departures that follow from them.

    `depart` goes from rows with these columns to the departure of each traverse from its law, shape (n,),
    relative, of its step size.
    """
    departures = np.zeros(len(rows))
    for _ in range(n_passes):
        rows, before = add_departures(rows, departures), departures
        departures = depart(rows)
        if np.abs(departures - before).max(initial=0.0) < DEPARTURE_TOL:
            break
    return rows


def add_unknown_history(rows: pd.DataFrame) -> pd.DataFrame:
    """Add the history columns to rows of which nobody knows the order: all missing.

    The rows are put in an order that follows from their content alone, by session and joint first.
    """
    content = ["session", "joint", "direction", "start", "stop", "steps"]
    return rows.sort_values(content, ignore_index=True, kind="stable").assign(
        before_direction=pd.Series(pd.NA, rows.index, dtype="str"),
        steps_before=np.nan,
        **dict.fromkeys(("before_load", "session_seconds", *FURTHER_HISTORY), np.nan),
    )


def steps_before(joint: Int64Array, steps: Int64Array) -> Int64Array:
    """Sum the steps of the same joint in the rows before.

    Examples
    --------
    >>> steps_before(np.array([3, 2, 3, 3]), np.array([10, 500, 20, 30]))
    array([ 0,  0, 10, 30])
    """
    driven = np.zeros(len(joint), np.int64)
    for number in np.unique(joint):
        subset = np.flatnonzero(joint == number)
        driven[subset] = np.cumsum(steps[subset]) - steps[subset]
    return driven
