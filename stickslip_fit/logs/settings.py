"""A TOML file taken apart key by key; its faults are collected, so that a person sees all of them at once."""

from __future__ import annotations

import math
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.units import SUFFIXES, from_si, to_si

Choice = TypeVar("Choice")

ANGLES = ("deg", "rad")
LENGTHS = ("mm", "m", "µm", "nm")
SUFFIX_OF = {symbol: suffix for suffix, symbol in SUFFIXES.items()}
Bounds = tuple[float, float]
ANYWHERE = (-math.inf, math.inf)
SLACK = 1e-9  # share of a range; less is rounding
LARGEST = sys.float_info.max  # TOML has whole numbers beyond it


@dataclass
class Settings:
    """One table of a TOML file.

    Every method that takes a value out notes a fault and returns something of the right type, so that
    reading goes on; `finish` raises what was noted.

    Attributes
    ----------
    content : dict
        The table as parsed.
    file : str
        As a person would call it.
    place : str
        Prefix of this table's keys in messages.
    problems : list of Problem
        Shared with the tables inside this one.
    known : list of str
        Keys asked for so far.
    """

    content: dict[str, Any]
    file: str
    place: str = ""
    problems: list[Problem] = field(default_factory=list)
    known: list[str] = field(default_factory=list)

    def complain(self, key: str, message: str) -> None:
        """Note a fault of `key`."""
        value = self.content.get(key)
        shown = None if value is None else _shown(value)
        self.problems.append(Problem(message, self.file, column=f"{self.place}{key}", value=shown))

    def take(self, key: str, default: Any = None) -> Any:
        """The raw value of `key`."""
        self.known.append(key)
        return self.content.get(key, default)

    def text(self, key: str, default: str) -> str:
        """A text of at least one character."""
        value = self.take(key, default)
        if isinstance(value, str) and value:
            return value
        self.complain(key, "give a text in quotes")
        return default

    def whole(self, key: str, lowest: int, highest: int, default: int) -> int:
        """A whole number between two bounds."""
        value = self.take(key, default)
        if isinstance(value, int) and not isinstance(value, bool) and lowest <= value <= highest:
            return value
        self.complain(key, f"give a whole number from {lowest} to {highest}")
        return default

    def choice(self, key: str, allowed: Sequence[Choice], default: Choice) -> Choice:
        """One of a few values; None for a default asks for one."""
        value = self.take(key, default)
        for candidate in allowed:
            if value == candidate and type(value) is type(candidate):
                return candidate
        self.complain(key, f"give one of {', '.join(map(repr, allowed))}")
        return default

    def find(self, stem: str, symbols: Sequence[str]) -> tuple[str, str]:
        """The key that gives a quantity, as written or as it may be written, and its unit."""
        keys = {spelling(stem, symbol): symbol for symbol in symbols}
        present = [key for key in keys if key in self.content] or list(keys)[:1]
        self.known += [key for key in present if key not in self.known]
        if len(present) > 1:
            self.complain(present[1], f"{present[0]} gives the same quantity; keep one of them")
        return present[0], keys[present[0]]

    def number(
        self, stem: str, symbols: Sequence[str], within: Bounds = ANYWHERE, default: float | None = None
    ) -> float:
        """One number between two bounds, SI; NaN where it is faulty or missing."""
        key, symbol = self.find(stem, symbols)
        value = self.content.get(key)
        if value is None and default is not None:
            return default
        if _lies(value, symbol, within):
            return to_si(float(value), symbol)
        self.complain(key, f"give {_wanted(symbol, within)}")
        return math.nan

    def numbers(
        self,
        stem: str,
        symbols: Sequence[str],
        within: Bounds = ANYWHERE,
        default: list[float] | None = None,
    ) -> list[float]:
        """A number or a list of numbers, each between two bounds, SI; empty where faulty or missing."""
        key, symbol = self.find(stem, symbols)
        value = self.content.get(key)
        if value is None and default is not None:
            return default
        numbers: list[Any] = value if isinstance(value, list) else [value]
        if numbers and all(_lies(number, symbol, within) for number in numbers):
            return [to_si(float(number), symbol) for number in numbers]
        self.complain(key, f"give {_wanted(symbol, within)}, or a list of such")
        return []

    def pair(self, stem: str, symbols: Sequence[str], within: Bounds, default: Bounds) -> Bounds:
        """[lower, higher], each between two bounds, SI."""
        key, symbol = self.find(stem, symbols)
        value = self.content.get(key)
        if value is None:
            return default
        if _is_pair(value, symbol, within) and value[0] <= value[1]:
            return to_si(float(value[0]), symbol), to_si(float(value[1]), symbol)
        self.complain(key, f"give [lowest, highest], each {_wanted(symbol, within)}")
        return default

    def pairs(self, stem: str, symbols: Sequence[str], within: Bounds, default: list[Bounds]) -> list[Bounds]:
        """A list of pairs of two different numbers, each between two bounds, SI; empty where it is faulty."""
        key, symbol = self.find(stem, symbols)
        value = self.content.get(key)
        if value is None:
            return default
        pairs: list[Any] = value if isinstance(value, list) and value else [None]
        if all(_is_pair(pair, symbol, within) and pair[0] != pair[1] for pair in pairs):
            return [(to_si(float(first), symbol), to_si(float(last), symbol)) for first, last in pairs]
        self.complain(key, f"give a list of [from, to], two different ends, each {_wanted(symbol, within)}")
        return []

    def table(self, key: str) -> Settings:
        """The table under `key`, empty where there is none."""
        value = self.take(key, {})
        if not isinstance(value, dict):
            self.complain(key, f"write it as a table: [{key}]")
            value = {}
        return Settings(value, self.file, f"{self.place}{key}.", self.problems)

    def tables(self, key: str) -> list[Settings]:
        """The tables under ``[[key]]``, numbered from 1 in messages; a fault where there is none."""
        value = self.take(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            self.complain(key, f"give at least one table [[{key}]]")
            return []
        return [
            Settings(item, self.file, f"{key} {number} ", self.problems)
            for number, item in enumerate(value, start=1)
        ]

    def reject_unknown(self) -> None:
        """Complain of every key that nobody asked for: a misspelt key must not pass for an absent one."""
        for key in self.content:
            if key not in self.known:
                self.complain(key, f"is no key of this table; it may have {', '.join(self.known)}")

    def finish(self) -> None:
        """Raise what was found.

        Raises
        ------
        InputError
            If there was anything.
        """
        if self.problems:
            raise InputError(self.problems)


def read_settings(path: str | Path) -> Settings:
    """Read a TOML file.

    Raises
    ------
    InputError
        If it cannot be read or is no TOML.
    """
    try:
        content = tomllib.loads(Path(path).read_bytes().decode("utf-8"))
    except OSError as error:
        message = f"cannot be read ({error.strerror}); name an existing file"
        raise InputError(Problem(message, str(path))) from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(Problem(f"is no TOML file ({error}); correct it there", str(path))) from None
    return Settings(content, str(path))


def spelling(stem: str, symbol: str) -> str:
    """The key of a quantity in a unit.

    Examples
    --------
    >>> spelling("gamma0", "µrad/mm"), spelling("b", "1")
    ('gamma0_urad_per_mm', 'b')
    """
    return stem if symbol == "1" else f"{stem}_{SUFFIX_OF[symbol]}"


def is_number(value: object) -> TypeGuard[float]:
    """Whether a TOML value is a finite number (true and inf are none)."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST


def _shown(value: object) -> str:
    """A value much as it stands in the file."""
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _lies(value: object, symbol: str, within: Bounds) -> TypeGuard[float]:
    lowest, highest = within
    slack = SLACK * (highest - lowest) if math.isfinite(highest - lowest) else 0.0
    return is_number(value) and lowest - slack <= to_si(float(value), symbol) <= highest + slack


def _is_pair(value: object, symbol: str, within: Bounds) -> TypeGuard[list[float]]:
    return isinstance(value, list) and len(value) == 2 and all(_lies(end, symbol, within) for end in value)


def _wanted(symbol: str, within: Bounds) -> str:
    unit = "" if symbol == "1" else f" in {symbol}"
    low, high = (f"{from_si(bound, symbol):g}" for bound in within)
    if within == ANYWHERE:
        return f"a number{unit}"
    return f"a number{unit}, {low} or more" if math.isinf(within[1]) else f"a number{unit}, {low} to {high}"
