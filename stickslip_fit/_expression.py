"""Expression: a formula's text, read against a list of what it may hold, as numpy functions with derivatives.

Python's own parser builds the tree (`ast`), and nothing of it is ever run: a visitor accepts numbers, names,
operators and the functions of `FUNCTIONS`, and nothing else, and builds sympy's nodes one by one. Derivatives
are symbolic. Values and derivatives are computed together, so that what they have in common is computed once.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, reduce
from itertools import product
from typing import Any, NoReturn

import numpy as np

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.errors import InputError, shorten

MAX_LENGTH = 2_000  # characters
MAX_DEPTH = 30  # of the tree; a sum or product of many is flat
MAX_NODES = 400
MAX_POWER = 64  # of powers within powers, multiplied
MAX_NUMBER = 1e100
# Words of Python's expressions; its other keywords, such as lambda and yield, are names like any other.
RESERVED = frozenset(("and", "or", "not", "in", "is", "if", "else", "for", "True", "False", "None"))
_NAMES = re.compile(rf"""("[^"]*"|'[^']*')|\b({"|".join(set(keyword.kwlist) - RESERVED)})\b""")
CONSTANTS = {"pi": math.pi}


def _step(x: Array) -> Array:
    return np.heaviside(x, 0.5)


def _power_by_exponent(x: Array, exponent: Array) -> Array:
    """Derivative of x**exponent by the exponent; 0 at x = 0, as its limit is."""
    power = np.power(x, exponent)
    return np.where((x == 0) & (exponent > 0), 0.0, power * np.log(x))


Numpy = Callable[..., Array]
Derivatives = Callable[..., tuple[Any, ...]]
# Of each function: what computes it, and its derivatives by its arguments; `f` builds nodes of functions.
FUNCTIONS: dict[str, tuple[Numpy, Derivatives]] = {
    "abs": (np.abs, lambda f, x: (f["sign"](x),)),
    "sign": (np.sign, lambda f, x: (0,)),
    "step": (_step, lambda f, x: (0,)),
    "heaviside": (_step, lambda f, x: (0,)),
    "sqrt": (np.sqrt, lambda f, x: (0.5 / f["sqrt"](x),)),
    "exp": (np.exp, lambda f, x: (f["exp"](x),)),
    "log": (np.log, lambda f, x: (1 / x,)),
    "log10": (np.log10, lambda f, x: (1 / (np.log(10.0) * x),)),
    "log1p": (np.log1p, lambda f, x: (1 / (1 + x),)),
    "expm1": (np.expm1, lambda f, x: (f["exp"](x),)),
    "sin": (np.sin, lambda f, x: (f["cos"](x),)),
    "cos": (np.cos, lambda f, x: (-f["sin"](x),)),
    "tan": (np.tan, lambda f, x: (1 + f["tan"](x) ** 2,)),
    "arcsin": (np.arcsin, lambda f, x: (1 / f["sqrt"](1 - x**2),)),
    "arccos": (np.arccos, lambda f, x: (-1 / f["sqrt"](1 - x**2),)),
    "arctan": (np.arctan, lambda f, x: (1 / (1 + x**2),)),
    "arctan2": (np.arctan2, lambda f, y, x: (x / (x**2 + y**2), -y / (x**2 + y**2))),
    "sinh": (np.sinh, lambda f, x: (f["cosh"](x),)),
    "cosh": (np.cosh, lambda f, x: (f["sinh"](x),)),
    "tanh": (np.tanh, lambda f, x: (1 - f["tanh"](x) ** 2,)),
    "min": (np.minimum, lambda f, x, y: (f["step"](y - x), f["step"](x - y))),
    "max": (np.maximum, lambda f, x, y: (f["step"](x - y), f["step"](y - x))),
}
_POWERS: dict[str, tuple[Numpy, Derivatives]] = {
    "**": (np.power, lambda f, x, a: (a * f["**"](x, a - 1), f["** by exponent"](x, a))),
    "** by exponent": (_power_by_exponent, lambda f, x, a: (0, 0)),  # of which none is ever taken
}
GRAMMAR = f'numbers, names, Q("any name"), + - * / ** ( ), pi, and the functions {", ".join(FUNCTIONS)}'


