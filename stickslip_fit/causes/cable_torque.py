"""A cable pulls like a spring."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, CauseParameter, TermCause
from stickslip_fit.laws import State
from stickslip_fit.machine import Machine


@dataclass(frozen=True)
class CableTorque(TermCause):
    """Rotary: gamma plus k (q - middle of range), sign opposite in the two directions.

    Attributes
    ----------
    middle : tuple of (int, float)
        Of the ranges of joints 1 and 2, rad.
    """

    middle: tuple[tuple[int, float], ...] = field(default=((1, 0.0), (2, -np.pi / 2)))

    name = "cable-torque"
    phrase = "a cable pulls on a rotary joint like a spring"
    physics = (
        "The cable to the joints further out twists as a joint turns and pulls it back towards the middle "
        "of its range: with the motion in one direction, against it in the other."
    )
    shows_best = "a rotary joint over short stretches at both ends of its range, in both directions"
    joints = (1, 2)
    parameters = (CauseParameter("k", "µrad/deg", "change of the step size per degree"),)
    absent = (0.0,)
    scale = (0.01e-6 * 180 / np.pi,)
    along = True

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        return replace(self, middle=tuple((joint, sum(machine.ranges[joint]) / 2) for joint in self.joints))

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([0.1e-6 * 180 / np.pi]),)

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        """See `TermCause.term`."""
        return state.way * values[0] * (state.position - dict(self.middle)[state.joint])
