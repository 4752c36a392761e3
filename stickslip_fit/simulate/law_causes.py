"""Causes at work in a simulated campaign: the [[cause]] tables of a law file."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._format import format_value
from stickslip_fit.causes import Cause, CauseParameter, Covariate, library
from stickslip_fit.causes.load_nonlinearity import BENDS
from stickslip_fit.logs.columns import COVARIATE
from stickslip_fit.logs.settings import Settings, is_number
from stickslip_fit.units import UNITS, to_si

Array = npt.NDArray[np.float64]

FORMS = {"load-nonlinearity": tuple(BENDS), "temperature": ("straight", "curved")}
BEND_OVER = {"half": "1 K"}  # only a bent response asks for it
_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?) *(.*)")


def read_causes(settings: Settings) -> tuple[tuple[Cause, ...], Array]:
    """The causes of a law file, and the values of their parameters one after the other.

    Each [[cause]] has a name; every parameter as text with its unit, ``A = "3 %"``, or where each joint and
    direction has its own, a table of such, ``k = {"3+" = "2 %"}``; and what the cause refers to besides: the
    session of a jump, the mean of a column, the form of a bend.

    Returns
    -------
    causes : tuple of Cause
    values : array, shape (q,)
        SI; NaN for what is faulty.
    """
    if "cause" not in settings.content:
        settings.take("cause")
        return (), np.zeros(0)
    found = [each for table in settings.tables("cause") if (each := _cause(table)) is not None]
    values = [value for _, own in found for value in own]
    return tuple(cause for cause, _ in found), np.array(values, dtype=float)


def _cause(table: Settings) -> tuple[Cause, list[float]] | None:
    name = table.text("name", "")
    known = {cause.name: cause for cause in library()}
    if name.startswith(COVARIATE) and name != COVARIATE:
        known[name] = Covariate(name.removeprefix(COVARIATE))
    if name not in known:
        if name:
            table.complain("name", f"give one of {', '.join(known)}, {COVARIATE}COLUMN")
        return None
    cause: Any = known[name]
    given = {each.name: each.default for each in fields(cause) if isinstance(each.default, str | float)}
    given.pop("column", None)
    cause = replace(cause, **{key: _reference(table, key, usual, name) for key, usual in given.items()})
    if "session" in cause.columns and not cause.session:
        table.complain("session", "give the session in which it happens, in quotes")
    values = _values(table, cause.parameters)
    table.reject_unknown()
    return cause, values


def _reference(table: Settings, key: str, usual: str | float, name: str) -> str | float:
    """Something that a cause refers to beside its parameters; a number has no default."""
    if isinstance(usual, float):
        quantity = _quantity(table.take(key, BEND_OVER.get(key)))
        if quantity is not None and quantity[1] in UNITS:
            return to_si(*quantity)
        table.complain(key, 'give a number, with its unit where it has one, e.g. "21 °C"')
        return math.nan
    value = table.take(key, usual)
    if isinstance(value, str) and value in FORMS.get(name, (value,)):
        return value
    table.complain(key, f"give one of {', '.join(FORMS[name])}" if name in FORMS else "give a text in quotes")
    return usual


def _values(table: Settings, parameters: Sequence[CauseParameter]) -> list[float]:
    values = []
    for each in parameters:
        value = table.take(each.name)
        if each.joint is not None and isinstance(value, dict):
            # Joints and directions that are left out have none of it.
            value = value.get(_drive(each), 0.0)
        values.append(_value(table, each, value))
    drives = {_drive(each): each.name for each in parameters if each.joint is not None}
    for key in set(drives.values()):
        if isinstance(table.content.get(key), dict) and not table.content[key].keys() <= drives.keys():
            table.complain(key, f"name joints and directions as {', '.join(drives)}")
    return values


def _drive(parameter: CauseParameter) -> str:
    return f"{parameter.joint}{parameter.direction}"


def _value(table: Settings, parameter: CauseParameter, written: object) -> float:
    quantity, unit = _quantity(written), parameter.unit
    if quantity is None or (quantity[0] and quantity[1] != unit):
        table.complain(parameter.name, f"give {_example(parameter)}: {parameter.meaning}")
        return math.nan
    value = to_si(quantity[0], unit)
    if not parameter.lower <= value <= parameter.upper:
        low, high = (format_value(end, unit, 2) for end in (parameter.lower, parameter.upper))
        table.complain(parameter.name, f"lies outside what is possible, {low} to {high} (– for no limit)")
    return value


def _example(parameter: CauseParameter) -> str:
    if parameter.unit == "1":
        return "a number"
    written = f'"2 {parameter.unit}"'
    if parameter.joint is None:
        return f"a number and its unit as text, e.g. {written}"
    return f'a number and its unit as text for each joint and direction, e.g. {{"3+" = {written}}}'


def _quantity(written: object) -> tuple[float, str] | None:
    """Number and unit of a text such as "3 %"; a bare number has the unit 1."""
    if is_number(written):
        return float(written), "1"
    match = _QUANTITY.fullmatch(written.strip()) if isinstance(written, str) else None
    if match is None:
        return None
    unit = match[2].replace("urad", "µrad").replace("^2", "²")
    return float(match[1]), unit or "1"
