"""The loss does not follow |cos q2|."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, StateCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class RecoilShape(StateCause):
    """Recoil is |cos q2|^p."""

    name = "recoil-shape"
    phrase = "recoil does not follow the cosine of q2"
    physics = (
        "That recoil goes with |cos q2| supposes a stiffness that does not depend on how far the joint is "
        "pushed back. Preloaded bearings are stiffer under larger forces, which makes the loss fall off "
        "faster or slower than the cosine on the way from upright to level."
    )
    shows_best = "joint 3 half-way between upright and level, q2 = -45 and -60 degrees"
    joints = (3,)
    parameters = (CauseParameter("p", "1", "exponent; 1 in the published law", 0.1, 6.0),)
    absent = (1.0,)
    scale = (0.2,)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(self, np.array([[0.6], [0.85], [1.2], [1.8]]))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return np.array([0.5]), np.array([2.0])

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`."""
        return state.but(given_recoil=state.recoil ** values[0])
