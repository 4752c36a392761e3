"""Events of a journal: which there are, and what each has to hold.

`check_event` looks at one event by itself; which event may follow which is `journal.JournalReplay`'s.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from math import isfinite
from typing import Any

from stickslip_fit.logs.schema import (
    ARM_FORMAT,
    CONDITIONS,
    COVARIATE_PREFIX,
    ORIENTATION,
    OWN_LIMITS,
    explain_bad_unit,
    is_known,
    is_outside,
)
from stickslip_fit.units import JOINTS

POSITION_COLUMNS = ("q1", "q2", "q3", "theta", "psi", "start", "stop")
MAX_COUNT = 10**9
YEARS = range(1900, 2200)


class ImpossibleEventError(ValueError):
    """An event that no capture writes; says why."""


@dataclass(frozen=True)
class _Kind:
    """A kind of value, in words, and its test."""

    words: str
    holds: Callable[[Any], bool]


def _is_count(value: Any, least: int = 0) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= MAX_COUNT


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _is_time(value: Any) -> bool:
    try:
        time = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        return False
    return time.tzinfo is not None and time.year in YEARS


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None


def _number_within(limits: tuple[float, float]) -> _Kind:
    """A number that the log may hold, SI: what its reader refuses has to be told of the journal."""
    low, high = limits
    return _Kind(
        f"a number from {low:g} to {high:g}",
        lambda value: _is_number(value) and not is_outside(value, limits),
    )


_TEXT = _Kind("text", lambda value: isinstance(value, str))
_HASH = _Kind("a SHA-256 in hexadecimal digits", _is_hash)
_COUNT = _Kind("a whole number from 0", _is_count)
_COUNT_FROM_1 = _Kind("a whole number from 1", lambda value: _is_count(value, 1))
_NUMBER = _Kind("a number", _is_number)
_POSITION = _Kind("a number or null", lambda value: value is None or _is_number(value))
_TABLE = _Kind("a table of names and values", lambda value: isinstance(value, dict))
_EVENTS = {
    "begun": dict.fromkeys(("name", "version", "controller"), _TEXT) | {"plan": _HASH, "machine": _HASH},
    "conditions": {"values": _TABLE},
    "drive": {
        "planned": _Kind("null or a whole number from 0", lambda value: value is None or _is_count(value)),
        "purpose": _TEXT,
        "row": _TABLE,
    },
    "commanded": {"steps": _COUNT_FROM_1},
    "ended": {
        "steps": _COUNT,
        "pushed": _COUNT,
        "status": _Kind("ok or interrupted", lambda value: value in ("ok", "interrupted")),
        "why": _TEXT,
    },
    "excluded": {"drive": _COUNT, "why": _TEXT},
    "noted": {"drive": _COUNT, "text": _TEXT},
    "skipped": {"planned": _COUNT},
    "writing": {"sha256": _HASH},
}
_ROW = {
    "session": _TEXT,
    "time": _Kind("a date and time with its time zone", _is_time),
    "joint": _Kind("1, 2 or 3", lambda value: _is_count(value) and value in JOINTS),
    "direction": _Kind("+ or -", lambda value: value in ("+", "-")),
    **dict.fromkeys(POSITION_COLUMNS, _NUMBER),
    **{f"q{joint}": _POSITION for joint in JOINTS},
    **{name: _number_within(ARM_FORMAT.by_name[name].limits) for name in (*ORIENTATION, "step_period")},
    "status": _Kind("ok or excluded", lambda value: value in ("ok", "excluded")),
    "check_every": _COUNT_FROM_1,
}


def check_event(event: Any) -> None:
    """Check one event of a journal.

    Raises
    ------
    ImpossibleEventError
        If it is none that a capture writes: an unknown event, a missing or an unknown key, a value of
        another kind, a joint that the machine lacks, a drive that contradicts itself.
    """
    name = event.get("event") if isinstance(event, dict) else None
    if not isinstance(name, str) or name not in _EVENTS:
        known = ", ".join(_EVENTS)
        raise ImpossibleEventError(
            f"the event is {_shorten(event if name is None else name)}, none of {known}"
        )
    fields = {key: value for key, value in event.items() if key not in ("event", "number")}
    _check_fields(name, fields, _EVENTS[name])
    if name == "drive":
        _check_row(event["row"])
    if name == "conditions":
        for column, value in event["values"].items():
            _check_condition(column, value)


def _check_fields(name: str, values: Mapping[str, Any], kinds: Mapping[str, _Kind]) -> None:
    for key in kinds:
        if key not in values:
            raise ImpossibleEventError(f"{name} lacks {key}")
    for key, value in values.items():
        if key not in kinds:
            raise ImpossibleEventError(f"{name} has no key {_shorten(key)}")
        if not kinds[key].holds(value):
            raise ImpossibleEventError(f"{key} of {name} is {_shorten(value)}, not {kinds[key].words}")


def _check_row(row: Mapping[str, Any]) -> None:
    _check_fields("drive", row, _ROW)
    unknown = [joint for joint in JOINTS if row[f"q{joint}"] is None]
    if unknown != [row["joint"]]:
        raise ImpossibleEventError(f"of drive, only q{row['joint']} has to be null, which moves")
    if (row["stop"] > row["start"]) != (row["direction"] == "+") or row["stop"] == row["start"]:
        way = f"{row['start']:g} to {row['stop']:g}"
        raise ImpossibleEventError(f"drive goes from {way}, and its direction is {row['direction']}")


def _check_condition(column: str, value: Any) -> None:
    name = column.removeprefix(COVARIATE_PREFIX)
    own = name != column and bool(name.strip()) and not is_known(name) and not explain_bad_unit(name)
    if not own and column not in CONDITIONS:
        raise ImpossibleEventError(f"{_shorten(column)} is no condition")
    limits = OWN_LIMITS if own else CONDITIONS[column].limits
    _check_fields("conditions", {column: value}, {column: _number_within(limits)})


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
