"""Laws of the prismatic joint (thesis Eq. 4.5): gamma3 = (1 - b |cos q2|) (a - c cos zeta cos theta).

a is the step size without gravity and recoil, b the recoil of the arm, c the gravity load coefficient.
ConstantStep, one step size for every configuration, is the model that labs use without calibration (Ch.
7).
"""

from __future__ import annotations

from math import radians

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.laws.base import (
    Configuration,
    Counter,
    Parameter,
    Rows,
    StepLaw,
    float_column,
    traverse_length,
)
from stickslip_fit.laws.integration import State
from stickslip_fit.machine import published_load
from stickslip_fit.units import PRISMATIC


class Prismatic(StepLaw):
    """Step size of joint 3: a without gravity and recoil, less the arm's recoil b and the load c.

    The step size does not change along the guide, so the steps over a traverse are its length over
    the step size.
    """

    name = "prismatic"
    joint = PRISMATIC
    columns = ("q2", "theta", "psi")
    parameters = (
        Parameter("a", "nm", "step size without gravity and recoil", lower=0.0),
        Parameter("b", "1", "share lost to recoil with the arm upright", lower=-1.0, upper=1.0),
        Parameter("c", "nm", "step size lost to the full load"),
    )

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""
        kept, net = _recoil_and_load_factors(state.recoil, state.load, values[:, None, :])
        return kept * net

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`."""
        kept, net = _recoil_and_load_factors(state.recoil, state.load, values[:, None, :])
        return np.stack(np.broadcast_arrays(kept, -state.recoil * net, -kept * state.load), axis=-1)

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        return np.stack([1.2 * mean_step, np.full_like(mean_step, 0.2), np.zeros_like(mean_step)], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return np.stack([mean_step, np.ones_like(mean_step), mean_step], axis=-1)

    def features(self, rows: Rows) -> Array:
        """Recoil |cos q2| and load; see `StepLaw.features`."""
        q2, theta, psi = (float_column(rows, name) for name in ("q2", "theta", "psi"))
        return np.stack([np.abs(np.cos(q2)), published_load(PRISMATIC, 0.0, q2, theta, psi)], axis=-1)

    def calibration(self) -> tuple[Configuration, ...]:
        """The three configurations of thesis Eqs. 6.2 to 6.4: a, then b, then c."""
        level = radians(-90.0)
        return (
            Configuration("arm level: no load along it, no recoil", q2=level),
            Configuration("arm upright, base on its side: recoil without load", q2=0.0, theta=level),
            Configuration("arm upright: recoil and full load", q2=0.0),
        )

    def counter(self, rows: Rows) -> Counter:
        """Closed form of `StepLaw.counter`; NaN where the step size is not above 0."""
        length, (recoil, load) = traverse_length(rows), self.features(rows).T

        def count(values: Array) -> tuple[Array, Array]:
            kept, net = _recoil_and_load_factors(recoil, load, values)
            with np.errstate(divide="ignore", invalid="ignore"):
                counts = np.where((kept > 0) & (net > 0), length / (kept * net), np.nan)
                slopes = np.stack([-counts / net, counts * recoil / kept, counts * load / net], axis=-1)
            return counts, slopes

        return count


def _recoil_and_load_factors(recoil: Array, load: Array, values: Array) -> tuple[Array, Array]:
    """What recoil leaves, 1 - b recoil, and what load leaves, a - c load; values' last axis is a, b, c."""
    return 1.0 - values[..., 1] * recoil, values[..., 0] - values[..., 2] * load


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
        return np.zeros((len(float_column(rows, "start")), 0))

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`."""
        return (self.measured_in,)

    def counter(self, rows: Rows) -> Counter:
        """Closed form of `StepLaw.counter`."""
        length = traverse_length(rows)

        def count(values: Array) -> tuple[Array, Array]:
            gamma = np.broadcast_to(values, (len(length), 1))[:, 0]
            counts = length / gamma
            return counts, (-counts / gamma)[:, None]

        return count
