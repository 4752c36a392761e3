"""Preload varies along the guide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, CauseParameter, FactorCause
from stickslip_fit.laws import State

MIDDLE = 0.006  # m


@dataclass(frozen=True)
class GuideGradient(FactorCause):
    """Prismatic: gamma times 1 + k (q3 - 6 mm)."""

    name = "guide-gradient"
    phrase = "the guide's preload varies along its length"
    physics = (
        "Two guide rails that are not parallel press on the slider more at one end than at the other, so "
        "that friction and step size change along the guide."
    )
    shows_best = "joint 3 over the first and over the last third of its range"
    joints = (3,)
    columns = ("q1", "q2", "q3", "theta", "psi")
    parameters = (CauseParameter("k", "%/mm", "change of the step size per millimetre"),)
    absent = (0.0,)
    scale = (2.0,)
    along = True

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        return super().missing(rows) or whole_guide(rows)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([20.0]),)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return 1.0 + values[0] * (state.position - MIDDLE)


def whole_guide(rows: pd.DataFrame) -> str | None:
    """Why nothing can be said of places along the guide, or None."""
    mine = rows[rows["joint"] == 3]
    ends = np.sort(mine[["start", "stop"]].to_numpy(float), axis=1).round(7)
    return "every prismatic traverse runs the whole guide" if len(np.unique(ends, axis=0)) < 2 else None
