"""Sweeps of a plan: lists of positions and orientations, taken in every combination."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from math import nan, prod, tau
from typing import Annotated, Any, Literal, Self

import pandas as pd
from annotated_types import Interval, Len, MinLen
from pydantic import AfterValidator, BeforeValidator, Field, create_model, model_validator

from stickslip_fit._toml import Bounds, Give, Quantity, Table, Text, chosen_by
from stickslip_fit.machine import JOINTS, Machine

ANGLES = ("deg", "rad")
UNITS_OF = {1: ANGLES, 2: ANGLES, 3: ("mm", "m", "µm", "nm")}
AXES = ("q1", "q2", "q3", "theta", "psi")
COLUMNS = ("sweep", "joint", "direction", *AXES, "start", "stop")
MOST_CONFIGURATIONS = 100_000


def _range(joint: int) -> Callable[[Machine], Bounds]:
    return lambda machine: machine.ranges[joint]


def _a_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _different(values: list[Any]) -> list[Any]:
    if len(set(values)) < len(values):
        raise ValueError("twice the same")
    return values


LIST, PAIRS = "give {}, or a list of such", "give a list of [from, to], two different ends, each {}"
Numbers = Annotated[
    list[float], MinLen(1), BeforeValidator(_a_list, json_schema_input_type=float | list[float])
]
Pairs = Annotated[list[Annotated[list[float], Len(2, 2), AfterValidator(_different)]], MinLen(1)]
Turns = Annotated[Numbers, Quantity(ANGLES, (-tau, tau), LIST)]
JOINT = Give("give one of 1, 2, 3")
Joint = Annotated[int, JOINT, Interval(ge=1, le=3)]
Ways = Annotated[list[Literal["+", "-"]], MinLen(1), AfterValidator(_different)]


class Sweep(Table, extra="ignore"):
    """What each sweep may have; which keys it has besides depends on the joint."""

    joint: Joint
    """Which joint moves."""
    name: Text = ""
    """Heading on the sheet; the joint if left out."""
    directions: Annotated[Ways, Give('give ["+", "-"], ["-", "+"], ["+"] or ["-"]')] = ["+", "-"]
    """In turn."""
    theta: Turns = [0.0]
    """Orientation of the base, within one turn."""
    psi: Turns = [0.0]
    """Orientation of the base, within one turn."""
    replicates: Annotated[int, Interval(ge=1, le=1_000)] = 1
    """How often each configuration's directions are gone through in a row."""

    @model_validator(mode="after")
    def _few_enough(self) -> Self:
        if (count := self.configurations()) > MOST_CONFIGURATIONS:
            self.refuse((f"makes {count:,} configurations; keep it to {MOST_CONFIGURATIONS:,}", ("name",)))
        return self

    def configurations(self) -> int:
        """How many combinations its lists make."""
        return prod(len(getattr(self, axis, None) or [0]) for axis in ("ranges", *AXES))

    def in_each(self) -> int:
        """How many traverses each of them takes."""
        return len(self.directions) * self.replicates

    def axes(self, machine: Machine) -> dict[str, list[Any]]:
        """What varies, in the order of the table's keys."""
        axes = {axis: getattr(self, axis) for axis in ("ranges", *AXES) if hasattr(self, axis)}
        axes["ranges"] = axes["ranges"] or [machine.ranges[self.joint]]
        written = self.fields_in_file()
        order = sorted(axes, key=lambda axis: written.index(axis) if axis in written else -1)
        return {axis: axes[axis] for axis in order}

    def rows(self, machine: Machine) -> Iterator[tuple[Any, ...]]:
        """Its traverses, with the columns of `Plan.traverses` from sweep on."""
        axes = self.axes(machine)
        for combination in product(*axes.values()):
            place = {f"q{self.joint}": nan, **dict(zip(axes, combination, strict=True))}
            low, high = sorted(place["ranges"])
            for direction in self.directions * self.replicates:
                start, stop = (low, high) if direction == "+" else (high, low)
                name = self.name or f"joint {self.joint}"
                yield (name, self.joint, direction, *(place[axis] for axis in AXES), start, stop)


def _of_joint(joint: int) -> type[Sweep]:
    ranges = Annotated[Pairs, Quantity(UNITS_OF[joint], _range(joint), PAIRS)]
    said = "Ends of partial traverses, which each direction runs its own way; the full range if left out."
    fields: dict[str, Any] = {
        "joint": Annotated[Literal[joint], JOINT],
        "ranges": (ranges, Field([], description=said)),
    }
    for other in {*JOINTS} - {joint}:
        numbers = Annotated[Numbers, Quantity(UNITS_OF[other], _range(other), LIST)]
        # Joints 2 and 3 act on every law: where they stand has to be said.
        default = [0.0] if other == 1 else ...
        fields[f"q{other}"] = (numbers, Field(default, description=f"Where joint {other} stands."))
    return create_model(f"SweepOfJoint{joint}", __base__=Sweep, __cls_kwargs__={"extra": "forbid"}, **fields)


AnySweep = Annotated[Sweep, chosen_by("joint", {joint: _of_joint(joint) for joint in JOINTS}, Sweep)]


def traverses_of(sweeps: list[Sweep], machine: Machine) -> pd.DataFrame:
    """The traverses of all [[sweep]] tables, in order, with the columns of `Plan.traverses`.

    A key's list is taken in every combination with the others', the last key of the table fastest.
    """
    records = [row for sweep in sweeps for row in sweep.rows(machine)]
    table = pd.DataFrame(records, columns=list(COLUMNS)).astype({"joint": "int64"})
    table.insert(0, "visit", _visits(table))
    return table


def _visits(table: pd.DataFrame) -> pd.Series:
    """Number the stretches in which nobody needs to set anything: only the direction changes."""
    setting = table[["joint", *AXES]].fillna(0.0)
    ends = table[["start", "stop"]]
    setting["low"], setting["high"] = ends.min(axis=1), ends.max(axis=1)
    return (setting != setting.shift()).any(axis=1).cumsum() - 1
