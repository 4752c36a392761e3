"""Supply voltage."""

from __future__ import annotations

from dataclasses import dataclass

from stickslip_fit.causes.cause import CauseParameter
from stickslip_fit.causes.of_column import OfColumn


@dataclass(frozen=True)
class SupplyVoltage(OfColumn):
    """gamma times 1 + k (x - mean x), x the supply voltage."""

    name = "supply-voltage"
    phrase = "steps follow the supply voltage"
    physics = (
        "The amplitude of the saw-tooth drive follows the supply, and a step is proportional to the "
        "amplitude less the part that friction takes up elastically."
    )
    shows_best = "the same traverse at two supply voltages"
    column = "supply"
    columns = ("supply",)
    called = "supply voltage"
    parameters = (CauseParameter("k", "%/V", "change of the step size per volt"),)
    plausible = 0.05
