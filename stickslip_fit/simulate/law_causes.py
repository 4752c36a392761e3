"""Causes at work in a simulated campaign: the [[cause]] tables of a law or study file."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, PlainValidator, PrivateAttr, WrapValidator, create_model

from stickslip_fit._format import format_value
from stickslip_fit._toml import Give, Table, Text, fault
from stickslip_fit.causes import Cause, CauseParameter, Covariate, library
from stickslip_fit.logs.columns import COVARIATE
from stickslip_fit.units import UNITS, to_si

Array = npt.NDArray[np.float64]

BEND_OVER = {"half": "1 K"}  # only a bent response asks for it
_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?) *(.*)")


class CauseTable(Table, extra="ignore"):
    """A cause, with its parameters and what it refers to: the session of a jump, the form of a bend.

    A parameter is text with its unit, ``A = "3 %"``, or where each joint and direction has its own, a table
    of such, ``k = {"3+" = "2 %"}``.
    """

    name: Text
    """One of the library's, or ``covariate:`` and a column of the lab's own."""
    _cause: Any = PrivateAttr()

    def hidden(self) -> tuple[Cause, list[float]]:
        """The cause, and the values of its parameters, SI."""
        values = {each.name: iter(getattr(self, each.name)) for each in self._cause.parameters}
        cause = replace(self._cause, **{name: getattr(self, name) for name in _references(self._cause)})
        return cause, [next(values[each.name]) for each in self._cause.parameters]


def causes_of(tables: Sequence[CauseTable]) -> tuple[tuple[Cause, ...], Array]:
    """Causes, and the values of their parameters one after the other, SI, shape (q,)."""
    hidden = [table.hidden() for table in tables]
    values = [value for _, own in hidden for value in own]
    return tuple(cause for cause, _ in hidden), np.array(values, dtype=float)


def _of_name(written: Any, inner: Callable[[Any], CauseTable]) -> CauseTable:
    named = inner(written)
    known = {cause.name: cause for cause in library()}
    if named.name.startswith(COVARIATE) and named.name != COVARIATE:
        known[named.name] = Covariate(named.name.removeprefix(COVARIATE))
    if named.name not in known:
        named.refuse((f"give one of {', '.join(known)}, {COVARIATE}COLUMN", ("name",)))
    cause = known[named.name]
    keys: dict[str, Any] = {name: _reference(cause, name, own) for name, own in _references(cause).items()}
    for name in dict.fromkeys(each.name for each in cause.parameters):
        own = [each for each in cause.parameters if each.name == name]
        given = Give(f"give {_example(own[0])}: {own[0].meaning}")
        keys[name] = (Annotated[Any, PlainValidator(partial(_sizes, own)), given], ...)
    model = create_model(cause.name, __base__=CauseTable, __cls_kwargs__={"extra": "forbid"}, **keys)
    table = model.model_validate(written)
    table._cause = cause
    return table


Causes = list[Annotated[CauseTable, WrapValidator(_of_name)]]


def _references(cause: Any) -> dict[str, str | float]:
    """What a cause refers to beside its parameters, with what is usual."""
    given = {each.name: each.default for each in fields(cause) if isinstance(each.default, str | float)}
    return {name: usual for name, usual in given.items() if name != "column"}


def _reference(cause: Cause, name: str, usual: str | float) -> tuple[Any, Any]:
    """A field for it; a number has no default."""
    if isinstance(usual, float):
        given = Give('give a number, with its unit where it has one, e.g. "21 °C"')
        default = _si(BEND_OVER[name]) if name in BEND_OVER else ...
        return Annotated[float, BeforeValidator(_si), given], default
    if name == "session" and "session" in cause.columns:
        return Annotated[Text, Give("give the session in which it happens, in quotes")], usual or ...
    if forms := cause.forms:
        return Annotated[Literal[forms], Give(f"give one of {', '.join(forms)}")], usual
    return Text, usual


def _sizes(own: Sequence[CauseParameter], written: Any) -> list[float]:
    """A value for each of the parameters that one key gives."""
    if own[0].joint is None or not isinstance(written, dict):
        return [_size(each, written) for each in own]
    drives = [f"{each.joint}{each.direction}" for each in own]
    if not written.keys() <= set(drives):
        raise fault(f"name joints and directions as {', '.join(drives)}")
    # Joints and directions that are left out have none of it.
    return [_size(each, written.get(drive, 0.0)) for each, drive in zip(own, drives, strict=True)]


def _size(parameter: CauseParameter, written: Any) -> float:
    (number, unit), wanted = _quantity(written), parameter.unit
    if number and unit != wanted:
        raise ValueError("another unit")
    value = to_si(number, wanted)
    if not parameter.lower <= value <= parameter.upper:
        low, high = (format_value(end, wanted, 2) for end in (parameter.lower, parameter.upper))
        raise fault(f"lies outside what is possible, {low} to {high} (– for no limit)")
    return value


def _example(parameter: CauseParameter) -> str:
    if parameter.unit == "1":
        return "a number"
    written = f'"2 {parameter.unit}"'
    if parameter.joint is None:
        return f"a number and its unit as text, e.g. {written}"
    return f'a number and its unit as text for each joint and direction, e.g. {{"3+" = {written}}}'


def _si(written: Any) -> float:
    number, unit = _quantity(written)
    if unit not in UNITS:
        raise ValueError("no unit")
    return to_si(number, unit)


def _quantity(written: Any) -> tuple[float, str]:
    """Number and unit of a text such as "3 %"; a bare number has the unit 1."""
    if type(written) in (int, float) and abs(written) <= sys.float_info.max:
        return float(written), "1"
    match = _QUANTITY.fullmatch(written.strip()) if isinstance(written, str) else None
    if match is None:
        raise ValueError("no number")
    unit = match[2].replace("urad", "µrad").replace("^2", "²")
    return float(match[1]), unit or "1"
