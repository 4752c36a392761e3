"""The drive heats up as a session runs, then settles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, FactorCause
from stickslip_fit.laws import State

TIMES = 60.0 * np.array([2.0, 4.0, 7.0, 12.0, 20.0, 35.0, 60.0])


@dataclass(frozen=True)
class ThermalWarmUp(FactorCause):
    """gamma times 1 + A (1 - exp(-t / tau)), t from the session's first traverse."""

    name = "thermal-warm-up"
    phrase = "the drive warms up"
    physics = (
        "Each step dissipates part of the piezo's electrical energy as heat, by its dielectric loss and by "
        "friction. The drive warms towards a balance with its surroundings, exponentially with the time "
        "constant of its heat capacity, and the piezo's stroke grows with temperature on the way."
    )
    shows_best = "one configuration, again and again from a session's first minute on"
    columns = ("session_seconds",)
    parameters = (
        CauseParameter("A", "%", "change of the step size once warm"),
        CauseParameter("tau", "min", "time constant of warming up", lower=30.0, upper=3 * 3600.0),
    )
    absent = (0.0, 600.0)
    scale = (0.01, 600.0)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(self, np.column_stack([np.full(len(TIMES), 0.01), TIMES]))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return tuple(np.array([0.1, tau]) for tau in TIMES)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        size, tau = values
        return 1.0 - size * np.expm1(-state.column("session_seconds") / tau)
