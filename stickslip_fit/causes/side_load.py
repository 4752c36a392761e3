"""Friction from the load across the axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit.causes.cause import Array, CauseParameter, FactorCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class SideLoad(FactorCause):
    """Joint 3: gamma times 1 - k sqrt(1 - u^2)."""

    name = "side-load"
    phrase = "the load across the guide costs step size"
    physics = (
        "What of the arm's weight does not act along the guide presses it against its bearing, sqrt(1 - "
        "u^2) of it, and friction grows with that force (Coulomb's law)."
    )
    shows_best = "joint 3 level and upright in orientations that have the same load along the axis"
    joints = (3,)
    parameters = (CauseParameter("k", "%", "share lost to the full load across the axis"),)
    absent = (0.0,)
    scale = (0.02,)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([0.2]),)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return 1.0 - values[0] * np.sqrt(np.maximum(1.0 - state.load**2, 0.0))
