"""An estimate with its interval, and sizes as sentences have them: as many digits as the interval means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, isfinite, log10

from stickslip_fit.units.unit import UNITS, from_si

MINUS = "\N{MINUS SIGN}"
MOST_DECIMALS = 6
ENOUGH = 10.0  # from here on whole numbers, where nothing says how many digits mean something
NOT_KNOWN = "not known"
BESIDE = {"": "", "1": "", "%/%": " % per %"}


@dataclass(frozen=True)
class Interval:
    """An estimate and its interval of 95 %; NaN where it is not known."""

    estimate: float
    low: float
    high: float

    def times(self, factor: float) -> Interval:
        """All three times a factor."""
        return Interval(self.estimate * factor, self.low * factor, self.high * factor)


def percent(share: float) -> str:
    """A share in per cent, to two or three digits.

    Examples
    --------
    >>> percent(0.00284), percent(-0.0314), percent(1.58)
    ('0.28 %', '−3.1 %', '158 %')
    """
    if not isfinite(share):
        return NOT_KNOWN
    value = 100 * abs(share)
    text = f"{value:.{2 if value < 0.995 else 1 if value < 99.5 else 0}f}"
    return f"{MINUS if share < 0 and float(text) else ''}{text} %"


def probability(value: float) -> str:
    """A p-value.

    Examples
    --------
    >>> probability(0.00049975), probability(0.3124), probability(1.0)
    ('0.0005', '0.31', '1')
    """
    if value >= 0.995:
        return "1"
    return f"{value:.{2 if value >= 0.095 else 3 if value >= 0.00995 else 4}f}"


def decimals(interval: Interval, unit: str, further: int = 0) -> int:
    """Decimals of an estimate in a sentence: down to the first digit of its uncertainty, or further."""
    half = abs(_shown(interval.high, unit) - _shown(interval.low, unit)) / 2
    if not isfinite(half) or half <= 0:
        return 0 if abs(_shown(interval.estimate, unit)) >= ENOUGH else 2
    return min(max(0, further - floor(log10(half))), MOST_DECIMALS)


def amount(interval: Interval, unit: str, *, signed: bool = False) -> str:
    """An estimate with its unit; its size alone unless signed.

    Examples
    --------
    >>> amount(Interval(-0.0378, -0.0394, -0.0363), "%"), amount(Interval(4506.0, 4185.0, 4827.0), "min")
    ('3.8 %', '75 min')
    """
    value = interval.estimate if signed else abs(interval.estimate)
    return f"{number(value, unit, decimals(interval, unit))}{_tail(unit)}"


def spread(interval: Interval, unit: str, further: int = 0) -> str:
    """An interval without its unit, to the digits of its estimate in a table."""
    if not isfinite(interval.high - interval.low):
        return NOT_KNOWN
    digits = decimals(interval, unit, further)
    return f"{number(interval.low, unit, digits)} to {number(interval.high, unit, digits)}"


def number(value: float, unit: str, digits: int) -> str:
    """An SI value in people's unit, without that.

    Examples
    --------
    >>> number(-0.024227, "deg", 2)
    '−1.39'
    """
    if not isfinite(value):
        return NOT_KNOWN
    text = f"{_shown(value, unit):,.{digits}f}"
    if not text.startswith("-"):
        return text
    return f"{MINUS if float(text.replace(',', '')) else ''}{text[1:]}"


def way(direction: str | None) -> str:
    """A direction's sign, typeset."""
    return MINUS if direction == "-" else direction or ""


def listed(items: Sequence[str], last: str = "and") -> str:
    """Items in a sentence.

    Examples
    --------
    >>> listed(["a", "b", "c"], "or")
    'a, b or c'
    """
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def begun_large(text: str) -> str:
    """A text as a sentence begins."""
    return text[:1].upper() + text[1:]


def _shown(value: float, unit: str) -> float:
    return float(from_si(value, unit)) if unit in UNITS else value


def _tail(unit: str) -> str:
    return BESIDE.get(unit, f" {unit}")
