"""Sweeps of a plan: lists of positions and orientations, taken in every combination."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import nan, pi, prod
from typing import Any

import pandas as pd

from stickslip_fit.logs.check import DIRECTIONS
from stickslip_fit.logs.settings import ANGLES, LENGTHS, Settings
from stickslip_fit.machine import JOINTS, Machine

AXES = {"q1": ANGLES, "q2": ANGLES, "q3": LENGTHS, "theta": ANGLES, "psi": ANGLES}
DEFAULTS = {"q1": [0.0], "theta": [0.0], "psi": [0.0]}  # q2 and q3 act on every law: they have to be said
ONE_TURN = (-2 * pi, 2 * pi)
JOINT_OF = {"q1": 1, "q2": 2, "q3": 3}
COLUMNS = ("sweep", "joint", "direction", *AXES, "start", "stop")
MOST_IN_A_ROW = 1_000
MOST_CONFIGURATIONS = 100_000


def read_sweeps(sweeps: list[Settings], machine: Machine) -> pd.DataFrame:
    """The traverses of all [[sweep]] tables, in order, with the columns of `Plan.traverses`.

    A key's list is taken in every combination with the others', the last key of the table fastest.
    """
    records = [record for sweep in sweeps for record in _read_sweep(sweep, machine)]
    table = pd.DataFrame(records, columns=list(COLUMNS)).astype({"joint": "int64"})
    table.insert(0, "visit", _visits(table))
    return table


def _visits(table: pd.DataFrame) -> pd.Series:
    """Number the stretches in which nobody needs to set anything: only the direction changes."""
    setting = table[["joint", *AXES]].fillna(0.0)
    ends = table[["start", "stop"]]
    setting["low"], setting["high"] = ends.min(axis=1), ends.max(axis=1)
    return (setting != setting.shift()).any(axis=1).cumsum() - 1


def _read_sweep(sweep: Settings, machine: Machine) -> Iterator[tuple[Any, ...]]:
    joint = sweep.choice("joint", JOINTS, None)
    name = sweep.text("name", f"joint {joint}")
    directions = _directions(sweep)
    in_a_row = sweep.whole("replicates", 1, MOST_IN_A_ROW, 1)
    if joint is None:
        return
    axes = _axes(sweep, joint, machine)
    sweep.reject_unknown()
    configurations = prod(map(len, axes.values()))
    if configurations > MOST_CONFIGURATIONS:
        sweep.complain("name", f"makes {configurations:,} configurations; keep it to {MOST_CONFIGURATIONS:,}")
        return
    for combination in product(*axes.values()):
        place = {f"q{joint}": nan, **dict(zip(axes, combination, strict=True))}
        low, high = sorted(place["ranges"])
        for direction in directions * in_a_row:
            start, stop = (low, high) if direction == "+" else (high, low)
            yield (name, joint, direction, *(place[axis] for axis in AXES), start, stop)


def _directions(sweep: Settings) -> list[str]:
    given = sweep.take("directions", list(DIRECTIONS))
    if isinstance(given, list) and given in (["+", "-"], ["-", "+"], ["+"], ["-"]):
        return given
    sweep.complain("directions", 'give ["+", "-"], ["-", "+"], ["+"] or ["-"]')
    return []


def _axes(sweep: Settings, joint: int, machine: Machine) -> dict[str, list[Any]]:
    """What varies in a sweep, in the order of the table's keys; an empty list where a key is faulty."""
    moving = f"q{joint}"
    full = machine.ranges[joint]
    axes: dict[str, list[Any]] = {"ranges": sweep.pairs("ranges", AXES[moving], full, [full])}
    for axis in AXES:
        if axis != moving:
            within = machine.ranges[JOINT_OF[axis]] if axis in JOINT_OF else ONE_TURN
            axes[axis] = sweep.numbers(axis, AXES[axis], within, DEFAULTS.get(axis))
    written = [key.rpartition("_")[0] for key in sweep.content]
    order = sorted(axes, key=lambda axis: written.index(axis) if axis in written else -1)
    return {axis: axes[axis] for axis in order}
