"""Law: a law of one's own, as a formula or a Python function; which of its names are parameters a table says.

>>> law = Law("F ~ M*acc + Fv*vel + Fc*sign(vel) + offset", units={"Fv": "N s/m", "M": "kg", "Fc": "N"})
>>> law.response_name, law.names
('F', ('M', 'acc', 'Fv', 'vel', 'Fc', 'offset'))

`Law.bind_table` makes it a law of a table's columns; see `TableLaw`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from math import inf, isfinite
from numbers import Real
from typing import Any

import pandas as pd

from stickslip_fit._expression import Expression, is_name, parse_expression, parse_formula
from stickslip_fit._function import NO_FUNCTIONS, NumericFunction, find_function
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.laws.base import Parameter, Rows
from stickslip_fit.laws.formula_step import RESPONSE, FormulaStepLaw, make_step_law
from stickslip_fit.laws.quantities import NOT_KNOWN_BEFORE, known_names
from stickslip_fit.laws.table import TableLaw, as_written, is_alike, mistyped_column, similar_name
from stickslip_fit.laws.table_check import check_table_law, explain_mistyped, list_names
from stickslip_fit.machine import Machine
from stickslip_fit.units import TableUnit

SMALLER_STARTS = (0.1, 0.01, 0.0)  # in the unit of the parameter
Bounds = tuple[float | None, float | None]


@dataclass(frozen=True)
class Law:
    """A law as a formula, ``response ~ expression``, or as a Python function of columns and parameters.

    Of the names in it those are columns that the table has; the others are parameters. Where `units` names
    any parameter, every parameter has to be named in `units`, `bounds`, `start` or `shared`, so that a
    mistyped column is found.

    Parameters
    ----------
    formula : str or callable
        A formula's left side may be an expression of columns, as in ``log(F) ~ a + b*x``. A function takes
        arrays by the names of its arguments and returns the response of every row.
    units : mapping of str to str, optional
        Of columns and parameters, any text. Numbers are never converted: a law computes in the table's units.
    bounds : mapping of str to (float or None, float or None), optional
        Lower and upper bound of a parameter.
    start : mapping of str to float, optional
        Where the search for a parameter begins that enters nonlinearly; without it, within its bounds.
    shared : collection of str, or "all", optional
        Parameters with one value for the whole table; the others have one for each session.
    name : str, optional
        In reports; the formula by default.
    response : str, optional
        Of a function: the column, or an expression of columns, that it predicts.

    Raises
    ------
    InputError
        For a formula that cannot be read, and for bounds and start values that are no numbers.
    """

    formula: str | Callable[..., Any]
    _: KW_ONLY
    units: Mapping[str, str] = field(default_factory=dict)
    bounds: Mapping[str, Bounds] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    shared: Collection[str] = ()
    name: str = ""
    response: str = ""

    def __post_init__(self) -> None:
        _ = self.names, self.response_name
        for key in ("units", "bounds", "start"):
            if not isinstance(getattr(self, key), Mapping):
                raise InputError(f"{key} of a law is a table of names such as {{'a': ...}}")
        issues = [
            *(
                InputIssue(f"start of {name} must be a finite number, not {shorten(repr(value))}")
                for name, value in self.start.items()
                if not (isinstance(value, Real) and not isinstance(value, bool) and isfinite(value))
            ),
            *(issue for name, pair in self.bounds.items() for issue in _check_bounds(name, pair)),
        ]
        if issues:
            raise InputError(issues)

    def __hash__(self) -> int:
        return hash((self.formula, self.response))

    @property
    def text(self) -> str:
        """The formula, or the function's name."""
        return self.formula if isinstance(self.formula, str) else f"{self.response} ~ {self.right.text}(...)"

    @property
    def names(self) -> tuple[str, ...]:
        """The names that the response is predicted from, columns and parameters."""
        return self.right.names

    @property
    def response_name(self) -> str:
        """The left side; a column where that is one name."""
        left = self.left
        return "" if left is None else left.names[0] if left.is_name else left.text.strip()

    @cached_property
    def right(self) -> Expression | NumericFunction:
        """What predicts the response."""
        if isinstance(self.formula, str):
            return self._sides[1]
        if callable(self.formula):
            return NumericFunction(self.formula)
        raise InputError(f"a law is a formula or a function, not {shorten(repr(self.formula))}")

    @property
    def left(self) -> Expression | None:
        """The response; None for a function without `response`."""
        if isinstance(self.formula, str):
            return self._sides[0]
        return parse_expression(self.response) if self.response else None

    @cached_property
    def _sides(self) -> tuple[Expression, Expression]:
        return parse_formula(str(self.formula))

    def bind_table(
        self, frame: pd.DataFrame, response: str | None = None, session: str | None = None
    ) -> TableLaw:
        """The law of a table: its columns, parameters and response.

        Parameters
        ----------
        frame : DataFrame
        response : str, optional
            For a function without one of its own.
        session : str, optional
            The column that names each row's session: parameters that are not shared have a value in each.

        Raises
        ------
        InputError
            With every fault of names: unknown columns with what is similar, parameters that are never used,
            have no effect, or are a column but for their case. Then for declared units that do not fit
            together, for responses or predictions that are no numbers, and for combinations of parameters
            that the rows cannot tell apart.
        """
        left = self._left_of(response)
        columns = [str(name) for name in frame.columns]
        issues, names = _Names(self, left, columns).check()
        if issues:
            raise InputError(issues)
        used = tuple(name for name in self.names if name in columns)
        law = TableLaw(
            source=self,
            left=left,
            right=self.right,
            columns=tuple(dict.fromkeys((*used, *left.names))),
            parameters=tuple(self._parameter(name) for name in names),
            n_shared=len([name for name in names if self._is_shared(name)]),
            response_unit=TableUnit(self.units.get(left.names[0], "") if left.is_name else ""),
        )
        check_table_law(law, frame, session)
        return law

    def step_law(self, joint: int, rows: Rows, machine: Machine) -> FormulaStepLaw:
        """The law of a joint of a log, ``gamma ~ expression``: gamma is the step size in rad or m.

        Names are q (the position), q1 and so on, theta, psi, load, recoil, direction (1 or -1) and the
        columns of `rows` that hold numbers, in SI; the others are parameters. Their units are those of logs
        (nm, µrad, %, ...), in which `bounds` and `start` are given.

        Raises
        ------
        InputError
            As of `bind_table`.
        """
        if self.left is not None and self.response_name != RESPONSE:
            raise InputError(
                f"a law of a log predicts {RESPONSE}, the step size: write '{RESPONSE} ~ ...' in place of "
                f"{self.text!r}"
            )
        if self.shared:
            raise InputError("shared= is for tables; a fit of a log says which parameters sessions share")
        known = [RESPONSE, *known_names(rows)]
        issues, names = _Names(self, parse_expression(RESPONSE), known, "log").check()
        if issues:
            raise InputError(issues)
        if unknown := [name for name in names if name in NOT_KNOWN_BEFORE]:
            raise InputError(f"{unknown[0]} is what the law {self.text!r} is to predict; leave it out of it")
        if not names:
            raise InputError(f"the law {self.text!r} has no parameters, so that there is nothing to fit")
        law = make_step_law(self, names, joint, rows, machine)
        # An amplitude of 1 stalls many a law, as that of gamma ~ g*(1 + A*sin(q)) does.
        for size in SMALLER_STARTS:
            if law.moves_in(rows):
                break
            smaller = dict.fromkeys(self._open_starts(names, law), size)
            nearer = replace(self, start=smaller | dict(self.start))
            law = replace(make_step_law(nearer, names, joint, rows, machine), source=self)
        return law

    def _open_starts(self, names: Sequence[str], law: FormulaStepLaw) -> list[str]:
        """Parameters in which the law is not linear, with neither bounds nor a start value."""
        settled = {*self.start, *self.bounds}
        return [
            name
            for name, is_linear in zip(names, law.proportional, strict=True)
            if name not in settled and not is_linear
        ]

    def _left_of(self, response: str | None) -> Expression:
        if self.left is None:
            if not response:
                raise InputError(f"what {self.right.text} predicts is not known: give response=, a column")
            return _quote(response)
        if response and response != self.response_name:
            raise InputError(
                f"the law predicts {self.response_name}, and response is {response!r}; leave response out, "
                "or write it into the formula before the ~"
            )
        return self.left

    def _is_shared(self, name: str) -> bool:
        return self.shared == "all" or name in self.shared

    def _parameter(self, name: str) -> Parameter:
        low, high = self.bounds.get(name, (None, None))
        unit = TableUnit(self.units.get(name, ""))
        return Parameter(name, unit, "", -inf if low is None else low, inf if high is None else high)

    def describe(self) -> dict[str, Any]:
        """What `restore_formula_law` needs to build it again; plain JSON types.

        Raises
        ------
        InputError
            For a function that cannot be imported by a name.

        Examples
        --------
        >>> restore_formula_law(Law("y ~ a + b*x", bounds={"b": (0, None)}).describe()).bounds
        {'b': (0, None)}
        """
        own = {"formula": self.formula} if isinstance(self.right, Expression) else {
            "function": self.right.importable_name(), "response": self.response}  # fmt: skip
        return own | {
            "units": {name: str(unit) for name, unit in self.units.items()},
            "bounds": {name: list(pair) for name, pair in self.bounds.items()},
            "start": dict(self.start),
            "shared": self.shared if isinstance(self.shared, str) else list(self.shared),
            "name": self.name,
        }