def is_name(text: str) -> bool:
    """Whether a formula names a column so, without Q("...")."""
    return text.isidentifier() and text not in RESERVED


@dataclass(frozen=True)
class Expression:
    """An expression of names, as `parse_expression` reads it.

    Attributes
    ----------
    whole, offset : str, int
        The formula that it is a part of, and where it begins there, for messages.
    """

    text: str
    whole: str = ""
    offset: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """The names in the text, in their order."""
        return self._parsed[0]

    @property
    def node(self) -> Any:
        """The expression as a node of sympy."""
        return self._parsed[1]

    @property
    def tree(self) -> ast.expr:
        """The parser's tree of an expression that has been read."""
        return _Reader(self).tree()

    @property
    def is_name(self) -> bool:
        """Whether it is one name alone."""
        return bool(self.node.is_Symbol) and len(self.names) == 1

    @cached_property
    def active_names(self) -> frozenset[str]:
        """The names that do not cancel out."""
        return frozenset(symbol.name for symbol in self.node.free_symbols)

    def evaluate(self, quantities: Mapping[str, Any]) -> Array:
        """The expression's value.

        Parameters
        ----------
        quantities : mapping of str to array
            Of every name, of shapes that broadcast.
        """
        return self.function()(quantities)[0]

    def function(self, by: Sequence[str] = ()) -> Function:
        """From quantities by name to the value and its derivatives by the names of `by`, (..., len(by)).

        Examples
        --------
        >>> square = parse_expression("a * x**2").function(("a",))
        >>> value, slopes = square({"a": 3.0, "x": np.array([1.0, 2.0])})
        >>> value.tolist(), slopes.tolist()
        ([3.0, 12.0], [[1.0], [4.0]])
        """
        tape = _compile(self, tuple(by))

        def evaluate(quantities: Mapping[str, Any]) -> tuple[Array, Array]:
            value, *slopes = np.broadcast_arrays(*tape.run(quantities))
            stacked = np.stack(slopes, axis=-1) if slopes else np.zeros((*value.shape, 0))
            return value.copy(), stacked

        return evaluate

    def derivative(self, name: str) -> Any:
        """The derivative by a name, as a node of sympy."""
        return self.node.diff(_algebra().symbol(name))

    def slopes_that_move(self, by: Sequence[str]) -> BoolArray:
        """Whether the derivative by one name changes with another, (p, p), as their symbols tell.

        True, too, where a name decides on which side of a jump it is.

        Examples
        --------
        >>> parse_expression("a + b * exp(-k * x)").slopes_that_move(("a", "b", "k")).tolist()
        [[False, False, False], [False, False, True], [False, True, True]]
        """
        return _slopes_that_move(self, tuple(by))

    @cached_property
    def _parsed(self) -> tuple[tuple[str, ...], Any]:
        return _Reader(self).read()

    def __reduce__(self) -> tuple[Any, ...]:
        return Expression, (self.text, self.whole, self.offset)


Function = Callable[[Mapping[str, Any]], tuple[Array, Array]]


def parse_expression(text: str, whole: str = "", offset: int = 0) -> Expression:
    """Read an expression.

    Raises
    ------
    InputError
        With the position of what is wrong, for anything outside the grammar, and for what is too long, too
        deeply nested or not finite.

    Examples
    --------
    >>> parse_expression("Fv * vel + Fc * sign(vel)").names
    ('Fv', 'vel', 'Fc')
    >>> parse_expression("x + y(2)")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: the formula 'x + y(2)' cannot be used: at character 5, 'y' is no ...
    """
    expression = Expression(text, whole, offset)
    _ = expression.names
    return expression


_TILDE = re.compile(r"""(?:[^~"']|"[^"]*"|'[^']*')*""")


