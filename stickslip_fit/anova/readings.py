"""A log's usable traverses as readings of a step size, each with the configuration it was read at."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.laws import column, expected_steps, travel
from stickslip_fit.logs import Log
from stickslip_fit.machine import published_load
from stickslip_fit.units import from_si

UNITS = {"q1": "deg", "q2": "deg", "q3": "mm", "theta": "deg", "psi": "deg"}
HELD = ["q1", "q2", "q3", "theta", "psi", "low", "high"]
TURNED = ["q1", "q2", "q3", "load_low", "load_middle", "load_high", "low", "high"]
_DECIMALS, _LOAD_DECIMALS = 10, 6  # finer than anything that can be set


def readings(log: Log) -> pd.DataFrame:
    """The usable traverses of a log.

    Returns
    -------
    DataFrame
        The log's columns with plain text for session and direction, and step_size (rad or m per step),
        rounding (spread that the end stop's check adds to it), low and high (the stretch traversed),
        load_low, load_middle, load_high (published load along it), configuration and orientation
        (labels of where everything stood, and of how the base was turned).
    """
    rows = log.usable
    found = rows.astype({"session": object, "direction": object})
    seen = expected_steps(rows["steps"], rows["check_every"])
    found["step_size"] = travel(rows) / seen
    checked = np.where(rows["check_every"] > 1, rows["check_every"], 1)
    found["rounding"] = found["step_size"] * checked / np.sqrt(12.0) / seen
    found["low"], found["high"] = (
        np.minimum(rows["start"], rows["stop"]),
        np.maximum(rows["start"], rows["stop"]),
    )
    found[HELD] = found[HELD].round(_DECIMALS) + 0.0
    for joint in log.joints:
        mine = found["joint"] == joint
        for name, share in (("low", 0.0), ("middle", 0.5), ("high", 1.0)):
            found.loc[mine, f"load_{name}"] = _load(found[mine], joint, share)
    found["configuration"] = _labels(found, HELD)
    found["orientation"] = _labels(found, ["joint", "theta", "psi"])
    return found


def selected(rows: pd.DataFrame, joint: int | None, session: str | None) -> pd.DataFrame:
    """The readings of one joint, of one session, or of both.

    Raises
    ------
    InputError
        If there are none.
    """
    for name, wanted in (("joint", joint), ("session", session)):
        if wanted is not None:
            known = ", ".join(map(str, rows[name].unique()))
            rows = rows[rows[name] == wanted]
            if rows.empty:
                raise InputError(f"no usable traverse of {name} {wanted!r}; the log has {known or 'none'}")
    if rows.empty:
        raise InputError("the log has no usable traverse")
    return rows


def describe(row: pd.Series, span: float, names: list[str]) -> str:
    """Where things stood, of a partial traverse its ends too.

    Parameters
    ----------
    row : Series
        A reading.
    span : float
        The joint's full travel.
    names : list of str
        Of q1, q2, q3, theta, psi; the moving joint's own is left out.
    """
    parts = [place(name, row[name]) for name in names if name != f"q{row['joint']}"]
    if not np.isclose(row["high"] - row["low"], span, rtol=1e-6):
        unit = UNITS[f"q{row['joint']}"]
        parts.append(f"{_plain(row['low'], unit)} to {_plain(row['high'], unit)} {unit}")
    return ", ".join(parts)


def place(name: str, value: float) -> str:
    """One coordinate.

    Examples
    --------
    >>> place("q3", 0.012), place("psi", -1.5707963267948966)
    ('q3 12 mm', 'psi -90 deg')
    """
    return f"{name} {_plain(value, UNITS[name])} {UNITS[name]}"


def _plain(value: float, unit: str) -> str:
    return f"{round(from_si(float(value), unit), 4) + 0.0:g}"


def _load(rows: pd.DataFrame, joint: int, share: float) -> np.ndarray:
    at = (rows["low"] + share * (rows["high"] - rows["low"])).to_numpy()
    q1 = at if joint == 1 else column(rows, "q1")
    q2 = at if joint == 2 else column(rows, "q2")
    load = published_load(joint, q1, q2, column(rows, "theta"), column(rows, "psi"))
    return np.round(load, _LOAD_DECIMALS) + 0.0


def _labels(rows: pd.DataFrame, by: list[str]) -> pd.Series:
    """The same small text for rows that agree in all of `by`."""
    groups = rows.groupby(["joint", *[name for name in by if name != "joint"]], dropna=False, sort=False)
    return "c" + groups.ngroup().astype(str)
