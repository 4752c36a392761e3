"""Configurations that a lab can set: arm and base in steps that a hand finds, whole ranges and stretches."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit.machine import Machine

TURNED = np.radians([-90.0, -60.0, -30.0, 30.0, 60.0, 90.0])
# The base lies flat, or is turned about one of its axes.
BASES = [(0.0, 0.0), *((angle, 0.0) for angle in TURNED), *((0.0, angle) for angle in TURNED)]
ON_SIDE = [(0.0, 0.0), (-np.pi / 2, 0.0)]
TURNS = np.radians([0.0, 90.0])  # of joint 1 under joints 2 and 3
ANGLES = np.radians(np.arange(-180.0, 181.0, 30.0))
PARTS = np.linspace(0.0, 1.0, 5)  # of joint 3's range
STRETCHES = {1: (4,), 2: (4,), 3: (2, 3, 12)}  # into how many a range may be cut


def places_ahead(law: Any, direction: str, machine: Machine) -> pd.DataFrame:
    """Whole traverses in every configuration, and stretches of the range in a few.

    Parameters
    ----------
    law : StepLaw
    direction : {'+', '-'}
    machine : Machine

    Returns
    -------
    DataFrame
        joint, direction, q1 to psi (NaN for the moving joint's own), start, stop.
    """
    joint = law.joint
    low, high = machine.ranges[joint]
    whole = [(*place, low, high) for place in product(_arms(law, machine), BASES)]
    cuts = [np.linspace(low, high, number + 1) for number in STRETCHES[joint]]
    pieces = [
        (arm, base, first, last)
        for arm, base, ends in product(_arms(law, machine)[:1], ON_SIDE, cuts)
        for first, last in pairwise(ends)
    ]
    rows = pd.DataFrame(
        [(*arm, *base, first, last) for arm, base, first, last in [*whole, *pieces]],
        columns=["q1", "q2", "q3", "theta", "psi", "start", "stop"],
    )
    if direction == "-":
        rows[["start", "stop"]] = rows[["stop", "start"]].to_numpy()
    return rows.assign(joint=joint, direction=direction)


def _arms(law: Any, machine: Machine) -> list[tuple[float, float, float]]:
    """Where the other two joints may stand, as (q1, q2, q3); first where the arm is level or half out."""
    unset = np.nan
    if law.joint == 1:
        # Elsewhere the law of a log with one reach says nothing.
        return list(dict.fromkeys((unset, each.q2, each.q3) for each in law.calibration()))
    turns = [angle for angle in TURNS if _within(machine, 1, angle)]
    if law.joint == 2:
        near, far = machine.ranges[3]
        outs = near + (far - near) * PARTS[[2, 0, 1, 3, 4]]
        return [(turn, unset, float(out)) for turn, out in product(turns, outs)]
    level = -np.pi / 2
    angles = [level, *(angle for angle in ANGLES if angle != level)]
    return [
        (turn, float(angle), unset) for turn, angle in product(turns, angles) if _within(machine, 2, angle)
    ]


def _within(machine: Machine, joint: int, position: float) -> bool:
    low, high = machine.ranges[joint]
    return bool(low - 1e-9 <= position <= high + 1e-9)
