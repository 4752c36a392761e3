"""The most compliant direction is not where the law has it."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, StateCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class RecoilAxis(StateCause):
    """Recoil is |cos(q2 - phi)|."""

    name = "recoil-axis"
    phrase = "the arm recoils most in another direction than the law has it"
    physics = (
        "Each step pushes back on the joint that carries the arm. How much of the step that costs depends "
        "on how compliant the joint is in the arm's direction, and the most compliant direction need not be "
        "the upright one: it follows the shape of the bearing's frame."
    )
    shows_best = "joint 3 at q2 = -45 and -135 degrees"
    joints = (3,)
    parameters = (CauseParameter("phi", "deg", "most compliant direction", -np.pi / 4, np.pi / 4),)
    absent = (0.0,)
    scale = (radians(2.0),)
    turn = 2

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: both signs, since |cos| has no derivative where it is 0."""
        return [(self, np.radians([[2.0], [-2.0], [6.0], [-6.0], [15.0], [-15.0]]))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return tuple(np.radians([[15.0], [-15.0]]))

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`."""
        return state.but(given_recoil=np.abs(np.cos(state.q2 - values[0])))
