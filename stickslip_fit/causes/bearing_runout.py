"""The bearing is eccentric."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, FactorCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class BearingRunout(FactorCause):
    """Rotary: gamma times 1 + A cos(q - phi), also without gravity."""

    name = "bearing-runout"
    phrase = "a bearing is eccentric"
    physics = (
        "An eccentric bearing presses its sliding surfaces together more on one side than on the other, so "
        "that friction and step size vary once per turn. It looks like gravity, but it turns with the joint "
        "and is there with the base on its side, too."
    )
    shows_best = "a rotary joint over stretches of 60 degrees with the base on its side"
    joints = (1, 2)
    parameters = (
        CauseParameter("A", "%", "amplitude of the step size over a turn"),
        CauseParameter("phi", "deg", "where the step size is greatest"),
    )
    absent = (0.0, 0.0)
    scale = (0.01, 0.5)
    along = True

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(self, np.column_stack([np.full(4, 0.01), np.radians([0.0, 45.0, 90.0, 135.0])]))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return np.array([0.1, 0.0]), np.array([0.1, np.pi / 2])

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return 1.0 + values[0] * np.cos(state.position - values[1])
