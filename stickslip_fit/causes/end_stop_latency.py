"""The stop is heard late, or early."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit.causes.cause import Array, CauseParameter, CountCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class EndStopLatency(CountCause):
    """N plus L, whatever the traverse's length."""

    name = "end-stop-latency"
    phrase = "the end stop is heard a fixed number of steps late or early"
    physics = (
        "The sound of the stop has to rise above the motion's own before it is heard, and whoever listens "
        "takes time, while the drive goes on stepping. The steps lost so are the same for a short and a "
        "long traverse."
    )
    shows_best = "short partial traverses beside full ones"
    parameters = (CauseParameter("L", "steps", "steps counted after the stop was reached"),)
    absent = (0.0,)
    scale = (20.0,)
    of_stop = True

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([300.0]),)

    def steps(self, state: State, values: list[Array]) -> Array:
        """See `CountCause.steps`."""
        return values[0]
