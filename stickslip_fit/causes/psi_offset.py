"""The base plate is tilted about y."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, StateCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class PsiOffset(StateCause):
    """psi is psi + delta, for gravity only."""

    name = "psi-offset"
    phrase = "the base is tilted about y"
    physics = (
        "As a tilt about x, but about y: gravity acts along another direction in the plane of the arm than "
        "the law believes, while recoil, which the arm's own angle decides, is what it was."
    )
    shows_best = "arm level, base level: where the load on joint 3 is 0 and changes most with psi"
    parameters = (CauseParameter("delta", "deg", "tilt of the base plate about y"),)
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
        return state.but(psi=state.psi + values[0])
