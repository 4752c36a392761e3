"""What came before each traverse: the joint's last direction and load, its steps, the session's time."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.logs._table import label_codes, run_in_threads
from stickslip_fit.machine import mean_load
from stickslip_fit.units import JOINTS


def add_history(rows: pd.DataFrame) -> pd.DataFrame:
    """Add the history columns to the rows of a whole log.

    Rows of every status count: whatever was driven wore the joint, and left its load behind.

    Parameters
    ----------
    rows : DataFrame
        Sorted by time; session, time, joint, direction, steps, q1, q2, theta, psi, start, stop.

    Returns
    -------
    DataFrame
        With ``steps_before`` (the joint's own in the whole log) and what `add_session_history` adds.
    """
    driven = steps_before(rows["joint"].to_numpy(), rows["steps"].to_numpy())
    session, _ = pd.factorize(rows["session"])
    return add_session_history(rows, session).assign(steps_before=driven)


def add_session_history(rows: pd.DataFrame, session: npt.NDArray[np.int64]) -> pd.DataFrame:
    """Add the history that no other session has a part in.

    Parameters
    ----------
    rows : DataFrame
        As for `add_history`, but of whole sessions only.
    session : array of int, shape (n,)
        A number for each session.

    Returns
    -------
    DataFrame
        With ``before_direction`` ('+', '-', or '' for a joint's first in its session), ``before_load``
        (the published load of that traverse, averaged over its positions; 0 for the first) and
        ``session_seconds`` (since the session's first traverse of any joint).
    """
    joint = rows["joint"].to_numpy()
    time = rows["time"].to_numpy(dtype="datetime64[ns]").view(np.int64)
    backwards = (rows["direction"] == "-").to_numpy()
    direction, load = np.full(len(rows), -1), np.zeros(len(rows))

    def look_back(each: int) -> None:
        subset = np.flatnonzero(joint == each)
        before = previous_rows(session[subset])
        known = before >= 0
        direction[subset] = np.where(known, backwards[subset][before], -1)
        load[subset] = np.where(known, _previous_loads(rows, subset, each)[before], 0.0)

    # No two joints share a row, so that they can be looked at side by side.
    found = run_in_threads(
        {
            "seconds": partial(_session_seconds, session, time),
            **{f"q{each}": partial(look_back, each) for each in JOINTS},
        }
    )
    return rows.assign(
        before_direction=label_codes(direction, ("+", "-")).set_axis(rows.index),
        before_load=load,
        session_seconds=found["seconds"],
    )


def previous_rows(group: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Row before each row in its own group, -1 for a group's first.

    Examples
    --------
    >>> previous_rows(np.array([7, 7, 2, 7, 2]))
    array([-1,  0, -1,  1,  2])
    """
    order = np.argsort(group, kind="stable")
    same = group[order[1:]] == group[order[:-1]]
    before = np.full(len(group), -1)
    before[order[1:][same]] = order[:-1][same]
    return before


def steps_before(joint: npt.NDArray[np.int64], steps: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Sum the steps of the same joint in the rows before.

    Examples
    --------
    >>> steps_before(np.array([3, 2, 3, 3]), np.array([10, 500, 20, 30]))
    array([ 0,  0, 10, 30])
    """
    driven = np.zeros(len(joint), np.int64)
    for each in JOINTS:
        subset = np.flatnonzero(joint == each)
        driven[subset] = np.cumsum(steps[subset]) - steps[subset]
    return driven


def _previous_loads(rows: pd.DataFrame, subset: npt.NDArray[np.intp], joint: int) -> npt.NDArray[np.float64]:
    names = ("start", "stop", "q1", "q2", "theta", "psi")
    return mean_load(joint, *(rows[name].to_numpy()[subset] for name in names))


def _session_seconds(session: npt.NDArray[np.int64], time: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    began = np.zeros(session.max(initial=0) + 1, np.int64)
    # Rows stand in the order of time: written from the last to the first, the first is what stays.
    began[session[::-1]] = time[::-1]
    return np.asarray(time - began[session], np.float64) / 1e9