def parse_formula(text: str) -> tuple[Expression, Expression]:
    """Read ``response ~ expression``.

    Raises
    ------
    InputError
        See `parse_expression`; also without a ``~``.

    Examples
    --------
    >>> [side.text.strip() for side in parse_formula("log(F) ~ a + b * x")]
    ['log(F)', 'a + b * x']
    """
    if not isinstance(text, str):
        raise InputError(f"a formula is a text such as 'F ~ a + b*x', not {shorten(repr(text))}")
    _check_length(text)
    place = _TILDE.match(text).end()  # type: ignore[union-attr]
    if text[place : place + 1] != "~":
        equals = text.find("=")
        if equals >= 0:
            refuse(text, equals, "write ~ in place of =, as in F ~ a + b*x")
        refuse(text, len(text), "a ~ is missing between the response and what it follows from: F ~ a + b*x")
    left = parse_expression(text[:place], text)
    return left, parse_expression(text[place + 1 :], text, place + 1)


def refuse(text: str, position: int, reason: str, grammar: str = "") -> NoReturn:
    """Raise the InputError for a place in a formula; `position` counts characters from 0."""
    beside = f". A formula has {grammar}" if grammar else ""
    raise InputError(
        f"the formula {shorten(text)!r} cannot be used: at character {position + 1}, {reason}{beside}"
    )


def _check_length(text: str) -> None:
    if len(text) > MAX_LENGTH:
        raise InputError(f"the formula has {len(text):,} characters, more than {MAX_LENGTH:,}; shorten it")


class _Algebra:
    """sympy's nodes of names, numbers and functions; a function is known by its derivatives alone."""

    def __init__(self) -> None:
        import sympy

        self.sympy = sympy
        self.functions: dict[str, Any] = {}
        for name, (_, derivatives) in (FUNCTIONS | _POWERS).items():
            self.functions[name] = self._function(name, derivatives)
        self.no_number = (sympy.nan, sympy.zoo, sympy.oo, -sympy.oo)

    def symbol(self, name: str) -> Any:
        """A real symbol."""
        return self.sympy.Symbol(name, real=True)

    def number(self, value: float) -> Any:
        """A number with 53 bits, so that no product of numbers grows."""
        return self.sympy.Float(value)

    def _function(self, name: str, derivatives: Derivatives) -> Any:
        functions = self.functions

        def fdiff(node: Any, argindex: int = 1) -> Any:
            return self.sympy.S(derivatives(functions, *node.args)[argindex - 1])

        never = classmethod(lambda kind, argument: -1)  # numbers are computed before there is a node
        return type(
            name, (self.sympy.Function,), {"fdiff": fdiff, "_should_evalf": never, "formula_name": name}
        )


@cache
def _algebra() -> _Algebra:
    return _Algebra()


_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_FLAT = {"+": "+-", "-": "+-", "*": "*/", "/": "*/", "**": ""}  # on the left of an operator
_HINTS = {ast.BitXor: "a power is written **", ast.Invert: "a formula has one ~ only"}


