"""The friction surfaces change with use, across sessions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, FactorCause
from stickslip_fit.laws import State

SCALES = np.array([1e4, 1e5, 1e6])


@dataclass(frozen=True)
class Wear(FactorCause):
    """gamma times 1 + k log(1 + n / n0), n the joint's own logged steps so far, not reset by a session."""

    name = "wear"
    phrase = "the joints wear"
    physics = (
        "What the sliding surfaces lose grows with the way slid (J. F. Archard, J. Appl. Phys. 24:981, "
        "1953). Fresh ones change fast, worn-in ones ever more slowly, so that the step size follows about "
        "the logarithm of the steps made. It goes on from session to session, and a calibration at a "
        "session's beginning ages as the session goes on."
    )
    shows_best = "one configuration before and after as many steps as the joint has made so far"
    columns = ("steps_before",)
    parameters = (
        CauseParameter("k", "%", "change of the step size per e-fold of steps"),
        CauseParameter("n0", "steps", "steps after which wear has slowed down", lower=1e3, upper=1e7),
    )
    absent = (0.0, 1e5)
    scale = (0.005, 1e5)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(self, np.column_stack([np.full(len(SCALES), 0.005), SCALES]))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return tuple(np.array([0.05, scale]) for scale in SCALES)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        size, scale = values
        return 1.0 + size * np.log1p(state.column("steps_before") / scale)
