"""A TOML file into a pydantic model; all its faults at once, each with what a person can do about it."""

from __future__ import annotations

import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin

from annotated_types import MinLen
from pydantic import (
    BaseModel, ConfigDict, PrivateAttr, ValidationError, ValidationInfo, WrapValidator, model_validator,
)  # fmt: skip
from pydantic.fields import FieldInfo
from pydantic_core import InitErrorDetails, PydanticCustomError, core_schema

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.units import SUFFIXES, from_si, to_si

Bounds = tuple[float, float]
Place = Sequence[str | int]
Text = Annotated[str, MinLen(1)]

ANYWHERE = (-math.inf, math.inf)
SLACK = 1e-9  # share of a range; less is rounding
SUFFIX_OF = {symbol: suffix for suffix, symbol in SUFFIXES.items()}
FAULT = "fault"


@dataclass(frozen=True)
class Give:
    """Metadata of a field: what a person reads whose value cannot be used."""

    advice: str


@dataclass(frozen=True)
class Quantity:
    """Metadata of a field whose keys end in a unit; the model has it in SI.

    Attributes
    ----------
    units : tuple of str
        Those that a key may have.
    within : (float, float) or callable
        Bounds of every number, SI; a callable takes the context of the validation.
    advice : str
        As of `Give`; ``{}`` stands for a number, its unit and its bounds.
    """

    units: tuple[str, ...]
    within: Bounds | Callable[[Any], Bounds] = ANYWHERE
    advice: str = "give {}"

    def keys(self, stem: str) -> dict[str, str]:
        """Every key that may give the quantity, with its unit.

        Examples
        --------
        >>> Quantity(("µrad/mm", "1")).keys("gamma0")
        {'gamma0_urad_per_mm': 'µrad/mm', 'gamma0': '1'}
        """
        return {stem if unit == "1" else f"{stem}_{SUFFIX_OF[unit]}": unit for unit in self.units}

    def bounds(self, context: Any) -> Bounds:
        """Lowest and highest number, SI; without a context, what holds in any."""
        if not callable(self.within):
            return self.within
        return ANYWHERE if context is None else self.within(context)

    def advice_in(self, unit: str, context: Any) -> str:
        """The advice for a key in `unit`."""
        low, high = self.bounds(context)
        number = "a number" if unit == "1" else f"a number in {unit}"
        if low > -math.inf:
            number += (
                f", {from_si(low, unit):g} {'or more' if high == math.inf else f'to {from_si(high, unit):g}'}"
            )
        return self.advice.format(number)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        """As the field's own type, with every number checked and taken to SI."""

        def read(written: tuple[Any, str], inner: Callable[[Any], Any], info: ValidationInfo) -> Any:
            value, unit = written
            low, high = self.bounds(info.context)
            slack = SLACK * (high - low) if math.isfinite(high - low) else 0.0

            def checked(number: float) -> float:
                if not low - slack <= to_si(number, unit) <= high + slack:
                    raise ValueError("out of bounds")
                return to_si(number, unit)

            return each_number(checked, inner(value))

        return core_schema.with_info_wrap_validator_function(read, handler(source))


