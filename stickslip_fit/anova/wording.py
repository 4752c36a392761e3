"""Numbers and names as sentences about factors have them."""

from __future__ import annotations

from collections.abc import Sequence

from stickslip_fit.anova.readings import step_unit
from stickslip_fit.units import format_value

DECIMALS = {"nm": 1, "µrad": 2}
MINUS = "\N{MINUS SIGN}"


def size(value: float, joint: int) -> str:
    """A step size, or a difference of two, with its unit.

    Examples
    --------
    >>> size(2.19e-8, 3)
    '21.9 nm'
    """
    unit = step_unit(joint)
    return format_value(value, unit, DECIMALS[unit])


def between(low: float, high: float, joint: int) -> str:
    """An interval of step sizes.

    Examples
    --------
    >>> between(-1e-9, 2e-9, 3)
    '−1.0 to 2.0 nm'
    """
    unit = step_unit(joint)
    return f"{size(low, joint).removesuffix(f' {unit}')} to {size(high, joint)}"


def share(value: float) -> str:
    """A share in per cent, to two digits.

    Examples
    --------
    >>> share(0.0264), share(0.123)
    ('2.6 %', '12 %')
    """
    decimals = 2 if abs(value) < 0.00995 else 1 if abs(value) < 0.0995 else 0
    return f"{100 * value:.{decimals}f} %"


def probability(value: float) -> str:
    """A p-value, with its equals sign.

    Examples
    --------
    >>> probability(0.0312), probability(1e-9), probability(0.00021)
    ('= 0.031', '< 0.0001', '= 0.0002')
    """
    if value < 1e-4:
        return "< 0.0001"
    return f"= {value:.{2 if value >= 0.095 else 3 if value >= 0.00095 else 4}f}"


def bare_probability(value: float) -> str:
    """As `probability`, for a column that says what it holds."""
    return probability(value).removeprefix("= ").replace("< ", "<")


def way(direction: str) -> str:
    """A direction's sign, typeset."""
    return MINUS if direction == "-" else direction


def listed(items: Sequence[str]) -> str:
    """Items in a sentence.

    Examples
    --------
    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
