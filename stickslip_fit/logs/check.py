"""The rules of one row: configuration, traverse, count, status and conditions."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from stickslip_fit.logs.cells import Cells
from stickslip_fit.logs.columns import CHECK_EVERY, CONDITIONS
from stickslip_fit.logs.parse import Floats, Ints, labelled
from stickslip_fit.logs.together import together
from stickslip_fit.logs.traverse import complain_outside, read_traverses
from stickslip_fit.machine import JOINTS, Machine

DIRECTIONS = ("+", "-")
STATUSES = ("ok", "interrupted", "excluded", "")


def check_rows(cells: Cells, machine: Machine, joint: Ints, steps: Ints) -> pd.DataFrame:
    """Read what a file says of its rows beyond their identity, and tell of what breaks the rules.

    Parameters
    ----------
    cells : Cells
    machine : Machine
        Its ranges bound every position, and end the traverses that say nothing else.
    joint, steps : array of int, shape (n,)
        Read already; 0 where faulty.

    Returns
    -------
    DataFrame
        The Log's columns but identity, history and the lab's own, in the file's order.
    """
    direction = cells.choices("direction", DIRECTIONS, "is no direction; write + or -")
    forward = np.array([1, -1, 0])[direction]
    columns = together(
        {
            "direction": lambda: labelled(direction, DIRECTIONS),
            **{f"q{other}": partial(_position, cells, machine, joint, other) for other in JOINTS},
            "theta": lambda: cells.numbers("theta", needed=True),
            "psi": lambda: cells.numbers("psi", needed=True),
            "traverse": lambda: read_traverses(cells, machine, joint, forward),
            "check_every": lambda: _check_every(cells, steps),
            "status": lambda: _status(cells),
            **{name: partial(_condition, cells, name) for name in CONDITIONS},
            "note": lambda: cells.texts("note").to_pandas(),
        }
    )
    columns["start"], columns["stop"] = columns.pop("traverse")
    return pd.DataFrame(columns, copy=False)


def _position(cells: Cells, machine: Machine, joint: Ints, other: int) -> Floats:
    """Where another joint stood; the moving joint's own cell is ignored, whatever it holds."""
    field = f"q{other}"
    position = cells.numbers(field, needed=joint > 0, ignored=joint == other)
    complain_outside(cells, machine, field, other, position)
    return position


def _check_every(cells: Cells, steps: Ints) -> Ints:
    given = cells.counts("check_every", "is no positive integer; write 5, or 1 where the count is exact")
    check_every = np.where(given > 0, given, CHECK_EVERY)
    # A faulty cell is no empty one: what 5 would say of its row is beside the point.
    known = (given > 0) | ~cells.filled("check_every")

    def message(row: int, value: str) -> str:
        return f"is no multiple of check_every, {check_every[row]}; correct the one or the other"

    cells.complain("steps", known & (steps % check_every != 0), message)
    return check_every


def _status(cells: Cells) -> pd.Series:
    """Read the status; an empty cell is ok."""
    if not cells.has("status"):
        return labelled(np.zeros(cells.table.count, np.int8), STATUSES)
    status = cells.choices("status", STATUSES, "is no status; write ok, interrupted or excluded")
    return labelled(np.where(status == STATUSES.index(""), 0, status), STATUSES)


def _condition(cells: Cells, name: str) -> Floats:
    values = cells.numbers(name)
    if fault := CONDITIONS[name].fault:
        cells.complain(name, values <= 0, fault)
    return values