class Table(BaseModel):
    """A table of a TOML file: no key but its fields', no value taken for one of another type."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
    _written: dict[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def fields_by_key(cls) -> dict[str, tuple[str, str]]:
        """The field that each key gives, and the unit if it is a quantity."""
        found: dict[str, tuple[str, str]] = {}
        for name, field in cls.model_fields.items():
            quantity = quantity_of(field)
            found |= (
                {key: (name, unit) for key, unit in quantity.keys(name).items()}
                if quantity
                else {name: (name, "")}
            )
        return found

    def fields_in_file(self) -> list[str]:
        """The fields that stand in the file, in its order."""
        return [self.fields_by_key()[key][0] for key in self._written]

    def refuse(self, faults: Iterable[tuple[str, Place]]) -> None:
        """Raise what is wrong with values that are right by themselves: advice and the key's path from here."""
        found = [_fault(advice, place, _at(self._written, place)) for advice, place in faults]
        if found:
            raise ValidationError.from_exception_data(type(self).__name__, found)

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, written: Any, handler: Callable[[Any], Self], info: ValidationInfo) -> Self:
        if not isinstance(written, dict):
            return handler(written)
        keys, faults = cls.fields_by_key(), []
        content: dict[str, Any] = {name: {} for name, field in cls.model_fields.items() if _is_table(field)}
        key_of = {name: key for key, (name, _) in reversed(keys.items())}
        for key, value in written.items():
            name, unit = keys.get(key, ("", ""))
            if unit and name in content:
                faults.append(
                    _fault(f"{key_of[name]} gives the same quantity; keep one of them", [key], value)
                )
            elif name:
                content[name], key_of[name] = (value, unit) if unit else value, key
            elif cls.model_config["extra"] == "forbid":
                faults.append(_fault(_unknown(key, keys), [key], value))
        try:
            table = handler(content)
        except ValidationError as error:
            own = {}
            for each in error.errors(include_url=False):
                name, *inside = each["loc"]
                key, context = key_of[str(name)], each.get("ctx")
                if each["type"] == FAULT and inside:
                    faults.append(_fault(each["msg"], each["loc"], each["input"], context))
                    continue
                said = each["msg"] if each["type"] == FAULT else _advice(cls, key, info.context)
                own.setdefault(key, _fault(said, [key], written.get(key), context))
            faults += own.values()
        if faults:
            raise ValidationError.from_exception_data(cls.__name__, faults)
        table._written = written
        return table

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> dict[str, Any]:
        """The schema with a file's keys, in their units."""
        schema = handler(core)
        own = handler.resolve_ref_schema(schema)
        needed, shown = own.pop("required", []), {}
        for key, (name, unit) in cls.fields_by_key().items():
            entry = dict(own["properties"][name])
            if unit and "default" in entry:
                entry["default"] = each_number(lambda number: from_si(number, unit), entry["default"])
            shown[key] = {"description": _advice(cls, key, None), **entry}
        own["properties"] = shown
        choices = [[key for key, (each, _) in cls.fields_by_key().items() if each == name] for name in needed]
        if choices:
            own["allOf"] = [{"oneOf": [{"required": [key]} for key in keys]} for keys in choices]
        return schema


def read_toml[Model: Table](path: str | Path, model: type[Model], kind: str, context: Any = None) -> Model:
    """Read a file that `kind` names; see `parse_toml`."""
    return parse_toml(file_bytes(path, kind), str(path), model, context)


