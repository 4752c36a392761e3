"""Numbers and lists as a sentence or a table has them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import isfinite

import pandas as pd

from stickslip_fit.machine import PRISMATIC
from stickslip_fit.units import format_uncertain, format_value, from_si

MINUS = "\N{MINUS SIGN}"
NO_BREAK = "\N{NO-BREAK SPACE}"
UNKNOWN = "not known"
DECIMALS = {"nm": 1, "µrad": 2}  # a tenth of what a traverse repeats to
_SPACED = re.compile(r"(?<=\d) (?=(nm|mm|µrad|%))")
_NEGATIVE = re.compile(r"(?<= )-(?=\d)")
SAME_ANGLE, SAME_PART = 1e-9, 1e-6  # rad; share of the travel


def step_unit(joint: int) -> str:
    """Unit in which people see a joint's step size."""
    return "nm" if joint == PRISMATIC else "µrad"


def joint_name(joint: int) -> str:
    """A joint with what kind it is.

    Examples
    --------
    >>> joint_name(3)
    'joint 3 (prismatic)'
    """
    return f"joint {joint} ({'prismatic' if joint == PRISMATIC else 'rotary'})"


def way(direction: str) -> str:
    """A direction's sign, typeset."""
    return MINUS if direction == "-" else direction


def percent(share: float) -> str:
    """A share in per cent, to two or three digits.

    Examples
    --------
    >>> [text.replace(NO_BREAK, " ") for text in (percent(0.0027), percent(-0.0786), percent(1.579))]
    ['0.27 %', '−7.9 %', '158 %']
    """
    return f"{percent_number(share)}{NO_BREAK}%" if isfinite(share) else UNKNOWN


def percent_number(share: float) -> str:
    """As `percent`, without its sign: for a column that has it in its head."""
    if not isfinite(share):
        return UNKNOWN
    value = 100 * abs(share)
    decimals = 2 if value < 0.995 else 1 if value < 99.5 else 0
    text = f"{value:.{decimals}f}"
    return f"{MINUS if share < 0 and float(text) else ''}{text}"


def number(value: float, unit: str) -> str:
    """An SI value in people's unit, the unit being in the column's head or after it.

    Examples
    --------
    >>> number(9.5731e-7, "nm"), number(-1.98e-5, "µrad")
    ('957.3', '−19.80')
    """
    return _bare(format_value(value, unit, DECIMALS[unit]), unit) if isfinite(value) else UNKNOWN


def quantity(value: float, unit: str) -> str:
    """A step size or an error of one, with its unit."""
    return f"{number(value, unit)}{NO_BREAK}{unit}" if isfinite(value) else UNKNOWN


def uncertain(value: float, error: float, unit: str) -> str:
    """An SI value with its standard error, the unit being in the column's head.

    Examples
    --------
    >>> uncertain(9.5731e-7, 1.234e-9, "nm")
    '957.3 ± 1.2'
    """
    return _bare(format_uncertain(value, error, unit), unit) if isfinite(value) else UNKNOWN


def _bare(text: str, unit: str) -> str:
    return text.removesuffix(f" {unit}")


def signed_percent(share: float) -> str:
    """As `percent`, with a plus sign where it is above zero.

    Examples
    --------
    >>> signed_percent(0.0786).replace(NO_BREAK, " ")
    '+7.9 %'
    """
    return f"{'+' if share > 0 else ''}{percent(share)}"


def plain(value: float) -> str:
    """A number as a person sets it: no needless digits.

    Examples
    --------
    >>> plain(-90.00000000000001), plain(0.5)
    ('−90', '0.5')
    """
    text = f"{round(value, 3) + 0.0:g}"
    return text.replace("-", MINUS)


def angle(value: float) -> str:
    """An angle in degrees.

    Examples
    --------
    >>> angle(-1.5707963267948966)
    '−90°'
    """
    return f"{plain(from_si(value, 'deg'))}°"


def length(value: float) -> str:
    """A length in mm."""
    return f"{plain(from_si(value, 'mm'))} mm"


def place(name: str, value: float) -> str:
    """One coordinate of a configuration.

    Examples
    --------
    >>> place("q3", 0.012), place("theta", 0.0)
    ('q3 = 12 mm', 'theta = 0°')
    """
    return f"{name} = {length(value) if name == 'q3' else angle(value)}"


def typeset(text: str) -> str:
    """A plain text as a page has it: angles in degrees, units kept with their numbers.

    Examples
    --------
    >>> typeset("theta -90 deg, q3 12 mm").replace(NO_BREAK, " ")
    'theta −90°, q3 12 mm'
    """
    return _SPACED.sub(NO_BREAK, _NEGATIVE.sub(MINUS, text).replace(" deg", "°"))


def count(how_many: int, what: str) -> str:
    """A number of things.

    Examples
    --------
    >>> count(1, "traverse"), count(12300, "traverse")
    ('1 traverse', '12,300 traverses')
    """
    return f"{how_many:,} {what}{'' if how_many == 1 else 's'}"


def listed(items: Sequence[str], last: str = "and") -> str:
    """Items in a sentence.

    Examples
    --------
    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def configuration(row: pd.Series, span: float) -> str:
    """Where everything stood while a joint moved; of a partial traverse its ends too.

    Parameters
    ----------
    row : Series
        joint, q1, q2, q3, theta, psi, start, stop (SI).
    span : float
        The joint's full travel.
    """
    joint = int(row["joint"])
    shown = ["q1"] if abs(row["q1"]) > SAME_ANGLE else []
    shown += [name for name in ("q2", "q3", "theta", "psi") if name != f"q{joint}"]
    parts = [f"{name} {length(row[name]) if name == 'q3' else angle(row[name])}" for name in shown]
    if abs(abs(row["stop"] - row["start"]) - span) > SAME_PART * span:
        ends = length if joint == PRISMATIC else angle
        parts.append(f"{ends(row['start'])} to {ends(row['stop'])}")
    return ", ".join(parts)
