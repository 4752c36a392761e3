"""Ambient temperature."""

from __future__ import annotations

from dataclasses import dataclass

from stickslip_fit.causes.cause import CauseParameter
from stickslip_fit.causes.of_column import OfColumn


@dataclass(frozen=True)
class Temperature(OfColumn):
    """gamma times 1 + k (x - mean x), x the ambient temperature."""

    name = "temperature"
    phrase = "steps follow the room's temperature"
    physics = (
        "The charge coefficient of PZT rises with temperature, by a few tenths of a per cent per kelvin "
        "about room temperature, and the friction of the guides changes too, so that a warmer room makes "
        "other steps (D. A. Hall, J. Mater. Sci. 36:4575, 2001)."
    )
    shows_best = "the same traverse in a cold and in a warm room"
    column = "temperature"
    columns = ("temperature",)
    called = "ambient temperature"
    parameters = (CauseParameter("k", "%/K", "change of the step size per kelvin"),)
    most = 0.02
