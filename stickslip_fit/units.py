"""Units of measurement: the package computes in SI, and `to_si` and `from_si` convert at its edge."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from math import pi, prod
from typing import Self

import numpy as np


@dataclass(frozen=True)
class Unit:
    """A unit: ``SI = value * numerator / denominator + offset``.

    A ratio instead of one factor, so that 12 mm is the double nearest to 0.012.
    """

    symbol: str
    numerator: float = 1.0
    denominator: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Interval:
    """An estimate and its interval of 95 %, SI; NaN where it is not known."""

    estimate: float
    low: float
    high: float

    def times(self, factor: float) -> Interval:
        """All three times a factor."""
        return Interval(self.estimate * factor, self.low * factor, self.high * factor)


class TableUnit(str):
    """The unit of a table's column or parameter, any text: numbers in it are shown as they are.

    Examples
    --------
    >>> TableUnit("N"), TableUnit("1")  # a count is shown without
    ('N', '')
    """

    __slots__ = ()

    def __new__(cls, text: str) -> Self:
        """The unit of this text."""
        return super().__new__(cls, "" if text.strip() == "1" else text)


PRISMATIC = 3
CREDIBLE = 0.95  # probability that an interval holds
Z_95 = 1.959963984540054  # standard deviations on either side of 95 % of a normal distribution
JOINTS = (1, 2, PRISMATIC)

_UNIT_LIST = (
    Unit("1"),
    Unit("%", 1, 100),
    Unit("m"),
    Unit("mm", 1, 1_000),
    Unit("µm", 1, 1_000_000),
    Unit("nm", 1, 1_000_000_000),
    Unit("rad"),
    Unit("deg", pi, 180),
    Unit("mrad", 1, 1_000),
    Unit("µrad", 1, 1_000_000),
    Unit("µrad/mm", 1, 1_000),
    Unit("s"),
    Unit("ms", 1, 1_000),
    Unit("min", 60),
    Unit("h", 3_600),
    Unit("days", 86_400),
    Unit("weeks", 604_800),
    Unit("months", 2_629_800),
    Unit("years", 31_557_600),
    Unit("steps"),
    Unit("%/h", 1, 360_000),
    Unit("%/K", 1, 100),
    Unit("%/%"),
    Unit("%/V", 1, 100),
    Unit("%/g", 10),
    Unit("%/mm", 10),
    Unit("µrad/mm²"),
    Unit("µrad/deg", 180 / pi, 1_000_000),
    Unit("K"),
    Unit("°C", offset=273.15),
    Unit("V"),
    Unit("kg"),
    Unit("g", 1, 1_000),
    Unit("g mm²", 1, 1_000_000_000),
    Unit("N"),
    Unit("mN", 1, 1_000),
    Unit("N/µm", 1_000_000),
    Unit("N s/m"),
    Unit("mm/s", 1, 1_000),
    Unit("m/s²"),
    Unit("nm/V", 1, 1_000_000_000),
    Unit("Hz"),
    Unit("kHz", 1_000),
)
COORDINATE_UNITS = ("deg", "mm", "h")  # in which the positions of joints and the time are shown
MAX_POWER = 3  # of all of them together in a term: of a product of a square and another one


def share_per(powers: Mapping[str, int]) -> str:
    """The unit of a share for each unit of some coordinates, by their powers.

    Examples
    --------
    >>> share_per({}), share_per({"mm": 2}), share_per({"h": 1, "deg": 1})
    ('%', '%/mm²', '%/(deg h)')
    """
    exponents = {1: "", 2: "²", 3: "³"}
    below = [f"{name}{exponents[powers[name]]}" for name in COORDINATE_UNITS if powers.get(name)]
    return "%" if not below else f"%/{below[0]}" if len(below) == 1 else f"%/({' '.join(below)})"


def _shares_per(units: Mapping[str, Unit]) -> Iterator[Unit]:
    for powers in product(range(MAX_POWER + 1), repeat=len(COORDINATE_UNITS)):
        symbol = share_per(dict(zip(COORDINATE_UNITS, powers, strict=True)))
        if sum(powers) <= MAX_POWER and symbol not in units:
            below = [
                units[name]
                for name, power in zip(COORDINATE_UNITS, powers, strict=True)
                for _ in range(power)
            ]
            numerator, denominator = (
                prod(one.denominator for one in below),
                prod(one.numerator for one in below),
            )
            yield Unit(symbol, numerator, 100 * denominator)


_LISTED = {unit.symbol: unit for unit in _UNIT_LIST}
UNITS = _LISTED | {unit.symbol: unit for unit in _shares_per(_LISTED)}

# The spelling of a unit inside a column name or a TOML key, where µ and % are hard to type.
SUFFIXES = {
    "deg": "deg",
    "rad": "rad",
    "m": "m",
    "mm": "mm",
    "um": "µm",
    "nm": "nm",
    "C": "°C",
    "K": "K",
    "ms": "ms",
    "s": "s",
    "min": "min",
    "h": "h",
    "g": "g",
    "g_mm2": "g mm²",
    "kg": "kg",
    "pct": "%",
    "pct_per_K": "%/K",
    "V": "V",
    "urad": "µrad",
    "urad_per_mm": "µrad/mm",
    "N": "N",
    "mN": "mN",
    "N_per_um": "N/µm",
    "Ns_per_m": "N s/m",
    "mm_per_s": "mm/s",
    "nm_per_V": "nm/V",
    "Hz": "Hz",
    "kHz": "kHz",
}


# How people write units of time, in lower case.
TIME_SPELLINGS = {
    "s": {"s", "sec", "secs", "second", "seconds"},
    "ms": {"ms", "millis", "milliseconds"},
    "min": {"min", "mins", "minute", "minutes"},
    "h": {"h", "hr", "hrs", "hour", "hours"},
    "days": {"d", "day", "days"},
    "weeks": {"wk", "wks", "week", "weeks"},
    "months": {"month", "months"},
    "years": {"yr", "year", "years"},
}


def time_unit_of(name: str) -> str | None:
    """The unit of time that a column's name ends in, if it ends in one.

    Examples
    --------
    >>> [time_unit_of(name) for name in ("t_s", "time_min", "t (ms)", "Time [h]", "Year", "elapsed weeks")]
    ['s', 'min', 'ms', 'h', 'years', 'weeks']
    >>> time_unit_of("t")
    """
    ending = re.split(r"[\s_\[(/]+", name.strip(" ])").lower())[-1]
    return next((unit for unit, names in TIME_SPELLINGS.items() if ending in names), None)


def to_si[Number: (float, np.ndarray)](value: Number, symbol: str) -> Number:
    """Convert a value in the unit `symbol` to SI.

    Raises
    ------
    KeyError
        For a symbol that is not in `UNITS`.

    Examples
    --------
    >>> to_si(12.0, "mm")
    0.012
    >>> to_si(20.0, "°C")
    293.15
    """
    if isinstance(symbol, TableUnit):
        return value
    unit = UNITS[symbol]
    return value * unit.numerator / unit.denominator + unit.offset


def unit_of_difference(symbol: str) -> str:
    """The unit of a difference of values in a unit: degrees Celsius are apart by kelvins.

    Examples
    --------
    >>> unit_of_difference("°C"), unit_of_difference("ms")
    ('K', 'ms')
    """
    return "K" if symbol == "°C" else symbol


def from_si[Number: (float, np.ndarray)](value: Number, symbol: str) -> Number:
    """Convert an SI value to the unit `symbol`; the inverse of `to_si`.

    Examples
    --------
    >>> from_si(9.5e-05, "µrad")
    95.0
    """
    if isinstance(symbol, TableUnit):
        return value
    unit = UNITS[symbol]
    return (value - unit.offset) * unit.denominator / unit.numerator


__all__ = ["JOINTS", "PRISMATIC", "SUFFIXES", "UNITS", "Interval", "TableUnit", "Unit", "from_si", "to_si"]
