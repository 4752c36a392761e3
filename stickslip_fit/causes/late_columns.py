"""Columns of a table as a body of one time constant sees them: late, as a heavy stage follows the room.

Each is named after the column and the time constant, ``"room 1.5 h late"``, so that a law which uses one can
make it from any table with that column and a time.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from stickslip_fit._format import LONG_TIMES, choose_time_unit
from stickslip_fit._typing import Array
from stickslip_fit.logs.fading import Fading
from stickslip_fit.units import UNITS

_LATE = re.compile(r"(?P<column>.+) (?P<size>[0-9.]+) (?P<unit>\S+) late")


def name_late(column: str, lag: float, time_unit: str) -> str:
    """Name of a column with a time constant in the unit of the table's time, to three digits.

    Examples
    --------
    >>> name_late("room", 5400.0, "s"), name_late("room", 12345.0, "min")
    ('room 5400 s late', 'room 12300 min late')
    >>> name_late("room", 7290.0, "s")
    'room 2.02 h late'
    """
    unit, size = choose_time_unit(lag, time_unit)
    return f"{column} {float(f'{lag / size:.3g}'):.10g} {unit} late"


def parse_late(name: str, time_unit: str) -> tuple[str, float] | None:
    """The column and the time constant of such a name; None of any other.

    Examples
    --------
    >>> parse_late("room 2.02 h late", "s")
    ('room', 7272.0)
    >>> parse_late("room", "s")
    """
    match = _LATE.fullmatch(name)
    if match is None:
        return None
    unit, column = match["unit"], match["column"]
    if unit == time_unit:
        return column, float(match["size"])
    if time_unit == "s" and unit in LONG_TIMES:
        return column, float(match["size"]) * float(UNITS[unit].numerator)
    return None


def find_late(names: Iterable[str], known: Iterable[str], time_unit: str) -> dict[str, tuple[str, float]]:
    """Those of some names that are of a column, late, with that column and the time constant.

    What is a `known` column itself is none.
    """
    known = set(known)
    parsed = {name: parse_late(name, time_unit) for name in names if name not in known}
    return {name: late for name, late in parsed.items() if late is not None}


def low_pass(rows: pd.DataFrame, values: Array, lag: float) -> Array:
    """Values as a body of one time constant follows them in each session, see `Fading`.

    Parameters
    ----------
    rows : DataFrame
        With session and session_seconds, those of each session in order of time.
    values : array, shape (n,)
    lag : float
        Time constant, in the unit of session_seconds.
    """
    session = pd.factorize(rows["session"].astype(object))[0].astype(np.int64)
    return Fading(rows["session_seconds"].to_numpy(float), session, lag).follow(values)


def with_late_columns(rows: pd.DataFrame, late: Mapping[str, tuple[str, float]]) -> pd.DataFrame:
    """The rows with columns as of `find_late`."""
    made = {name: low_pass(rows, rows[of].to_numpy(float), lag) for name, (of, lag) in late.items()}
    return rows.assign(**made) if made else rows
