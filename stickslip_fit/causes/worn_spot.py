"""One short worn stretch of guide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.along_guide import AlongGuide
from stickslip_fit.causes.cause import Array, Cause, CauseParameter

WIDTHS = (0.3e-3, 1e-3, 2.5e-3)  # m
NARROWEST = 0.1e-3
PANEL = 4  # widths of a spot that a panel may span


@dataclass(frozen=True)
class WornSpot(AlongGuide):
    """Prismatic: gamma times 1 + A exp(-((q3 - x0) / w)^2 / 2)."""

    name = "worn-spot"
    phrase = "the guide has a worn spot"
    physics = (
        "Where a joint is used most, over a short stretch, its guide wears first, and the step size is "
        "another there. A traverse of the whole guide always crosses it and cannot tell."
    )
    shows_best = "joint 3 over short stretches, one after the other, along the guide"
    parameters = (
        CauseParameter("A", "%", "change of the step size at its middle", lower=-0.95),
        CauseParameter("x0", "mm", "its middle", lower=0.0, upper=12e-3),
        CauseParameter("w", "mm", "its width", lower=NARROWEST, upper=6e-3),
    )
    absent = (0.0, 6e-3, 1e-3)
    scale = (0.05, 1e-3, 1e-3)
    widest = PANEL * NARROWEST

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: spots of three widths, side by side along the guide."""
        ends = rows.loc[rows["joint"] == 3, ["start", "stop"]].to_numpy(float)
        spots = [
            (0.05, x0, width)
            for width in WIDTHS
            for x0 in np.arange(ends.min() + width / 2, ends.max(), width)
        ]
        return [(self, np.array(spots))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return tuple(np.array([0.5, x0, 1e-3]) for x0 in (2e-3, 4e-3, 6e-3, 8e-3, 10e-3))

    def panel(self, values: Array) -> float:
        """See `Cause.panel`."""
        return PANEL * max(float(values[:, 2].min()), NARROWEST)

    def profile(self, position: Array, values: list[Array]) -> Array:
        """See `AlongGuide.profile`."""
        size, middle, width = values
        return 1.0 + size * np.exp(-0.5 * ((position - middle) / width) ** 2)