def file_bytes(path: str | Path, kind: str) -> bytes:
    """What is in a file.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return Path(path).read_bytes()
    except OSError as error:
        message = f"cannot be read ({error.strerror}); name an existing {kind}"
        raise InputError(Problem(message, str(path))) from None


def parse_toml[Model: Table](raw: bytes, file: str, model: type[Model], context: Any = None) -> Model:
    """A TOML text as a model.

    Raises
    ------
    InputError
        With every fault: its file, line, key and value, and what to do.
    """
    try:
        text = raw.decode("utf-8-sig")
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(Problem(f"is no TOML file ({error}); correct it there", file)) from None
    try:
        return model.model_validate(content, context=context)
    except ValidationError as error:
        lines, problems = _lines(text), []
        for each in error.errors(include_url=False):
            place = each["loc"]
            line = next((lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in lines), None)
            shown = None if each["input"] is None else _shown(each["input"])
            here = Problem(each["msg"], file, line, _path(place), shown)
            problems += each.get("ctx", {}).get("problems") or [here]
        raise InputError(problems) from None


def fault(advice: str, problems: Sequence[Problem] = ()) -> PydanticCustomError:
    """For a validator of a field: what is wrong in words of its own, or problems of another file."""
    return PydanticCustomError(FAULT, "{advice}", {"advice": advice, "problems": tuple(problems)})


def chosen_by(key: str, models: Mapping[Any, type[Table]], other: type[Table]) -> WrapValidator:
    """For a table whose keys depend on the value of one of them; `other` where that has no model."""

    def read(written: Any, inner: Any, info: ValidationInfo) -> Any:
        value = written.get(key) if isinstance(written, dict) else None
        model = models.get(value, other) if type(value) in (int, str) else other
        return model.model_validate(written, context=info.context)

    return WrapValidator(read, json_schema_input_type=Union[tuple(models.values())])


def each_number(change: Callable[[float], float], value: Any) -> Any:
    """Every number of nested lists, changed."""
    return [each_number(change, each) for each in value] if isinstance(value, list | tuple) else change(value)


def quantity_of(field: FieldInfo) -> Quantity | None:
    """The quantity that a field is, if it is one."""
    return next((each for each in field.metadata if isinstance(each, Quantity)), None)


def _fault(advice: str, place: Place, value: Any, context: Any = None) -> InitErrorDetails:
    problems = (context or {}).get("problems", ())
    return InitErrorDetails(type=fault(advice, problems), loc=tuple(place), input=value)


def _is_table(field: FieldInfo) -> bool:
    return isinstance(field.annotation, type) and issubclass(field.annotation, Table)


def _advice(table: type[Table], key: str, context: Any) -> str:
    """What to write for a key: as its field says, or as its type does."""
    name, unit = table.fields_by_key()[key]
    field = table.model_fields[name]
    if quantity := quantity_of(field):
        return quantity.advice_in(unit, context)
    for each in field.metadata:
        if isinstance(each, Give):
            return each.advice
    kind = next(
        (each for each in get_args(field.annotation) if get_origin(each) is Literal), field.annotation
    )
    if get_origin(kind) is Literal:
        return f"give one of {', '.join(map(repr, get_args(kind)))}"
    if _is_table(field):
        return f"write it as a table: [{key}]"
    if kind is int:
        low, high = (
            next(getattr(each, end) for each in field.metadata if hasattr(each, end)) for end in ("ge", "le")
        )
        return f"give a whole number from {low} to {high}"
    return "give a text in quotes" if kind is str else f"give at least one table [[{key}]]"


def _unknown(key: str, keys: dict[str, tuple[str, str]]) -> str:
    alike = get_close_matches(key, keys, 1)
    meant = f"did you mean {alike[0]}? It" if alike else "it"
    one_each = {name: key for key, (name, _) in reversed(keys.items())}
    return f"is no key of this table; {meant} may have {', '.join(reversed(one_each.values()))}"


def _at(value: Any, place: Place) -> Any:
    for part in place:
        if isinstance(value, dict) and part not in value:
            return None
        value = value[part]
    return value


def _path(place: Place) -> str | None:
    """A key as people find it.

    Examples
    --------
    >>> _path(("sessions", "dates")), _path(("scenario", 1, "cause", 0, "tau"))
    ('sessions.dates', 'scenario 2 cause 1 tau')
    """
    parts = [f" {part + 1} " if isinstance(part, int) else f".{part}" for part in place]
    return "".join(parts).replace(" .", " ").strip(". ") or None


def _shown(value: object) -> str:
    """A value much as it stands in the file."""
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _lines(text: str) -> dict[tuple[str | int, ...], int]:
    """The line of every table and key that begins one."""
    found: dict[tuple[str | int, ...], int] = {}
    table: tuple[str | int, ...] = ()
    count: Counter[tuple[str | int, ...]] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*(\[\[?)\s*([\w.-]+)\s*\]", line):
            table, *_ = ((),)
            *parents, last = header[2].split(".")
            for name in parents:
                table = (*table, name)
                table += (count[table] - 1,) if count[table] else ()
            table = (*table, last)
            if header[1] == "[[":
                count[table] += 1
                table = (*table, count[table] - 1)
            found.setdefault(table, number)
            found.setdefault(tuple(table[:1]), number)
        elif key := re.match(r"\s*([\w-]+)\s*=", line):
            found.setdefault((*table, key[1]), number)
    return found
