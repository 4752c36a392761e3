"""TOML files as pydantic models, with all issues at once and advice for each."""

from __future__ import annotations

import ast
import inspect
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin

from annotated_types import Interval, MinLen
from pydantic import BaseModel, ConfigDict, PrivateAttr, ValidationError, ValidationInfo, model_validator
from pydantic.functional_validators import WrapValidator
from pydantic_core import InitErrorDetails, PydanticCustomError, core_schema

from stickslip_fit._input import format_path, read_file
from stickslip_fit.errors import InputError, InputIssue, suggest
from stickslip_fit.units import SUFFIXES, from_si, to_si

Bounds = tuple[float, float]
Place = tuple[str | int, ...]
Misfit = tuple[str, Place]
"""Advice, and the path of its key from the table on."""
Text = Annotated[str, MinLen(1)]
Count = Annotated[int, Interval(ge=1, le=10_000)]

SLACK = 1e-9  # share of a range; less is rounding
SUFFIX_OF = {symbol: suffix for suffix, symbol in SUFFIXES.items()}
FAULT = "fault"
MAX_BYTES = 2**19  # of a file; a plan of a year has some kB
MAX_ISSUES = 100  # shown; the others are counted
_DEEP_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){32}""")


@dataclass(frozen=True)
class Give:
    """Metadata of a field: the advice for a value that cannot be used."""

    advice: str


@dataclass(frozen=True)
class Quantity:
    """Metadata of a field whose keys end in one of `units`; the model has it in SI.

    `within` bounds every number, SI; a callable takes the context of the validation. In `advice`, ``{}``
    stands for a number, its unit and its bounds.
    """

    units: tuple[str, ...]
    within: Bounds | Callable[[Any], Bounds] = (-inf, inf)
    advice: str = "give {}"

    def keys(self, stem: str) -> dict[str, str]:
        """Every key that may give the quantity, with its unit.

        Examples
        --------
        >>> Quantity(("µrad/mm", "1")).keys("gamma0")
        {'gamma0_urad_per_mm': 'µrad/mm', 'gamma0': '1'}
        """
        return {stem if unit == "1" else f"{stem}_{SUFFIX_OF[unit]}": unit for unit in self.units}

    def advice_in(self, unit: str, context: Any) -> str:
        """The advice for a key in `unit`; without a context, independent of it."""
        low, high = (from_si(end, unit) for end in self._bounds(context))
        span = f", {low:g} or more" if high == inf else f", {low:g} to {high:g}"
        number = "a number" if unit == "1" else f"a number in {unit}"
        return self.advice.format(number + span * isfinite(low))

    def _bounds(self, context: Any) -> Bounds:
        if not callable(self.within):
            return self.within
        return (-inf, inf) if context is None else self.within(context)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        """The field's own type, with every number checked and converted to SI."""

        def read(written: tuple[Any, str], inner: Callable[[Any], Any], info: ValidationInfo) -> Any:
            low, high = self._bounds(info.context)
            slack = SLACK * (high - low) if isfinite(high - low) else 0.0

            def si(number: float) -> float:
                value = to_si(number, written[1])
                if not low - slack <= value <= high + slack:
                    raise ValueError("out of bounds")
                return value

            return _convert(si, inner(written[0]))

        return core_schema.with_info_wrap_validator_function(read, handler(source))


