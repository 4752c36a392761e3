"""TableLaw: a law over the columns of a table, with the methods that estimators ask of a law.

Parameters are in the table's own units. Those that enter linearly begin at their least squares, so that they
need no start values; the others begin where the law says, within their bounds, or at 1.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import combinations, product
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._expression import Expression
from stickslip_fit._function import NumericFunction
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.laws.base import Model, Parameter, Rows

MAX_STARTS = 125  # places where a search may begin
MAX_EVALUATIONS = 50  # for start values
BAD_FIT = 1e6  # standard deviations, in place of what is no number
MAX_LINEAR = 16  # parameters that are looked at
_UNIT_AFTER = re.compile(r"\s*[(\[][^()\[\]]*[)\]]\s*$")  # of a column's name
MIN_MISTYPED = 3  # letters of a name that may have a wrong one
LINEAR_TOL = 1e-9  # share of the response's change


@dataclass(frozen=True, eq=False)
class TableLaw:
    """A law of a table, which holds no values: they are passed to it, shape (p,) or (n, p).

    Attributes
    ----------
    source : object
        The `Law` that it comes from.
    left, right : Expression or NumericFunction
        The response, and what predicts it.
    columns : tuple of str
        All that it uses.
    parameters : tuple of Parameter
        Those that every session has its own value of, then the `n_shared` that the whole table shares; units
        as the table has them.
    n_shared : int
    response_unit : str
    """

    source: Any
    left: Expression | NumericFunction
    right: Expression | NumericFunction
    columns: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    n_shared: int
    response_unit: str

    @property
    def name(self) -> str:
        """The law's name, or its formula."""
        return str(self.source.name or self.source.text)

    @property
    def response_name(self) -> str:
        """The response's column, or the formula's left side."""
        names = self.left.names
        return names[0] if isinstance(self.left, Expression) and self.left.is_name else self.left.text.strip()

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Of each parameter."""
        return tuple(parameter.name for parameter in self.parameters)

    def quantities(self, rows: Rows) -> dict[str, Array]:
        """The columns that predict the response, as floats, shape (n,)."""
        return {name: number_column(rows, name) for name in self.columns if name in self.right.names}

    def model(self, rows: Rows) -> Model:
        """The response and its derivatives as a function of the values alone; see `StepLaw.model`."""
        n, columns = count_rows(rows), self.quantities(rows)
        function = self.right.function(self.parameter_names)

        def predict(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (n, len(self.parameters)))
            response, slopes = function(columns | dict(zip(self.parameter_names, values.T, strict=True)))
            return _all_rows(response, n), _all_rows(slopes, n)

        return predict

    def predict(self, rows: Rows, values: Array) -> Array:
        """The response, shape (n,)."""
        n = count_rows(rows)
        values = np.broadcast_to(values, (n, len(self.parameters)))
        by_name = dict(zip(self.parameter_names, values.T, strict=True))
        return _all_rows(self.right.evaluate(self.quantities(rows) | by_name), n)

    def jacobian(self, rows: Rows, values: Array) -> Array:
        """Derivatives of the response by each row's own parameters, shape (n, p)."""
        return self.model(rows)(values)[1]

    def response(self, rows: Rows) -> tuple[Array, Array]:
        """What was measured, shape (n,), and the variance of its rounding, which is not known: 0."""
        columns = {name: number_column(rows, name) for name in self.left.names}
        measured = _all_rows(self.left.evaluate(columns), count_rows(rows))
        return measured, np.zeros(len(measured))

    def start_values(self, rows: Rows, y: Array) -> Array:
        """Where to begin, shape (p,): the best of some places, with least squares for what is linear."""
        given = {name: float(value) for name, value in self.source.start.items()}
        model, best, least = self.model(rows), np.ones(len(self.parameters)), np.inf
        first = np.array([given.get(one.name, _middle(one)) for one in self.parameters])
        free = [k for k, one in enumerate(self.parameters) if one.name not in given]
        free.sort(key=lambda k: isfinite(self.parameters[k].upper - self.parameters[k].lower))
        linear = find_linear(model, first, free)
        searched = [
            k
            for k, one in enumerate(self.parameters)
            if k not in linear and one.name not in given and isfinite(one.upper - one.lower)
        ]
        for place in _grid([self.parameters[k] for k in searched]):
            values = first.copy()
            values[searched] = place
            values = solve_linear(model, values, linear, y, self.parameters)
            residual = y - model(values)[0]
            squares = float(residual @ residual)
            if squares < least:
                best, least = values, squares
        if not isfinite(least):
            return first
        return best if len(linear) == len(free) else _refine(model, best, free, y, self.parameters)