def restore_formula_law(
    description: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]] = NO_FUNCTIONS
) -> Law:
    """The law that `Law.describe` described; `functions` by ``module:name`` are those it may need.

    Raises
    ------
    InputError
        If its function is not given, or its formula cannot be read.
    """
    content = dict(description)
    formula = content.pop("formula", None) or find_function(content.pop("function"), functions)
    content["bounds"] = {name: tuple(pair) for name, pair in content.get("bounds", {}).items()}
    return Law(formula, **content)


def _quote(name: str) -> Expression:
    """A column whatever its name, or an expression of columns."""
    if is_name(name):
        return parse_expression(name)
    return parse_expression(name if "(" in name else f'Q("{name}")')


def _check_bounds(name: str, pair: Any) -> list[InputIssue]:
    ends = list(pair) if isinstance(pair, tuple | list) else []
    numbers = [isinstance(end, Real | None) and not isinstance(end, bool) for end in ends]
    if len(ends) == 2 and all(numbers):
        low, high = -inf if ends[0] is None else ends[0], inf if ends[1] is None else ends[1]
        if low < high:
            return []
    return [InputIssue(f"bounds of {name} must be a lower and a higher number, or None, not {pair!r}")]


@dataclass(frozen=True)
class _Names:
    """Which names of a law are columns, which are parameters, and what is wrong with them."""

    law: Law
    left: Expression
    columns: list[str]
    of: str = "table"

    def check(self) -> tuple[list[InputIssue], list[str]]:
        """Faults, and the parameters: a session's own first, shared ones last."""
        law = self.law
        listed = [] if law.shared == "all" else list(law.shared)
        declared = dict.fromkeys([*law.units, *law.bounds, *law.start, *listed])
        free = [name for name in law.names if name not in self.columns]
        strict = any(name in law.units for name in free)
        unknown = [name for name in free if strict and name not in declared]
        issues = [self._unknown_column(name) for name in self.left.names if name not in self.columns]
        issues += [self._unknown_column(name, strict=True) for name in unknown]
        for name in declared:
            if name not in law.names and name not in self.columns and name not in self.left.names:
                issues.append(self._unused(name))
            elif name in self.columns and name in (*law.bounds, *law.start, *listed):
                issues.append(
                    InputIssue(f"{name} is a column of the {self.of} and so no parameter; name it otherwise")
                )
        issues += [
            InputIssue(f"{name} cancels out of the formula {law.text!r}: it has no effect. Leave it out")
            for name in free
            if name not in law.right.active_names
        ]
        unused = [name for name in self.columns if name not in (*law.names, *self.left.names)]
        for name in free if self.of == "table" else []:
            other = next((column for column in unused if is_alike(name, column)), "")
            if other and name not in (*declared, *unknown):
                issues.append(explain_mistyped(name, other, self.columns))
        both = [name for name in self.left.names if name in law.names]
        issues += [InputIssue(f"the response {name} stands on both sides of {law.text!r}") for name in both]
        own = [name for name in free if not law._is_shared(name)]
        return issues, [*own, *(name for name in free if law._is_shared(name))]

    def _unknown_column(self, name: str, strict: bool = False) -> InputIssue:
        similar = mistyped_column(name, self.columns) or similar_name(name, self.columns)
        hint = f"did you mean {as_written(similar)}? " if similar else ""
        parameter = f". If {name} is a parameter, name it in units, bounds or start" if strict else ""
        return InputIssue(
            f"the law {shorten(self.law.text)!r} has {name}, which is no column of the {self.of}; {hint}"
            f"there are {list_names(self.columns)}{parameter}"
        )

    def _unused(self, name: str) -> InputIssue:
        similar = similar_name(name, self.law.names)
        hint = f"; did you mean {similar}?" if similar else "; leave it out, or use it"
        return InputIssue(f"{name} is declared and never used in {shorten(self.law.text)!r}{hint}")