class TomlTable(BaseModel):
    """A table of a TOML file: no other keys than its fields, no conversion between types."""

    # Most commands read no file of most models, so that none is built before its first use.
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)
    _written: dict[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def fields_by_key(cls) -> dict[str, tuple[str, str]]:
        """The field that each key gives, and the unit if it is a quantity."""
        fields: dict[str, tuple[str, str]] = {}
        for name, field in cls.model_fields.items():
            quantities = (data.keys(name) for data in field.metadata if isinstance(data, Quantity))
            fields |= {key: (name, unit) for key, unit in next(quantities, {name: ""}).items()}
        return fields

    def fields_in_file(self) -> list[str]:
        """The fields in the file, in its order."""
        return [self.fields_by_key()[key][0] for key in self._written]

    def refuse(self, *rejections: Misfit) -> None:
        """Raise issues of values that are valid by themselves, if there are any."""
        faults = [_fault(advice, place, _value_at(self._written, place)) for advice, place in rejections]
        if faults:
            raise ValidationError.from_exception_data(type(self).__name__, faults)

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, written: Any, handler: Callable[[Any], Self], info: ValidationInfo) -> Self:
        if not isinstance(written, dict):
            return handler(written)
        keys, faults = cls.fields_by_key(), []
        content: dict[str, Any] = {name: {} for name in cls.model_fields if _is_table(cls, name)}
        key_of = {name: key for key, (name, _) in reversed(keys.items())}
        for key, value in written.items():
            name, unit = keys.get(key, ("", ""))
            if unit and name in content:
                advice = f"{key_of[name]} gives the same quantity; keep one of them"
                faults.append(_fault(advice, (key,), value))
            elif name:
                content[name], key_of[name] = (value, unit) if unit else value, key
            elif cls.model_config["extra"] == "forbid":
                faults.append(_fault(_unknown(key, keys), (key,), value))
        try:
            table = handler(content)
        except ValidationError as error:
            own: dict[str, InitErrorDetails] = {}
            for detail in error.errors(include_url=False):
                key, issues = key_of[str(detail["loc"][0])], detail.get("ctx", {}).get("issues", ())
                if detail["type"] == FAULT and len(detail["loc"]) > 1:
                    faults.append(_fault(detail["msg"], detail["loc"], detail["input"], issues))
                else:
                    advice = detail["msg"] if detail["type"] == FAULT else _advice(cls, key, info.context)
                    own.setdefault(key, _fault(advice, (key,), written.get(key), issues))
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
        fields, own["properties"] = own["properties"], {}
        meanings = _attribute_docstrings(cls)
        needed: dict[str, list[Any]] = {
            name: [] for name in own.pop("required", ()) if not _is_table(cls, name)
        }
        for key, (name, unit) in cls.fields_by_key().items():
            entry = own["properties"][key] = fields[name] | {"title": _advice(cls, key, None)}
            entry |= {"description": meanings[name]} if name in meanings else {}
            if unit and entry.get("default") is not None:
                entry["default"] = _convert(partial(from_si, symbol=unit), entry["default"])
            if name in needed:
                needed[name].append({"required": [key]})
        if needed:
            own["allOf"] = [{"oneOf": keys} for keys in needed.values()]
        return schema


def read_toml[Model: TomlTable](
    path: str | Path, model: type[Model], kind: str, context: Any = None
) -> Model:
    """Read a file that `kind` names; see `read_file` and `parse_toml`."""
    return parse_toml(read_file(path, kind, MAX_BYTES), format_path(path), model, context)


def parse_toml[Model: TomlTable](raw: bytes, file: str, model: type[Model], context: Any = None) -> Model:
    """A TOML text as a model; InputError with every issue: file, line, key, value, and what to do."""
    try:
        text = raw.decode("utf-8-sig")
        if _DEEP_KEY.search(text):  # which takes tomllib forever
            raise ValueError("a key has more than 32 parts")
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(InputIssue(f"is no TOML file ({error}); correct it there", file)) from None
    try:
        return model.model_validate(content, context=context)
    except ValidationError as error:
        lines, issues = _find_lines(text), list[InputIssue]()
        for detail in error.errors(include_url=False):
            place, value = detail["loc"], None if detail["input"] is None else _format_value(detail["input"])
            line = next((lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in lines), None)
            issue = InputIssue(detail["msg"], file, line, _format_place(place), value)
            issues += detail["ctx"]["issues"] or [issue]
        if len(issues) > MAX_ISSUES:
            rest = InputIssue(f"... and {len(issues) - MAX_ISSUES:,} more", file)
            issues = [*issues[:MAX_ISSUES], rest]
        raise InputError(issues) from None


def fault(advice: str, issues: Sequence[InputIssue] = ()) -> PydanticCustomError:
    """For a validator of a field: its own advice, or issues of another file."""
    return PydanticCustomError(FAULT, "{advice}", {"advice": advice, "issues": issues})


