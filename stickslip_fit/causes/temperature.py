"""Ambient temperature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter
from stickslip_fit.causes.of_column import OfColumn
from stickslip_fit.laws import State
from stickslip_fit.machine import Machine

STRAIGHT = (CauseParameter("k", "%/K", "change of the step size per kelvin"),)
BEND = CauseParameter("bend", "1", "share of k gained at half the log's range above its mean", -1.0, 1.0)


@dataclass(frozen=True)
class Temperature(OfColumn):
    """gamma times 1 + k x, in its curved form 1 + k x (1 + bend x / half), with x = T - mean T.

    Attributes
    ----------
    form : {"straight", "curved"}
    half : float
        Half of the log's range of temperatures, K.
    """

    form: str = "straight"
    half: float = 1.0

    name = "temperature"
    phrase = "steps follow the room's temperature"
    physics = (
        "A piezo's stroke per volt depends on its temperature, and so does the friction of the guides, so "
        "that a warmer room makes other steps. Over a few kelvin both change about in proportion; over more, "
        "the response may bend gently."
    )
    shows_best = "the same traverse in a cold and in a warm room"
    column = "temperature"
    columns = ("temperature",)
    called = "ambient temperature"
    plausible = 0.02

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `Cause`."""
        return STRAIGHT if self.form == "straight" else (*STRAIGHT, BEND)

    @property
    def absent(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (0.0,) * len(self.parameters)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (self.plausible / 10, 0.5)[: len(self.parameters)]

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        return replace(super().bound(rows, machine), half=float(np.ptp(rows["temperature"].dropna()) / 2))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        straight, curved = replace(self, form="straight"), replace(self, form="curved")
        size = self.plausible / 10
        return [(straight, np.array([[size]])), (curved, np.array([[size, 0.5], [size, -0.5]]))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([self.plausible, 0.0])[: len(self.parameters)],)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        departure = self.departure(state)
        bend = values[1] if self.form == "curved" else 0.0
        return 1.0 + values[0] * departure * (1.0 + bend * departure / self.half)
