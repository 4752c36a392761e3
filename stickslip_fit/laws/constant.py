"""The constant step: what a lab assumes before it calibrates (thesis Ch. 7)."""

from __future__ import annotations

import numpy as np

from stickslip_fit.laws.law import Array, Counter, Rows, StepLaw, column, travel
from stickslip_fit.laws.parameter import Configuration, Parameter
from stickslip_fit.laws.state import State
from stickslip_fit.machine import PRISMATIC


class ConstantStep(StepLaw):
    """One step size for every configuration.

    Parameters
    ----------
    joint : {1, 2, 3}
    measured_in : Configuration
        Where the one step size is measured.
    """

    name = "constant"

    def __init__(self, joint: int, measured_in: Configuration) -> None:
        self.joint = joint
        self.measured_in = measured_in
        unit = "nm" if joint == PRISMATIC else "µrad"
        self.parameters = (Parameter("gamma", unit, "step size everywhere", lower=0.0),)

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""
        return values[:, :1]

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`."""
        return np.ones((len(values), 1, 1))

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        return mean_step[:, None]

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return mean_step[:, None]

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: nothing matters."""
        return np.zeros((len(column(rows, "start")), 0))

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`."""
        return (self.measured_in,)

    def counter(self, rows: Rows) -> Counter:
        """Closed form of `StepLaw.counter`."""
        length = travel(rows)

        def count(values: Array) -> tuple[Array, Array]:
            gamma = np.broadcast_to(values, (len(length), 1))[:, 0]
            counts = length / gamma
            return counts, (-counts / gamma)[:, None]

        return count
