"""The base plate is tilted about x."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, StateCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class ThetaOffset(StateCause):
    """theta is theta + delta."""

    name = "theta-offset"
    phrase = "the base is tilted about x"
    physics = (
        "theta is set by hand or read off a stage; a plate that does not lie flat adds the same angle to "
        "every setting, and gravity acts along another direction than the law believes."
    )
    shows_best = "traverses on both sides of theta = 0, where the load changes most with theta"
    parameters = (CauseParameter("delta", "deg", "tilt of the base plate about x"),)
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
        return state.but(theta=state.theta + values[0])
