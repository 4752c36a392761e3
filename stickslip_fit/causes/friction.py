"""Causes that change the stage, as they act under a physical law.

The published laws do not know friction, so that such a cause multiplies the step size. Under a physical law
(`laws.physical`) each change of the stage leaves its own trace in each regime, to first order in r^2:

====================  =========================  ==========================
times f               friction-limited           velocity-limited
====================  =========================  ==========================
friction              the step f, the load 1/f   the load 1/f^2
voltage               nothing                    the step f, the load f
ramp time             the step f^2               the load 1/f^2
====================  =========================  ==========================
"""

from __future__ import annotations

from collections.abc import Iterable
from types import MappingProxyType

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause, FactorCause, StateCause
from stickslip_fit.laws import State, StepLaw
from stickslip_fit.laws.physical import Physical, Ratios

STEP, FRICTION, VOLTAGE, RAMP_TIME = "step", "friction", "voltage", "ramp time"
POWERS = MappingProxyType(  # of f, on the step and on the load: friction-limited, then velocity-limited
    {
        FRICTION: ((1, -1), (0, -2)),
        VOLTAGE: ((0, 0), (1, 1)),
        RAMP_TIME: ((2, 0), (0, -2)),
    }
)
_OWN = (
    *("name", "phrase", "physics", "shows_best", "joints", "kind", "session", "columns", "parameters"),
    *("null_values", "scale", "max_panel", "varies_along_traverse", "affects_stop_only"),
)


class StageEffect(StateCause, FactorCause):
    """A cause whose factor multiplies a quantity of the stage instead of the step.

    Parameters
    ----------
    cause : FactorCause
    ratios : tuple of float
        lambda of the law in `+` and in `-`.
    quantity : {"friction", "voltage", "ramp time"}
    """

    def __init__(self, cause: FactorCause, ratios: Ratios, quantity: str = FRICTION) -> None:
        self.cause = cause
        self.ratios = ratios
        self.quantity = quantity
        for name in _OWN:
            setattr(self, name, getattr(cause, name))

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`: the load as a share of friction."""
        factor = self.cause.factor(state, values)
        return state.with_changes(override_load=state.load * factor ** self._powers(state)[1])

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return np.asarray(self.cause.factor(state, values) ** self._powers(state)[0])

    def _powers(self, state: State) -> Array:
        """Of the factor, on the step and on the load, each of the shape of the direction's sign."""
        limited, other = np.array(POWERS[self.quantity], dtype=float)
        is_limited = np.where(state.direction_sign > 0, *self.ratios) > 1.0
        return np.stack([np.where(is_limited, *pair) for pair in zip(limited, other, strict=True)])


def stage_effect(cause: FactorCause, law: StepLaw, quantity: str = FRICTION) -> Cause:
    """The cause as it acts under a law: on a quantity of the stage, where the law knows it."""
    if quantity == STEP or not isinstance(law, Physical):
        return cause
    return StageEffect(cause, law.ratios, quantity)


def distinct_quantities(laws: Iterable[StepLaw]) -> tuple[str, ...]:
    """The step size, and what changes of the stage leave a trace of their own under these laws."""
    limited = {ratio > 1.0 for law in laws if isinstance(law, Physical) for ratio in law.ratios}
    if not limited:
        return (STEP,)
    voltage, ramp_time = (VOLTAGE,) * (False in limited), (RAMP_TIME,) * (len(limited) > 1)
    return (STEP, FRICTION, *voltage, *ramp_time)