def chosen_by(
    key: str | Callable[[Mapping[str, Any]], Any],
    models: Mapping[Any, type[TomlTable]],
    other: type[TomlTable],
) -> WrapValidator:
    """For a table whose keys depend on the value of one, or on what a function makes of it.

    `other` is for values without a model.
    """

    def read(written: Any, inner: Any, info: ValidationInfo) -> Any:
        value = None
        if isinstance(written, dict):
            value = key(written) if callable(key) else written.get(key)
        model = models.get(value, other) if type(value) in (int, str) else other
        return model.model_validate(written, context=info.context)

    return WrapValidator(read, json_schema_input_type=Union[tuple(models.values())])  # noqa: UP007


def _fault(advice: str, place: Place, value: Any, issues: Sequence[InputIssue] = ()) -> InitErrorDetails:
    return InitErrorDetails(type=fault(advice, issues), loc=place, input=value)


def _convert(change: Callable[[float], float], value: Any) -> Any:
    return [_convert(change, item) for item in value] if isinstance(value, list) else change(value)


def _is_table(table: type[TomlTable], name: str) -> bool:
    kind = table.model_fields[name].annotation
    return isinstance(kind, type) and issubclass(kind, TomlTable)


def _advice(table: type[TomlTable], key: str, context: Any) -> str:
    """What to write for a key: as its field says, or as its type does."""
    name, unit = table.fields_by_key()[key]
    field = table.model_fields[name]
    for data in field.metadata:
        if isinstance(data, Give):
            return data.advice
        if isinstance(data, Quantity):
            return data.advice_in(unit, context)
        if isinstance(data, Interval):
            return f"give a whole number from {data.ge} to {data.le}"
    kinds = [field.annotation, *get_args(field.annotation)]
    if choices := next((get_args(kind) for kind in kinds if get_origin(kind) is Literal), ()):
        return f"give one of {', '.join(map(repr, choices))}"
    if str in kinds:
        return "give a text in quotes"
    return f"write it as a table: [{key}]" if _is_table(table, name) else f"give at least one table [[{key}]]"


def _attribute_docstrings(table: type[TomlTable]) -> dict[str, str]:
    """The strings below fields; pydantic could read them too, but would at every start of a command."""
    docstrings = {}
    for model in table.__mro__[-3::-1]:
        with suppress(OSError):
            body = ast.parse(inspect.getsource(model)).body[0].body  # type: ignore[attr-defined]
            for field, text in pairwise(body):
                if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                    docstrings[ast.unparse(field.target)] = ast.literal_eval(text.value)
    return docstrings


def _unknown(key: str, keys: dict[str, tuple[str, str]]) -> str:
    one_each = {name: key for key, (name, _) in reversed(keys.items())}
    names = ", ".join(reversed(one_each.values()))
    return f"is no key of this table, which may have {names}{suggest(key, keys)}"


def _value_at(value: Any, place: Place) -> Any:
    for part in place:
        value = value.get(part) if isinstance(value, dict) else value[part]
        if value is None:
            break
    return value


def _format_place(place: Place) -> str:
    """The path of a key.

    Examples
    --------
    >>> _format_place(("sessions", "dates")), _format_place(("scenario", 1, "cause", 0, "tau"))
    ('sessions.dates', 'scenario 2 cause 1 tau')
    """
    parts = [f" {part + 1} " if isinstance(part, int) else f".{part}" for part in place]
    return "".join(parts).replace(" .", " ").strip(". ")


def _format_value(value: object) -> str:
    """A value as in the file."""
    if isinstance(value, list):
        return f"[{', '.join(map(_format_value, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _find_lines(text: str) -> dict[Place, int]:
    """The line of every table and of every key at the beginning of a line."""
    found: dict[Place, int] = {}
    table: Place = ()
    count: Counter[Place] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*(\[\[?)\s*([\w.-]+)\s*\]", line):
            *parents, last = header[2].split(".")
            table = ()
            for name in parents:
                table = (*table, name, count[*table, name] - 1) if count[*table, name] else (*table, name)
            table = (*table, last)
            found.setdefault(table, number)
            if header[1] == "[[":
                count[table] += 1
                table = (*table, count[table] - 1)
                found[table] = number
        elif key := re.match(r"\s*([\w-]+)\s*=", line):
            found.setdefault((*table, key[1]), number)
    return found