class _Reader:
    """From the parser's tree to sympy's; constants are floats on the way, and computed as such."""

    def __init__(self, expression: Expression) -> None:
        self.whole, self.offset = expression.whole or expression.text, expression.offset
        stripped = expression.text.strip()
        self.offset += len(expression.text) - len(expression.text.lstrip())
        self.text = re.sub(r"[\n\r\f\t]", " ", stripped)
        self.places: dict[str, int] = {}
        self.nodes = 0

    def read(self) -> tuple[tuple[str, ...], Any]:
        """The names and the expression."""
        tree = self.tree()
        try:
            expression = _real(self._node(tree, 0, 1.0))
        except RecursionError:
            refuse(self.whole, self.offset, "it is nested too deep", GRAMMAR)
        return tuple(sorted(self.places, key=self.places.__getitem__)), expression

    def tree(self) -> ast.expr:
        """What Python's parser makes of the text; nothing of it is run."""
        _check_length(self.whole)
        if not self.text:
            refuse(self.whole, self.offset, "an expression is missing")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                # Of the same length, so that places are those in the text.
                parsed = _NAMES.sub(lambda found: found[1] or f"{found[2][:-1]}_", self.text)
                tree = ast.parse(parsed, mode="eval").body
        except SyntaxError as error:
            place = self.offset + max((error.offset or 1) - 1, 0)
            refuse(self.whole, place, f"it cannot be read ({error.msg})", GRAMMAR)
        except (ValueError, MemoryError, RecursionError) as error:
            refuse(self.whole, self.offset, f"it cannot be read ({error})", GRAMMAR)
        for node in ast.walk(tree):
            if isinstance(node, ast.Name):  # the parser's own name is normalized: µ is another letter
                node.id = self.text.encode()[node.col_offset : node.end_col_offset].decode()
        return tree

    def refuse(self, node: ast.AST, reason: str) -> NoReturn:
        """Raise the InputError for a node."""
        column = len(self.text.encode()[: node.col_offset].decode(errors="ignore"))  # type: ignore[attr-defined]
        refuse(self.whole, self.offset + column, reason, GRAMMAR)

    def _node(self, node: ast.AST, depth: int, power: float) -> Any:
        self.nodes += 1
        if depth > MAX_DEPTH:
            self.refuse(node, f"it is nested more than {MAX_DEPTH} deep")
        if self.nodes > MAX_NODES:
            self.refuse(node, f"there are more than {MAX_NODES} names, numbers and signs")
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return self._number(node, number)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
                value = self._node(operand, depth + 1, power)
                return -value if isinstance(sign, ast.USub) else value
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
                return self._binary(node, left, _OPERATORS[type(operator)], right, depth, power)
            case ast.Call(func=ast.Name() as called, args=arguments):
                return self._call(node, called, arguments, depth, power)
        self.refuse(node, self._reason(node))

    def _reason(self, node: ast.AST) -> str:
        hint = _HINTS.get(type(getattr(node, "op", None) or node))
        if hint:
            return hint
        what = shorten(ast.get_source_segment(self.text, node) or "", 30)
        if isinstance(node, ast.Call):
            node = node.func
        if isinstance(node, ast.Attribute) and node.attr in FUNCTIONS:
            return f"write {node.attr}(...) alone in place of {what!r}"
        return f"{what!r} is not part of a formula"

    def _name(self, node: ast.expr, name: str) -> Any:
        if name in CONSTANTS and isinstance(node, ast.Name):
            return CONSTANTS[name]
        self.places[name] = min(node.col_offset, self.places.get(name, node.col_offset))
        return _algebra().symbol(name)

    def _number(self, node: ast.AST, number: float) -> float:
        try:
            value = float(number)
        except OverflowError:
            value = math.inf
        if not abs(value) <= MAX_NUMBER:
            self.refuse(node, f"numbers are at most {MAX_NUMBER:g}")
        return value

    def _binary(
        self, node: ast.AST, left: ast.AST, sign: str, right: ast.AST, depth: int, power: float
    ) -> Any:
        exponent = self._node(right, depth + 1, power)
        is_whole = isinstance(exponent, float) and exponent == round(exponent)
        within = power * max(1.0, abs(exponent)) if sign == "**" and is_whole else power
        if within > MAX_POWER:
            self.refuse(right, f"powers within powers come to more than {MAX_POWER}")
        flat = isinstance(left, ast.BinOp) and _OPERATORS.get(type(left.op)) in (*_FLAT[sign],)
        base = self._node(left, depth if flat else depth + 1, within)
        both = base, exponent
        if all(isinstance(value, float) for value in both):
            return self._constant(node, _ARITHMETIC[sign], both)
        if sign == "**":
            if is_whole:
                return self._finite(node, _real(base) ** int(exponent))
            return _algebra().functions["**"](*map(_real, both))
        if sign == "/" and isinstance(exponent, float) and exponent == 0.0:
            self.refuse(right, "this divides by zero")
        return self._finite(node, _ARITHMETIC[sign](*map(_real, both)))

    def _call(
        self, node: ast.Call, called: ast.Name, arguments: Sequence[ast.AST], depth: int, power: float
    ) -> Any:
        name = called.id
        if name == "Q" and not node.keywords:
            if len(arguments) == 1 and isinstance(arguments[0], ast.Constant):
                quoted = arguments[0].value
                if isinstance(quoted, str) and quoted:
                    return self._name(node, quoted)
            self.refuse(node, "Q(...) takes the name of a column in quotes")
        if name not in FUNCTIONS:
            self.refuse(node, f"{shorten(name)!r} is no function of a formula")
        function, derivatives = FUNCTIONS[name]
        needed = derivatives.__code__.co_argcount - 1
        several = name in ("min", "max")
        if node.keywords or not (len(arguments) == needed or (several and len(arguments) > needed)):
            self.refuse(node, f"{name}(...) takes {needed}{' or more' if several else ''} "
                              f"argument{'s' if needed > 1 else ''}")  # fmt: skip
        values = [self._node(argument, depth + 1, power) for argument in arguments]
        if all(isinstance(value, float) for value in values):
            return self._constant(node, lambda *them: _fold(function, them), values)
        return _fold(_algebra().functions[name], list(map(_real, values)))

    def _constant(self, node: ast.AST, compute: Callable[..., Any], values: Iterable[Any]) -> float:
        try:
            with np.errstate(all="ignore"):
                value = compute(*values)
        except (ArithmeticError, ValueError):
            value = math.nan
        if isinstance(value, complex) or not abs(value) <= MAX_NUMBER:
            self.refuse(node, "this is no finite number")
        return float(value)

    def _finite(self, node: ast.AST, value: Any) -> Any:
        if value.has(*_algebra().no_number):
            self.refuse(node, "this divides by zero")
        return value


_ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": lambda x, y: x / y,
    "**": lambda x, y: x**y,
}


def _real(value: Any) -> Any:
    return _algebra().number(value) if isinstance(value, float) else value


def _fold(function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    """A function of two arguments applied to several, from the left."""
    return function(*arguments) if len(arguments) < 3 else reduce(function, arguments)


@lru_cache(maxsize=512)
def _compile(expression: Expression, by: tuple[str, ...]) -> _Tape:
    return _Tape([expression.node, *(expression.derivative(name) for name in by)])


@lru_cache(maxsize=512)
def _slopes_that_move(expression: Expression, by: tuple[str, ...]) -> BoolArray:
    functions = expression.node.atoms(_algebra().sympy.Function)
    jumps = [node for node in functions if not any(map(node.fdiff, range(1, len(node.args) + 1)))]
    together = [{symbol.name for symbol in node.free_symbols} for node in jumps]
    slopes = [{symbol.name for symbol in expression.derivative(name).free_symbols} for name in by]
    moves = np.zeros((len(by), len(by)), dtype=bool)
    for (i, one), (j, other) in product(enumerate(by), repeat=2):
        at_jump = any({one, other} <= names for names in together)
        moves[i, j] = other in slopes[i] or one in slopes[j] or at_jump
    return moves


class _Tape:
    """Expressions as a list of operations, each node once."""

    def __init__(self, expressions: Sequence[Any]) -> None:
        self.sympy = _algebra().sympy
        self.operations: list[tuple[Numpy | None, Any]] = []
        self.slot_of: dict[Any, int] = {}
        self.results = [self._slot(expression) for expression in expressions]

    def run(self, quantities: Mapping[str, Any]) -> list[Array]:
        """Values of the expressions."""
        slots: list[Any] = []
        with np.errstate(all="ignore"):
            for function, operands in self.operations:
                if function is not None:
                    slots.append(function(*[slots[slot] for slot in operands]))
                elif isinstance(operands, str):
                    slots.append(np.asarray(quantities[operands], dtype=float))
                else:
                    slots.append(operands)
        return [np.asarray(slots[slot], dtype=float) for slot in self.results]

    def _slot(self, node: Any) -> int:
        if node not in self.slot_of:
            operation = self._operation(node)
            self.operations.append(operation)
            self.slot_of[node] = len(self.operations) - 1
        return self.slot_of[node]

    def _operation(self, node: Any) -> tuple[Numpy | None, Any]:
        if node.is_Symbol:
            return None, node.name
        if node.is_Number:
            return None, np.float64(_as_float(node))
        if node.is_Pow:
            return _integer_power(int(node.exp)), (self._slot(node.base),)
        operands = tuple(self._slot(argument) for argument in node.args)
        if node.is_Add:
            return (lambda *values: reduce(np.add, values)), operands
        if node.is_Mul:
            return (lambda *values: reduce(np.multiply, values)), operands
        return (FUNCTIONS | _POWERS)[node.formula_name][0], operands


def _as_float(number: Any) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def _integer_power(exponent: int) -> Numpy:
    if exponent == -1:
        return lambda x: 1.0 / x
    if exponent == 2:
        return np.square
    return lambda x: np.power(x, float(exponent))
