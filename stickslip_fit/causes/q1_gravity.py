"""The law ignores q1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, CauseParameter, StateCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class Q1Gravity(StateCause):
    """u is (1 - k) times the published load plus k times the full one; physics says k = 1."""

    name = "q1-gravity"
    phrase = "gravity acts differently where joint 1 is turned"
    physics = (
        "The published loads of joints 2 and 3 hold at q1 = 0. With joint 1 turned, the arm's plane is "
        "another, and gravity's components in it are those of A.112 and A.113 (A. Damani, 2013)."
    )
    shows_best = "joint 3 or 2 at q1 = 90 degrees with theta away from 0"
    joints = (2, 3)
    parameters = (CauseParameter("k", "1", "share of the full load; 1 by physics"),)
    absent = (0.0,)
    scale = (0.5,)
    turn = 2

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        mine = rows[rows["joint"].isin(self.joints)]
        if len(mine) and not mine["q1"].fillna(0.0).any():
            return "every traverse of joints 2 and 3 was made at q1 = 0"
        return super().missing(rows)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([1.0]),)

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`."""
        return state.but(given_load=(1.0 - values[0]) * state.load + values[0] * state.full_load)
