"""The keys of a machine file, as pydantic models; apart from `machine`, which imports them when needed."""

from __future__ import annotations

import sys
from math import inf, tau
from typing import Annotated, Literal, Self

from annotated_types import Len
from pydantic import AfterValidator, BeforeValidator, model_validator

from stickslip_fit._toml import Give, Quantity, TomlTable, chosen_by


def _rising(ends: list[float]) -> list[float]:
    if not ends[0] < ends[1]:
        raise ValueError("not rising")
    return ends


def _three(links: object) -> object:
    if not isinstance(links, list) or len(links) != 3 or not all(isinstance(link, dict) for link in links):
        raise ValueError("not three tables")
    return links


Ends = Annotated[list[float], Len(2, 2), AfterValidator(_rising)]
Moments = Quantity(("g mm²",), (0.0, inf), "give [xx, yy, zz] in g mm^2, zero or more")
Length = Annotated[float, Quantity(("mm",), (0.0, inf), "give a length in mm, zero or more")]
Angles = Annotated[Ends, Quantity(("deg",), (-tau, tau), "give [lowest, highest] in deg within ±360")]


class GeometryTable(TomlTable):
    """Lengths between axes."""

    a1: Length
    """Distance of joint 2's axis from joint 1's."""
    l2: Length
    """Distance of the tip from joint 2's axis with joint 3 at 0."""


class RangeTable(TomlTable):
    """Lowest and highest position of each joint between its mechanical stops."""

    q1: Angles
    q2: Angles
    q3: Annotated[Ends, Quantity(("mm",), advice="give [lowest, highest] in mm")]


class LinkTable(TomlTable):
    """Mass properties of a link; only the dynamics use them."""

    mass: Annotated[float, Quantity(("g",), (sys.float_info.min, inf), "give a mass in g above 0")]
    com: Annotated[float, Quantity(("mm",), advice="give a distance in mm")]
    """Centre of mass, from the origin of the link's Denavit-Hartenberg frame back along the link."""
    inertia: Annotated[list[float], Len(3, 3), Moments]
    """Principal moments about the centre of mass, along the axes of the link's frame."""


class MachineFile(TomlTable):
    """A machine."""

    name: Annotated[str, Give("give the machine's name in quotes")] = ""
    """The file's name if left out."""
    geometry: GeometryTable
    range: RangeTable
    link: Annotated[list[LinkTable], BeforeValidator(_three), Give("give three [[link]] tables, base to tip")]

    @model_validator(mode="after")
    def _tip_stays_clear(self) -> Self:
        if self.geometry.l2 + self.range.q3[0] <= 0:
            advice = "with joint 3 at its lowest the tip must stay clear of joint 2's axis: l2 + q3 > 0"
            self.refuse((advice, ("geometry", "l2_mm")))
        return self


MAX_TURNS, MAX_TRAVEL = 100 * tau, 100.0  # rad, m
MAX_JOINTS = 30
KIND = Give('give "rotary" or "prismatic"')


class JointTable(TomlTable, extra="ignore"):
    """A joint by itself; the unit of its range follows from its kind."""

    kind: Annotated[Literal["rotary", "prismatic"], KIND]
    name: Annotated[str, Give("give the joint's name in quotes")] = ""
    """Your own name of the joint."""
    range: Ends


class RotaryTable(JointTable, extra="forbid"):
    """A joint that turns."""

    kind: Annotated[Literal["rotary"], KIND]
    range: Annotated[
        Ends, Quantity(("deg", "rad"), (-MAX_TURNS, MAX_TURNS), "give [lowest, highest] within 100 turns")
    ]
    """Lowest and highest position between the mechanical stops; may be more than a turn."""


class PrismaticTable(JointTable, extra="forbid"):
    """A joint that slides."""

    kind: Annotated[Literal["prismatic"], KIND]
    range: Annotated[
        Ends, Quantity(("mm", "m", "µm"), (-MAX_TRAVEL, MAX_TRAVEL), "give [lowest, highest] within 100 m")
    ]
    """Lowest and highest position between the mechanical stops."""


AnyJoint = Annotated[
    JointTable, chosen_by("kind", {"rotary": RotaryTable, "prismatic": PrismaticTable}, JointTable)
]


class JointsFile(TomlTable):
    """A machine of joints 1 to n, base to tip, without lengths and masses."""

    name: Annotated[str, Give("give the machine's name in quotes")] = ""
    """The file's name if left out."""
    joint: Annotated[list[AnyJoint], Len(1, MAX_JOINTS), Give("give one to 30 [[joint]] tables, base to tip")]
