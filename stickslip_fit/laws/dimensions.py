"""Whether declared units fit together: what is added has one unit, functions take numbers, both sides agree.

Units are never converted, so that mm and m are different units here. A whole number or a half has no unit;
any other number, and one that is added, has whatever unit is needed (9.81).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from stickslip_fit._expression import CONSTANTS, Expression
from stickslip_fit.errors import InputError

_SAFE_UNIT = re.compile(r"[\w\s·*/^().µ°%²³⁻¹-]{1,60}")
_LONG_NUMBER = re.compile(r"\d{3}|(?:\*\*|\^)[^*^]*(?:\*\*|\^)\s*\(?\s*\d")
_SPELLINGS = {"°C": "kelvin", "%": "percent", "°": "degree", "²": "**2", "³": "**3", "·": "*"}
_OF_NUMBERS = ("exp", "log1p", "expm1", "sinh", "cosh", "tanh", "arcsin", "arccos", "arctan")
_OF_ANGLES = ("sin", "cos", "tan")
_ANY = None  # the unit of a number that may have any
SCALE_TOL = 1e-9
NOT_CONVERTED = (
    "units are not converted: a factor that converts one is written as a number with decimals, which may "
    "have any unit (0.001 * in place of / 1000, 0.0174533 * in place of pi / 180 *)"
)


def check_dimensions(
    expression: Expression, units: Mapping[str, str], expected: str, expected_name: str, where: str
) -> None:
    """Refuse an expression whose declared units do not fit together.

    Parameters
    ----------
    expression : Expression
    units : mapping of str to str
        Of every name; there is no check where one is missing or not known.
    expected : str
        The unit that it must have, which is that of `expected_name`.
    where : str
        The formula, for the message.

    Raises
    ------
    InputError
        With both sides.

    Examples
    --------
    >>> from stickslip_fit._expression import parse_expression
    >>> units = {"M": "kg", "acc": "m/s^2"}
    >>> check_dimensions(parse_expression("M*acc"), units, "V", "F", "F ~ M*acc")
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: the units of 'F ~ M*acc' do not agree: M * acc is kg m/s^2, F is V
    """
    if not all(name in units for name in expression.names):
        return
    known = {name: parse_unit(units[name]) for name in expression.names}
    wanted = parse_unit(expected)
    if wanted is None or any(unit is None for unit in known.values()):
        return
    dimensions = _Dimensions(known, where)
    for term in _terms(expression.tree):
        dimensions.compare(term, dimensions.unit(term), expected_name, wanted)


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def parse_unit(text: str) -> Any:
    """A unit as a quantity of size 1; None for what is not known, such as counts.

    Examples
    --------
    >>> parse_unit("N s/m").check("[mass]/[time]"), parse_unit("frogs") is None
    (True, True)
    """
    if text.strip() in ("", "1"):
        return _registry().Quantity(1.0)
    if not _SAFE_UNIT.fullmatch(text) or _LONG_NUMBER.search(text):
        return None
    for spelling, name in _SPELLINGS.items():
        text = text.replace(spelling, name)
    try:
        return _registry().Quantity(1.0, _registry().parse_units(text.strip()))
    except Exception:  # it raises many kinds, and a unit that it does not know is no fault
        return None


def _terms(node: ast.expr) -> Iterator[ast.expr]:
    """What is added up."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        yield from _terms(node.left)
        yield from _terms(node.right)
    else:
        yield node


@dataclass(frozen=True)
class _Dimensions:
    """The units of a formula's parts, from those of its names."""

    units: Mapping[str, Any]
    where: str

    def compare(self, node: ast.expr, unit: Any, other: str, wanted: Any) -> None:
        """Refuse a part whose unit differs from another's, also by a factor alone."""
        if isinstance(node, ast.Constant) or unit is _ANY or wanted is _ANY or _agree(unit, wanted):
            return
        factor = ""
        if unit.is_compatible_with(wanted):
            ratio = unit.to_base_units().magnitude / wanted.to_base_units().magnitude
            factor = f", which is another unit by a factor of {ratio:.6g}; {NOT_CONVERTED}"
        raise InputError(
            f"the units of {self.where!r} do not agree: {ast.unparse(node)} is {_show(unit)}, "
            f"{other} is {_show(wanted)}{factor}"
        )

    def unit(self, node: ast.expr) -> Any:
        """The unit of a part; `_ANY` for one that may have any."""
        match node:
            case ast.Constant(value=int() | float() as value):
                return self._number() if 4 * value == round(4 * value) else _ANY
            case ast.Name(id=name):
                return self._number() if name in CONSTANTS else self._named(name)
            case ast.UnaryOp(operand=operand):
                return self.unit(operand)
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(left, right)
            case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as sign, right=right):
                one, other = self.unit(left), self.unit(right)
                if one is _ANY or other is _ANY:
                    return _ANY
                return one * other if isinstance(sign, ast.Mult) else one / other
            case ast.BinOp(left=left, right=right):
                return self._same(left, right)
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return self._call(name, arguments)
        raise AssertionError(ast.dump(node))

    def _number(self) -> Any:
        return _registry().Quantity(1.0)

    def _named(self, name: str) -> Any:
        return self.units.get(name, _ANY)

    def _same(self, *parts: ast.expr) -> Any:
        """The unit of parts that must have the same one."""
        first, unit = parts[0], _ANY
        for part in parts:
            own = _ANY if isinstance(part, ast.Constant) else self.unit(part)
            if unit is _ANY:
                first, unit = part, own
            else:
                self.compare(part, own, ast.unparse(first), unit)
        return unit

    def _power(self, base: ast.expr, exponent: ast.expr) -> Any:
        unit = self.unit(base)
        try:
            power = float(ast.literal_eval(exponent))
        except ValueError:
            self._require_number("an exponent", exponent)
            self._require_number("a power that is not a number", base)
            return self._number()
        return _ANY if unit is _ANY else unit**power

    def _call(self, name: str, arguments: list[ast.expr]) -> Any:
        if name == "Q":
            return self._named(arguments[0].value)  # type: ignore[attr-defined]
        if name in ("abs", "min", "max"):
            return self._same(*arguments)
        if name in _OF_NUMBERS:
            self._require_number(name, arguments[0])
        if name in _OF_ANGLES:
            self._require_number(name, arguments[0], "rad")
        unit = self._same(*arguments)
        if name == "sqrt":
            return _ANY if unit is _ANY else unit**0.5
        return _ANY if name in ("log", "log10") else self._number()

    def _require_number(self, name: str, node: ast.expr, unit: str = "a number without a unit") -> None:
        own = self.unit(node)
        if own is not _ANY and not _agree(own, self._number()):
            way_out = f"; {NOT_CONVERTED}" if own.dimensionless else ""
            raise InputError(
                f"the units of {self.where!r} do not agree: {name} takes {unit}, and {ast.unparse(node)} "
                f"is {_show(own)}{way_out}"
            )


def _agree(one: Any, other: Any) -> bool:
    if not one.is_compatible_with(other):
        return False
    ratio = one.to_base_units().magnitude / other.to_base_units().magnitude
    return bool(abs(ratio - 1.0) < SCALE_TOL)


def _show(unit: Any) -> str:
    """A unit as people write it."""
    text = f"{unit.units:~C}".replace("**", "^").replace("*", " ")
    return text or "a number without a unit"
