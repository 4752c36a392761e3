"""Joint 2's zero is off."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, StateCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class Q2Offset(StateCause):
    """q2 is q2 + delta, for gravity, recoil and reach."""

    name = "q2-offset"
    phrase = "joint 2's zero is off"
    physics = (
        "Without a sensor, joint 2's angle is counted from an end stop whose place is known only so well. "
        "All of gravity, recoil and reach follow the true angle; how far a traverse goes between its stops "
        "does not."
    )
    shows_best = "joint 3 with the arm upright and level, in both orientations of the base"
    parameters = (CauseParameter("delta", "deg", "error of joint 2's zero"),)
    absent = (0.0,)
    scale = (radians(1.0),)
    turn = 1

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(self, np.radians([[1.0], [-1.0], [4.0], [-4.0]]))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return np.array([radians(10.0)]), np.array([radians(-10.0)])

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`."""
        return state.but(q2=state.q2 + values[0])
