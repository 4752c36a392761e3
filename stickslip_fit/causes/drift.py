"""Slow creep through a session that has not settled by its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit.causes.cause import Array, CauseParameter, FactorCause
from stickslip_fit.laws import State

HOUR = 3600.0


@dataclass(frozen=True)
class Drift(FactorCause):
    """gamma times 1 + k t, t from the session's first traverse."""

    name = "drift"
    phrase = "steps drift through each session"
    physics = (
        "Clamping forces relax, the piezo creeps and the room changes over hours, longer than a session "
        "lasts, so that over a session the step size changes in proportion to time."
    )
    shows_best = "one configuration at a session's beginning, middle and end"
    columns = ("session_seconds",)
    parameters = (CauseParameter("k", "%/h", "change of the step size per hour"),)
    absent = (0.0,)
    scale = (0.01 / HOUR,)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([0.1 / HOUR]),)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return 1.0 + values[0] * state.column("session_seconds")
