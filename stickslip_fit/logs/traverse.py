"""Where each traverse began and ended: from and to, or the ends of the joint's range."""

from __future__ import annotations

import numpy as np

from stickslip_fit.logs.cells import Cells
from stickslip_fit.logs.faults import Message
from stickslip_fit.logs.parse import Bools, Floats, Ints
from stickslip_fit.machine import JOINTS, PRISMATIC, Machine
from stickslip_fit.units import from_si

# Share of a joint's range by which a value may miss its end, for what unit conversion rounds off.
ROUNDING = 1e-9
_JOINTS_OF = {"angle": (1, 2), "length": (PRISMATIC,)}
_UNIT_OF = {"angle": "deg", "length": "mm"}


def read_traverses(cells: Cells, machine: Machine, joint: Ints, forward: Ints) -> tuple[Floats, Floats]:
    """Read from and to, and tell of traverses that cannot be.

    Parameters
    ----------
    cells : Cells
    machine : Machine
        An empty cell takes the end of its range.
    joint : array of int, shape (n,)
        0 where unknown.
    forward : array of int, shape (n,)
        1 for `+`, -1 for `-`, 0 where unknown.

    Returns
    -------
    start, stop : array, shape (n,)
        rad or m; NaN where unknown.
    """
    low, high = (np.array([np.nan, *ends]) for ends in zip(*map(machine.ranges.get, JOINTS), strict=True))
    unknown = np.full_like(low, np.nan)
    # One row of ends for -, unknown and +, side by side, so that each traverse looks up its own.
    place = (forward + 1) * len(low) + joint
    start = _end(cells, machine, joint, "from", np.concatenate([high, unknown, low])[place])
    stop = _end(cells, machine, joint, "to", np.concatenate([low, unknown, high])[place])
    _complain_about_length(cells, machine, joint, forward, start, stop)
    return start, stop


def complain_outside(cells: Cells, machine: Machine, field: str, joint: int, values: Floats) -> None:
    """Tell of positions beyond the joint's stops."""
    low, high = machine.ranges[joint]
    slack = ROUNDING * (high - low)
    if not cells.has(field):
        return
    unit = cells.layout.known[field].unit
    limits = f"{from_si(low, unit):g} to {from_si(high, unit):g} {unit}"
    message = f"is outside joint {joint}'s range, {limits}; correct it, or the range in the machine file"
    cells.complain(field, (values < low - slack) | (values > high + slack), message)


def _end(cells: Cells, machine: Machine, joint: Ints, stem: str, default: Floats) -> Floats:
    values = default
    for kind, joints in _JOINTS_OF.items():
        field = f"{stem}_{kind}"
        if not cells.has(field):
            continue
        mine, filled = _moves(joint, kind), cells.filled(field)
        foreign = ~mine & (joint > 0)
        cells.complain(field, foreign & filled, _wrong_kind(joint, stem))
        given = cells.numbers(field, ignored=foreign)
        for each in joints:
            complain_outside(cells, machine, field, each, np.where(joint == each, given, np.nan))
        values = np.where(mine & filled, given, values)
    return values


def _wrong_kind(joint: Ints, stem: str) -> Message:
    def message(row: int, value: str) -> str:
        if joint[row] == PRISMATIC:
            return f"is an angle, but joint 3 is prismatic; write {stem}_mm, and leave this cell empty"
        return f"is a length, but joint {joint[row]} is rotary; write {stem}_deg, and leave this cell empty"

    return message


def _complain_about_length(
    cells: Cells, machine: Machine, joint: Ints, forward: Ints, start: Floats, stop: Floats
) -> None:
    span = np.array([np.nan, *(machine.span(each) for each in JOINTS)])
    for kind in _JOINTS_OF:
        ends = _written_ends(cells, kind)
        if not ends:
            continue
        mine, ended = _moves(joint, kind), cells.filled(f"to_{kind}")
        length = stop - start
        # What is NaN is neither still nor astray: it has been told of already.
        still = mine & (np.abs(length) <= ROUNDING * span[joint])
        nowhere = f"makes a traverse of no length ({ends}); leave both empty for the full range"
        cells.complain(f"to_{kind}", still & ended, nowhere)
        cells.complain(f"from_{kind}", still & ~ended, nowhere)
        cells.complain("direction", mine & ~still & (forward * length < 0), _astray(kind, ends, start, stop))


def _moves(joint: Ints, kind: str) -> Bools:
    """Where the joint that moves is of this kind."""
    return joint == PRISMATIC if kind == "length" else (joint > 0) & (joint != PRISMATIC)


def _astray(kind: str, ends: str, start: Floats, stop: Floats) -> Message:
    unit = _UNIT_OF[kind]

    def message(row: int, value: str) -> str:
        first, last = (from_si(float(end[row]), unit) for end in (start, stop))
        return f"disagrees with {ends}: {first:g} to {last:g} {unit}; correct the one or the other"

    return message


def _written_ends(cells: Cells, kind: str) -> str:
    ends = [f"{end}_{kind}" for end in ("from", "to")]
    return " and ".join(cells.layout.known[end].name for end in ends if cells.has(end))
