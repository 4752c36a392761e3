"""Joint positions that a machine can take."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit._format import format_value
from stickslip_fit.errors import InputError
from stickslip_fit.machine import Machine

Array = npt.NDArray[np.float64]


def check_positions(machine: Machine, q: Array, name: str) -> None:
    """Refuse joint positions outside the machine's ranges.

    Raises
    ------
    InputError
        Naming the first such joint, with where it stands and its range.
    """
    for joint, (low, high) in machine.ranges.items():
        if not low - 1e-9 <= q[joint - 1] <= high + 1e-9:
            shown = [_shown(joint, value) for value in (q[joint - 1], low, high)]
            raise InputError(f"{name} q{joint} = {shown[0]} is outside its range, {shown[1]} to {shown[2]}")


def _shown(joint: int, value: float) -> str:
    return format_value(value, "mm" if joint == 3 else "deg", 2)
