"""The previous traverse's load is remembered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stickslip_fit.causes.cause import Array, CauseParameter, FactorCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class LoadHysteresis(FactorCause):
    """gamma times 1 + k u_before, the mean load of the joint's previous traverse in the session."""

    name = "load-hysteresis"
    phrase = "a joint remembers the load of its previous traverse"
    physics = (
        "Piezoceramics and preloaded contacts creep under load and take time to forget it, so that a "
        "traverse begins in a state that the previous one left behind (H. Jung and D.-G. Gweon, Rev. Sci. "
        "Instrum. 71:1896, 2000, on creep)."
    )
    shows_best = "one configuration after a lifting and after a lowering traverse"
    columns = ("before_load",)
    parameters = (CauseParameter("k", "%", "change of the step size after a traverse under full load"),)
    absent = (0.0,)
    scale = (0.01,)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([0.1]),)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return 1.0 + values[0] * state.column("before_load")
