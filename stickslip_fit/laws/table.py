"""TableLaw: a law over the columns of a table, with the methods that estimators ask of a law.

Parameters are in the table's own units. Those that enter linearly begin at their least squares, so that they
need no start values; the others begin where the law says, or where `table_start` finds the best fit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._expression import Expression, is_name
from stickslip_fit._function import NumericFunction
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.laws.base import Model, Parameter, Rows
from stickslip_fit.laws.table_start import choose_start

_UNIT_AFTER = re.compile(r"\s*[(\[][^()\[\]]*[)\]]\s*$")  # of a column's name
MIN_MISTYPED = 3  # letters of a name that may have a wrong one


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

    def start_values(self, rows: Rows, y: Array, near: Sequence[Array] | None = None) -> Array:
        """Where a fit begins, shape (p,); see `choose_start`."""
        return choose_start(self, rows, y, near)

    def slopes_at_start(self, rows: Rows, y: Array) -> Array:
        """Derivatives of the response by the parameters where a fit begins, shape (n, p)."""
        return self.jacobian(rows, np.tile(self.start_values(rows, y), (len(y), 1)))


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
    return column if is_name(column) else f'Q("{column}")'


def _is_one_edit(one: str, other: str) -> bool:
    """Whether a letter was added, left out, replaced, or put before its neighbour."""
    short, long = sorted((one, other), key=len)
    same = next((k for k, (a, b) in enumerate(zip(short, long, strict=False)) if a != b), len(short))
    if len(long) > len(short):
        return len(long) == len(short) + 1 and short[same:] == long[same + 1 :]
    swapped = short[:same] + short[same : same + 2][::-1] + short[same + 2 :]
    return short[same + 1 :] == long[same + 1 :] or swapped == long
