"""Numbers for people: an estimate with its uncertainty, to the digits that mean something."""

from __future__ import annotations

from math import floor, isfinite, log10

from stickslip_fit.units.unit import from_si

MISSING = "–"


def digits_for(uncertainty: float) -> int:
    """Decimals that show two significant digits of `uncertainty` below 30, else one (JCGM 100, 7.2.6).

    Examples
    --------
    >>> digits_for(0.123), digits_for(0.52), digits_for(47.0)
    (2, 1, 0)
    """
    if not isfinite(uncertainty) or uncertainty <= 0:
        return 1
    exponent = floor(log10(uncertainty))
    leading = uncertainty / 10.0**exponent
    return max(0, (1 if leading < 3.0 else 0) - exponent)


def format_value(value: float | None, symbol: str, decimals: int = 1) -> str:
    """An SI value in people's units, without uncertainty.

    Examples
    --------
    >>> format_value(9.573e-7, "nm")
    '957.3 nm'
    """
    if value is None or not isfinite(value):
        return MISSING
    return f"{_minus(f'{from_si(float(value), symbol):.{decimals}f}')}{_tail(symbol)}"


def format_uncertain(value: float | None, standard_error: float | None, symbol: str) -> str:
    """An SI value with its standard error, in people's units.

    Examples
    --------
    >>> format_uncertain(9.5731e-7, 1.234e-9, "nm")
    '957.3 ± 1.2 nm'
    >>> format_uncertain(9.5731e-7, None, "nm")
    '957.3 ± ? nm'
    """
    if value is None or not isfinite(value):
        return MISSING
    if standard_error is None or not isfinite(standard_error):
        decimals = 3 if symbol == "1" else 1
        return f"{_minus(f'{from_si(float(value), symbol):.{decimals}f}')} ± ?{_tail(symbol)}"
    spread = from_si(float(standard_error), symbol) if symbol != "°C" else standard_error
    decimals = digits_for(spread)
    shown = _minus(f"{from_si(float(value), symbol):.{decimals}f}")
    return f"{shown} ± {spread:.{decimals}f}{_tail(symbol)}"


def _tail(symbol: str) -> str:
    return "" if symbol == "1" else f" {symbol}"


def _minus(text: str) -> str:
    """A true minus sign, and no minus before a zero."""
    if text.startswith("-"):
        return text[1:] if float(text) == 0 else "\N{MINUS SIGN}" + text[1:]
    return text