def find_linear(model: Model, values: Array, among: Sequence[int]) -> list[int]:
    """The largest set of some parameters in which, all together, the prediction is linear.

    Of two sets as large that which has the first parameters of `among`.
    """
    among = list(among)[:MAX_LINEAR]
    singles = [k for k in among if is_linear(model, values, [k])]
    pairs = {pair for pair in combinations(singles, 2) if is_linear(model, values, pair)}
    for size in range(len(singles), 0, -1):
        for some in combinations(singles, size):
            if all(pair in pairs for pair in combinations(some, 2)) and is_linear(model, values, some):
                return sorted(some)
    return []


def is_linear(model: Model, values: Array, together: Sequence[int]) -> bool:
    """Whether the prediction is linear in some parameters together, the others at `values`."""
    base, slopes = model(values)
    moved = values.copy()
    moved[list(together)] += 1.0 + 0.37 * np.arange(1, len(together) + 1)
    change = slopes @ (moved - values)
    size = np.abs(change).max(initial=0.0) + np.abs(base).max(initial=0.0)
    error = np.abs(model(moved)[0] - base - change)
    return bool(np.isfinite(error).all() and error.max(initial=0.0) <= LINEAR_TOL * size)


def solve_linear(
    model: Model, values: Array, linear: Sequence[int], y: Array, parameters: Sequence[Parameter]
) -> Array:
    """Values with those of the linear parameters by least squares, within their bounds."""
    predicted, slopes = model(values)
    columns = slopes[:, linear]
    known = np.isfinite(predicted) & np.isfinite(columns).all(axis=1) & np.isfinite(y)
    if not linear or not known.any():
        return values
    length = np.linalg.norm(columns[known], axis=0)
    length = np.where(length > 0, length, 1.0)
    change = np.linalg.lstsq(columns[known] / length, (y - predicted)[known], rcond=None)[0] / length
    solved = values.copy()
    low = [parameters[k].lower for k in linear]
    high = [parameters[k].upper for k in linear]
    solved[list(linear)] = np.clip(values[list(linear)] + change, low, high)
    return solved


def _refine(
    model: Model, values: Array, free: Sequence[int], y: Array, parameters: Sequence[Parameter]
) -> Array:
    """Values with some of them by nonlinear least squares, roughly."""
    from scipy.optimize import least_squares

    size, places = float(np.std(y)) or 1.0, list(free)

    def evaluate(some: Array) -> tuple[Array, Array]:
        moved = values.copy()
        moved[places] = some
        predicted, jacobian = model(moved)
        return np.nan_to_num((predicted - y) / size, nan=BAD_FIT), np.nan_to_num(jacobian[:, places] / size)

    def residual(some: Array) -> Array:
        return evaluate(some)[0]

    def slopes(some: Array) -> Array:
        return evaluate(some)[1]

    low = np.array([parameters[k].lower for k in places])
    high = np.array([parameters[k].upper for k in places])
    length = np.sqrt(np.sum(slopes(values[places]) ** 2, axis=0))
    solved = least_squares(
        residual,
        np.clip(values[places], low, high),
        jac=slopes,
        bounds=(low, high),
        x_scale=np.sqrt(len(y)) / np.where(length > 0, length, np.sqrt(len(y))),
        gtol=None,
        max_nfev=MAX_EVALUATIONS,
    )
    refined = values.copy()
    refined[places] = solved.x
    return refined if np.isfinite(model(refined)[0]).all() else values


