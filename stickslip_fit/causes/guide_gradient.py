"""Preload varies along the guide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit.causes.along_guide import AlongGuide
from stickslip_fit.causes.cause import Array, CauseParameter

MIDDLE = 0.006  # m


@dataclass(frozen=True)
class GuideGradient(AlongGuide):
    """Prismatic: gamma times 1 + k (q3 - 6 mm)."""

    name = "guide-gradient"
    phrase = "the guide's preload varies along its length"
    physics = (
        "Two guide rails that are not parallel press on the slider more at one end than at the other, so "
        "that friction and step size change along the guide."
    )
    shows_best = "joint 3 over the first and over the last third of its range"
    parameters = (CauseParameter("k", "%/mm", "change of the step size per millimetre"),)
    absent = (0.0,)
    scale = (2.0,)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([20.0]),)

    def profile(self, position: Array, values: list[Array]) -> Array:
        """See `AlongGuide.profile`."""
        return 1.0 + values[0] * (position - MIDDLE)
