"""How fast the steps follow one another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, CauseParameter, FactorCause, filled, missing_column
from stickslip_fit.laws import State
from stickslip_fit.machine import Machine


@dataclass(frozen=True)
class StepRate(FactorCause):
    """gamma times 1 + k log(period / median period).

    Attributes
    ----------
    median : float
        Step period, s.
    """

    median: float = 1.0

    name = "step-rate"
    phrase = "steps follow the step period"
    physics = (
        "A joint still rings from one step when the next begins, and friction depends on how long the "
        "surfaces have been at rest, so that the period between steps changes how far each slips."
    )
    shows_best = "the same traverse at the shortest and at the longest step period"
    columns = ("step_period",)
    parameters = (CauseParameter("k", "%", "change of the step size per e-fold of the step period"),)
    absent = (0.0,)
    scale = (0.02,)

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        return replace(self, median=float(np.nanmedian(rows["step_period"].to_numpy(float))))

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        return missing_column(rows, "step_period", "step period")

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([0.2]),)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return 1.0 + values[0] * np.log(filled(state.column("step_period"), self.median) / self.median)