def number_column(rows: Rows, name: str) -> Array:
    """A column as floats, shape (n,).

    Raises
    ------
    InputError
        If the rows lack it, or it is not of numbers.
    """
    if name not in rows:
        raise InputError(InputIssue("the table has no such column, and the law needs it", column=name))
    column = rows[name]
    if isinstance(column, pd.Series) and pd.api.types.is_numeric_dtype(column):
        column = column.to_numpy(dtype=complex if column.dtype.kind == "c" else float, na_value=np.nan)
    values = np.asarray(column)
    if values.dtype.kind not in "fiub":
        raise InputError(InputIssue("is not of numbers, and the law computes with it", column=name))
    return values.astype(float)


def count_rows(rows: Rows) -> int:
    """Of a table or of arrays by name."""
    return len(rows) if isinstance(rows, pd.DataFrame) else len(next(iter(rows.values())))


def _all_rows(values: Array, n: int) -> Array:
    """Values of every row where the expression has no column."""
    return values if values.shape[:1] == (n,) else np.broadcast_to(values, (n, *values.shape)).copy()


def _middle(parameter: Parameter) -> float:
    low, high = parameter.lower, parameter.upper
    if isfinite(low) and isfinite(high):
        return float(np.sqrt(low * high)) if low > 0 else (low + high) / 2
    if low <= 1.0 <= high:
        return 1.0
    return low + max(1.0, abs(low)) if isfinite(low) else high - max(1.0, abs(high))


def _grid(parameters: Sequence[Parameter]) -> list[tuple[float, ...]]:
    """Places within bounds, by ratio where these are above 0."""
    if not parameters:
        return [()]
    number = max(2, min(7, int(MAX_STARTS ** (1 / len(parameters)))))
    return list(product(*(spread(one.lower, one.upper, number) for one in parameters)))[:MAX_STARTS]


def spread(low: float, high: float, number: int) -> Array:
    """Numbers within bounds, half a spacing away from them: by ratio where these are above 0."""
    shares = (np.arange(number) + 0.5) / number
    return low * (high / low) ** shares if low > 0 else low + (high - low) * shares


def similar_name(name: str, names: Iterable[str]) -> str:
    """The name most like one that is not there; empty where none is.

    Examples
    --------
    >>> similar_name("acceleration", ["vel", "acc"]), similar_name("x", ["vel", "acc"])
    ('acc', '')
    """
    names = list(names)
    begins = [
        other for other in names if len(other) > 1 and (name.startswith(other) or other.startswith(name))
    ]
    return next(iter([*get_close_matches(shorten(name), names, 1), *begins]), "")


def mistyped_column(name: str, columns: Iterable[str]) -> str:
    """The column that a name is but for its case, its unit or, of three letters and more, one letter; or "".

    Examples
    --------
    >>> mistyped_column("force", ["t (s)", "Force [N]"])
    'Force [N]'
    >>> mistyped_column("X", ["t", "x"]), mistyped_column("temperatur", ["Temperature"])
    ('x', 'Temperature')
    >>> mistyped_column("a", ["t", "x"]), mistyped_column("speed", ["pseed"])
    ('', 'pseed')
    """
    columns = list(columns)
    alike = [column for column in columns if is_alike(name, column)]
    near = [column for column in columns if min(len(name), len(column)) >= MIN_MISTYPED]
    return next(iter([*alike, *(one for one in near if _is_one_edit(name.lower(), one.lower()))]), "")


def is_alike(name: str, column: str) -> bool:
    """Whether a name is a column's but for its case, or for a unit in brackets after it."""
    return _UNIT_AFTER.sub("", column).lower() == name.lower()


def as_written(column: str) -> str:
    """A column as a formula names it.

    Examples
    --------
    >>> as_written("x"), as_written("x (mm)")
    ('x', 'Q("x (mm)")')
    """
    return column if column.isidentifier() else f'Q("{column}")'


def _is_one_edit(one: str, other: str) -> bool:
    """Whether a letter was added, left out, replaced, or put before its neighbour."""
    short, long = sorted((one, other), key=len)
    same = next((k for k, (a, b) in enumerate(zip(short, long, strict=False)) if a != b), len(short))
    if len(long) > len(short):
        return len(long) == len(short) + 1 and short[same:] == long[same + 1 :]
    swapped = short[:same] + short[same : same + 2][::-1] + short[same + 2 :]
    return short[same + 1 :] == long[same + 1 :] or swapped == long
