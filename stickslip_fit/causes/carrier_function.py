"""Functions of one carrier in short expressions, and how a formula writes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.logs.history import (
    CHANGES,
    JOINT_NET_USE,
    JOINT_USE,
    MOVES,
    NET_USE,
    OTHER_USE,
    PAUSES,
    USE,
)
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.units import COORDINATE_UNITS, from_si, unit_of_difference

# Of carriers in formulas, where they have not their own.
FORMULA_NAMES = {
    "session_seconds": "session time",
    **{name: f"log(1 + {name.replace('_', ' ')} / s)" for name in PAUSES},
    **{name: f"travels in {seconds / 60.0:.0f} min" for name, seconds in USE.items()},
    **{name: f"own travels in {seconds / 60.0:.0f} min" for name, seconds in JOINT_USE.items()},
    **{name: f"other travels in {seconds / 60.0:.0f} min" for name, seconds in OTHER_USE.items()},
    **{name: f"net travels in {seconds / 60.0:.0f} min" for name, seconds in NET_USE.items()},
    **{name: f"own net travels in {seconds / 60.0:.0f} min" for name, seconds in JOINT_NET_USE.items()},
    **{
        name: f"{of} change in {s / 60.0:.0f} min".replace("_", " ")
        for name, (of, s) in (CHANGES | MOVES).items()
    },
}
EXPRESSIONS: dict[str, Callable[[Array], Array]] = {
    "x": lambda x: x,
    "x^2": np.square,
    "|x|": np.abs,
    "sin(x)": np.sin,
    "cos(x)": np.cos,
    "sin(2 x)": lambda x: np.sin(2.0 * x),
    "cos(2 x)": lambda x: np.cos(2.0 * x),
    "sin(3 x)": lambda x: np.sin(3.0 * x),
    "cos(3 x)": lambda x: np.cos(3.0 * x),
    "log(1 + x)": lambda x: np.log1p(np.maximum(x, 0.0)),
}


@dataclass(frozen=True)
class CarrierFunction:
    """A function of one carrier: an expression in (carrier - middle) / unit.

    Attributes
    ----------
    expression : str
        One of `EXPRESSIONS`.
    middle, unit : float
        SI; 0 and 1 for positions, angles and loads.
    shown : str
        Unit in which texts have the carrier; empty for a number without one.
    """

    expression: str
    carrier: str
    middle: float = 0.0
    unit: float = 1.0
    shown: str = ""

    def values(self, carrier: Array) -> Array:
        """From values of the carrier, of any shape; 0 where it is unknown."""
        return np.nan_to_num(EXPRESSIONS[self.expression]((carrier - self.middle) / self.unit))

    @property
    def is_plain(self) -> bool:
        """Whether it is of the carrier itself, with its unit, and not of a number."""
        return (self.middle, self.unit) == (0.0, 1.0) and self.shown in ("", *COORDINATE_UNITS)

    @property
    def powers(self) -> dict[str, int]:
        """The unit that it has itself, with its power; what is inside a sine or a logarithm has none."""
        power = {"x": 1, "|x|": 1, "x^2": 2}.get(self.expression, 0)
        return {self.shown: power} if self.is_plain and self.shown and power else {}

    def __str__(self) -> str:
        """As a formula that is true in the units shown.

        Examples
        --------
        >>> str(CarrierFunction("sin(2 x)", "q1", shown="deg"))
        'sin(2*q1)'
        >>> str(CarrierFunction("log(1 + x)", "session_seconds", 0.0, 5400.0, "h"))
        'log(1 + session time / 1.5 h)'
        >>> str(CarrierFunction("x^2", "temperature", 294.4, 1.25, "°C"))
        '((temperature - 21.25 °C) / 1.25 K)^2'
        """
        name = FORMULA_NAMES.get(self.carrier, self.carrier.replace("_", " "))
        name = self.carrier.removeprefix(COVARIATE_PREFIX) if ":" in self.carrier else name
        if self.is_plain:
            return write_expression(self.expression, name)
        apart = unit_of_difference(self.shown)
        middle = from_si(self.middle, self.shown) if self.middle and self.shown else self.middle
        unit = from_si(self.unit, apart) if self.shown else self.unit
        return write_expression(self.expression, write_quotient(name, middle, unit, self.shown, apart))


def write_quotient(name: str, middle: float, unit: float, beside: str = "", apart: str = "") -> str:
    """``(name - middle) / unit``, with the units of a value and of a difference where they have one."""
    value, size = (f"{abs(x):.10g} {symbol}".rstrip() for x, symbol in ((middle, beside), (unit, apart)))
    return f"({name} {'-' if middle > 0 else '+'} {value}) / {size}" if middle else f"{name} / {size}"


def write_expression(expression: str, inner: str) -> str:
    """An expression of what is inside it.

    Examples
    --------
    >>> write_expression("x", "load / 2"), write_expression("x^2", "q3"), write_expression("|x|", "load / 2")
    ('(load / 2)', 'q3^2', '|load / 2|')
    """
    breaks = {"x": "/", "x^2": " "}.get(expression)
    inner = f"({inner})" if breaks and breaks in inner else inner
    return expression.replace("2 x", "2*x").replace("3 x", "3*x").replace("x", inner)
