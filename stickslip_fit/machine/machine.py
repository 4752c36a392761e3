"""The manipulator: its geometry, ranges and masses, read from a small TOML file."""

from __future__ import annotations

import hashlib
import sys
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from math import inf, nan
from pathlib import Path
from typing import Any, TypeGuard

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.units import JOINTS, to_si


@dataclass(frozen=True)
class Link:
    """Mass in kg, centre of mass in m along the link, principal moments in kg m^2 (see mm3a.toml)."""

    mass: float
    com: float
    inertia: tuple[float, float, float]


@dataclass(frozen=True)
class Machine:
    """A three-joint manipulator, SI throughout.

    Attributes
    ----------
    name : str
    a1 : float
        Distance of joint 2's axis from joint 1's, m.
    l2 : float
        Distance of the tip from joint 2's axis with joint 3 at 0, m.
    ranges : dict of int to (float, float)
        Lowest and highest position of each joint between its mechanical stops, rad or m.
    links : tuple of Link
        Three links, base to tip.
    sha256 : str
        Hash of the file's bytes; every result carries it.
    """

    name: str
    a1: float
    l2: float
    ranges: dict[int, tuple[float, float]]
    links: tuple[Link, Link, Link]
    sha256: str

    def span(self, joint: int) -> float:
        """Full travel of a joint, rad or m."""
        low, high = self.ranges[joint]
        return high - low


def load_machine(path: str | Path | None = None) -> Machine:
    """Read a machine file; without a path, the nominal MM3A that comes with the package.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a key, has one too many, or holds a value that cannot be;
        all of a file's faults together.

    Examples
    --------
    >>> load_machine().ranges[3]
    (0.0, 0.012)
    """
    if path is None:
        raw = resources.files("stickslip_fit.machine").joinpath("mm3a.toml").read_bytes()
        return _parse(raw, "mm3a.toml")
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise InputError(
            Problem(f"cannot be read ({error.strerror}); name an existing machine file", str(path))
        ) from None
    return _parse(raw, str(path))


def _parse(raw: bytes, file: str) -> Machine:
    try:
        content = tomllib.loads(raw.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(Problem(f"is no TOML file ({error}); see mm3a.toml for the form", file)) from None
    top = _Table(file, "", content, ("name", "geometry", "range", "link"), [])
    name = content.get("name", Path(file).stem)
    if not isinstance(name, str):
        top.complain("name", "give the machine's name in quotes")
    geometry = top.table("geometry", ("a1_mm", "l2_mm"))
    positions = top.table("range", ("q1_deg", "q2_deg", "q3_mm"))
    a1 = geometry.number("a1_mm", "a length in mm, zero or more", least=0.0)
    l2 = geometry.number("l2_mm", "a length in mm, zero or more", least=0.0)
    q1, q2 = (
        positions.pair(key, "[lowest, highest] in deg within ±360", 360.0) for key in ("q1_deg", "q2_deg")
    )
    q3 = positions.pair("q3_mm", "[lowest, highest] in mm")
    if l2 + q3[0] <= 0:
        geometry.complain(
            "l2_mm", "with joint 3 at its lowest the tip must stay clear of joint 2's axis: l2 + q3 > 0"
        )
    links = [_link(table) for table in top.links()]
    if top.problems:
        raise InputError(top.problems)
    return Machine(
        name=name,
        a1=to_si(a1, "mm"),
        l2=to_si(l2, "mm"),
        ranges={
            1: (to_si(q1[0], "deg"), to_si(q1[1], "deg")),
            2: (to_si(q2[0], "deg"), to_si(q2[1], "deg")),
            3: (to_si(q3[0], "mm"), to_si(q3[1], "mm")),
        },
        links=(links[0], links[1], links[2]),
        sha256=hashlib.sha256(raw).hexdigest(),
    )


def _link(table: _Table) -> Link:
    mass = table.number("mass_g", "a mass in g above 0", least=sys.float_info.min)
    com = table.number("com_mm", "a distance in mm")
    moments = table.numbers(
        "inertia_g_mm2", 3, "[xx, yy, zz] in g mm^2, zero or more", lambda values: min(values) >= 0
    )
    xx, yy, zz = (to_si(moment, "g mm²") for moment in moments)
    return Link(to_si(mass, "g"), to_si(com, "mm"), (xx, yy, zz))


@dataclass(frozen=True)
class _Table:
    """One table of the file: hands out its values and notes what is wrong with them.

    What it hands out in place of a faulty value is NaN, which no comparison finds fault with again.
    """

    file: str
    place: str
    content: dict[str, Any]
    keys: Sequence[str]
    problems: list[Problem]

    def __post_init__(self) -> None:
        for key in self.content:
            if key not in self.keys:
                self.complain(key, f"is no key of a machine file here; the keys are {', '.join(self.keys)}")

    def complain(self, key: str, message: str) -> None:
        value = self.content.get(key)
        shown = None if value is None else str(value)
        self.problems.append(Problem(message, self.file, column=f"{self.place}{key}", value=shown))

    def table(self, key: str, keys: Sequence[str]) -> _Table:
        found = self.content.get(key, {})
        if not isinstance(found, dict):
            self.complain(key, f"make it a table, [{key}], with the keys {', '.join(keys)}")
            found = {}
        return _Table(self.file, f"{key}.", found, keys, self.problems)

    def links(self) -> list[_Table]:
        found = self.content.get("link")
        tables = [table for table in found if isinstance(table, dict)] if isinstance(found, list) else []
        if len(tables) != len(JOINTS) or tables != found:
            self.complain("link", "give three [[link]] tables, base to tip")
            return []
        keys = ("mass_g", "com_mm", "inertia_g_mm2")
        places = [f"link {number} " for number in JOINTS]
        return [
            _Table(self.file, place, table, keys, self.problems)
            for place, table in zip(places, tables, strict=True)
        ]

    def number(self, key: str, wanted: str, least: float = -inf) -> float:
        value = self.content.get(key)
        if not _is_number(value) or value < least:
            self.complain(key, f"give {wanted}")
            return nan
        return float(value)

    def numbers(self, key: str, count: int, wanted: str, fits: Callable[[list[float]], bool]) -> list[float]:
        value = self.content.get(key)
        if isinstance(value, list) and len(value) == count and all(map(_is_number, value)) and fits(value):
            return [float(entry) for entry in value]
        self.complain(key, f"give {wanted}")
        return [nan] * count

    def pair(self, key: str, wanted: str, farthest: float = inf) -> list[float]:
        return self.numbers(key, 2, wanted, lambda ends: -farthest <= ends[0] < ends[1] <= farthest)


def _is_number(value: object) -> TypeGuard[float]:
    """A finite number; a whole one may be too large for a float, true and false are none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) <= sys.float_info.max
