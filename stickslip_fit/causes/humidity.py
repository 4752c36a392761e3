"""Relative humidity."""

from __future__ import annotations

from dataclasses import dataclass

from stickslip_fit.causes.cause import CauseParameter
from stickslip_fit.causes.of_column import OfColumn


@dataclass(frozen=True)
class Humidity(OfColumn):
    """gamma times 1 + k (x - mean x), x the relative humidity."""

    name = "humidity"
    phrase = "steps follow the humidity"
    physics = (
        "Water adsorbed from the air changes the friction between ceramic and steel, and with it how far a "
        "joint slips in each step (B. Bhushan, Introduction to Tribology, 2nd ed., Wiley, 2013)."
    )
    shows_best = "the same traverse in dry and in humid air"
    column = "humidity"
    columns = ("humidity",)
    called = "relative humidity"
    parameters = (CauseParameter("k", "%/%", "change of the step size per per cent of relative humidity"),)
    plausible = 0.5
