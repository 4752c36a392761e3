"""Causes that change friction, as they act under a physical law.

The published laws do not know friction, so that such a cause multiplies the step size. Under a physical law
(`laws.physical`) friction times f leaves its own trace in each regime. Friction-limited, the step without
load goes with f and its response to load stays. Velocity-limited, the response to load goes with 1 / f^2 and
the step without load stays, to first order in r^2.
"""

from __future__ import annotations

import numpy as np

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.base import Cause, FactorCause, StateCause
from stickslip_fit.laws import State, StepLaw
from stickslip_fit.laws.physical import Physical, Ratios

_OWN = (
    *("name", "phrase", "physics", "shows_best", "joints", "kind", "session", "columns", "parameters"),
    *("null_values", "scale", "max_panel", "varies_along_traverse", "affects_stop_only"),
)


class FrictionEffect(StateCause, FactorCause):
    """A cause whose factor multiplies friction instead of the step.

    Parameters
    ----------
    cause : FactorCause
    ratios : tuple of float
        lambda of the law in `+` and in `-`.
    """

    def __init__(self, cause: FactorCause, ratios: Ratios) -> None:
        self.cause = cause
        self.ratios = ratios
        for name in _OWN:
            setattr(self, name, getattr(cause, name))

    def _is_limited(self, state: State) -> BoolArray:
        return np.asarray(np.where(state.direction_sign > 0, *self.ratios) > 1.0)

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`: the load as a share of friction."""
        factor = self.cause.factor(state, values)
        return state.with_changes(
            override_load=state.load / np.where(self._is_limited(state), factor, factor**2)
        )

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return np.where(self._is_limited(state), self.cause.factor(state, values), 1.0)


def friction_effect(cause: FactorCause, law: StepLaw) -> Cause:
    """The cause as it acts under a law: on friction, where the law knows it."""
    return FrictionEffect(cause, law.ratios) if isinstance(law, Physical) else cause
