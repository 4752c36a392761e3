"""Columns whose numbers look as if they were in another unit than their name says: a warning, no error.

Angles in a column of degrees look like radians if they stay within the joint's range in radians and either
all are whole degrees when they are read as radians, or there are many of them over half of that range and
hardly one is a round number of degrees. Lengths in a column of millimetres look like metres if all of them
stay within the joint's range in metres. Temperatures of a session look like degrees Fahrenheit or kelvins if,
read so, they are those of the other sessions, and else far from these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy import pi

from stickslip_fit._typing import Array
from stickslip_fit.logs._table import parse_numbers
from stickslip_fit.logs.schema import ORIENTATION, LogCells
from stickslip_fit.machine import Machine
from stickslip_fit.units import UNITS, from_si

WHOLE_DEG = 0.03  # deg; what three decimals of a radian leave
ROUND = 0.01  # deg; people write angles in degrees no finer
FEW, COARSE_DEG = 3, 5.0  # of fewer values each has to be a multiple of so many degrees
TURNS = (-2 * pi, 2 * pi)  # of the base
TEMPERATURE = "temperature"
KELVINS = UNITS["°C"].offset
# Of medians of sessions, K: in the unit that is suspected, and as they were read.
MAX_APART, MIN_OFF = 8.0, 20.0
MANY, MIN_SPREAD = 5, 0.5  # values of a joint, and the share of its range that they cover, in radians


def doubt_units(cells: LogCells, machine: Machine) -> Iterator[str]:
    """A sentence for each column of one file whose unit is in doubt."""
    rotary = [machine.ranges[joint] for joint in machine.joints if not machine.is_prismatic(joint)]
    widest = max(rotary, key=np.ptp, default=(0.0, 0.0))
    for joint in machine.joints:
        if machine.is_prismatic(joint):
            yield from _doubt_length(cells, f"q{joint}", max(map(abs, machine.ranges[joint])))
        else:
            yield from _doubt_angle(cells, f"q{joint}", machine.ranges[joint])
    for field in ("from_angle", "to_angle"):
        yield from _doubt_angle(cells, field, widest)
    for field in ORIENTATION:
        yield from _doubt_angle(cells, field, TURNS)


def doubt_temperatures(columns: Mapping[str, pd.Series[Any]]) -> Iterator[str]:
    """A sentence for each session whose temperatures look as if they were in another unit.

    `columns` are those of a log in SI, among them the session.
    """
    if TEMPERATURE not in columns:
        return
    celsius = pd.Series(from_si(columns[TEMPERATURE].to_numpy(float), "°C"))
    medians = celsius.groupby(columns["session"].to_numpy(object), sort=False).median().dropna()
    for session, own in medians.items():
        usual = float(medians.drop(session).median())
        if not abs(own - usual) > MIN_OFF:
            continue
        for unit, suspected in (("degrees Fahrenheit", (own - 32.0) / 1.8), ("kelvins", own - KELVINS)):
            if abs(suspected - usual) < MAX_APART:
                yield (
                    f"session {session}, temperature: the values look like {unit} (median {own:.1f}, that of "
                    f"the other sessions {usual:.1f}); they were read as degrees Celsius. If they are "
                    f"{unit}, convert them"
                )


def _doubt_angle(cells: LogCells, field: str, span: tuple[float, float]) -> Iterator[str]:
    values = _distinct(cells, field, "deg")
    if len(values) and look_like_radians(values, span):
        column, largest = cells.layout.known[field].name, float(max(values, key=abs))
        yield (
            f"{cells.table.file}, column {column}: the values look like radians ({largest:g} rad is "
            f"{from_si(largest, 'deg'):.4g} deg); they were read as degrees. If they are radians, name the "
            f"column {column.removesuffix('_deg')}_rad"
        )


def _doubt_length(cells: LogCells, field: str, limit: float) -> Iterator[str]:
    values = _distinct(cells, field, "mm")
    if len(values) and np.max(np.abs(values)) <= limit:
        column = cells.layout.known[field].name
        yield (
            f"{cells.table.file}, column {column}: the values look like metres (all within "
            f"±{np.max(np.abs(values)):.4g}); they were read as mm. If they are metres, name the column "
            f"{column.removesuffix('_mm')}_m"
        )


def look_like_radians(values: Array, span: tuple[float, float]) -> bool:
    """Whether distinct angles in degrees, without 0, look like radians; `span` is what they may be, rad.

    Examples
    --------
    >>> look_like_radians(np.array([1.5708, 0.5236]), TURNS)
    True
    >>> look_like_radians(np.array([1.5, 0.5, 2.25]), TURNS)
    False
    """
    if np.max(np.abs(values)) > max(map(abs, span)) * (1 + 1e-6):
        return False
    as_degrees = from_si(values, "deg")
    fine = np.abs(values - ROUND * np.round(values / ROUND)) > 1e-9
    step = 1.0 if len(values) >= FEW else COARSE_DEG
    whole = np.abs(as_degrees - step * np.round(as_degrees / step)) < WHOLE_DEG
    if fine.all() and whole.all():
        return True
    return len(values) >= MANY and bool(np.mean(fine) > 0.8) and np.ptp(values) > MIN_SPREAD * np.ptp(span)


def _distinct(cells: LogCells, field: str, unit: str) -> Array:
    """The values of a column in this unit, each once and without 0; none if its unit is another."""
    if not cells.has(field) or cells.layout.known[field].unit != unit:
        return np.zeros(0)
    values = parse_numbers(cells.table.column(cells.layout.known[field].name)).values
    return np.unique(values[np.isfinite(values) & (values != 0)])
