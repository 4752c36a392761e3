"""The prismatic joint (thesis Eq. 4.5): gamma3 = (1 - b |cos q2|) (a - c cos zeta cos theta)."""

from __future__ import annotations

from math import radians

import numpy as np

from stickslip_fit.laws.law import Array, Counter, Rows, StepLaw, column, travel
from stickslip_fit.laws.parameter import Configuration, Parameter
from stickslip_fit.laws.state import State
from stickslip_fit.machine import PRISMATIC, published_load


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
        kept, net = _factors(state.recoil, state.load, values[:, None, :])
        return kept * net

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`."""
        kept, net = _factors(state.recoil, state.load, values[:, None, :])
        return np.stack(np.broadcast_arrays(kept, -state.recoil * net, -kept * state.load), axis=-1)

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        return np.stack([1.2 * mean_step, np.full_like(mean_step, 0.2), np.zeros_like(mean_step)], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return np.stack([mean_step, np.ones_like(mean_step), mean_step], axis=-1)

    def features(self, rows: Rows) -> Array:
        """Recoil |cos q2| and load; see `StepLaw.features`."""
        q2, theta, psi = (column(rows, name) for name in ("q2", "theta", "psi"))
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
        length, (recoil, load) = travel(rows), self.features(rows).T

        def count(values: Array) -> tuple[Array, Array]:
            kept, net = _factors(recoil, load, values)
            with np.errstate(divide="ignore", invalid="ignore"):
                counts = np.where((kept > 0) & (net > 0), length / (kept * net), np.nan)
                slopes = np.stack([-counts / net, counts * recoil / kept, counts * load / net], axis=-1)
            return counts, slopes

        return count


def _factors(recoil: Array, load: Array, values: Array) -> tuple[Array, Array]:
    """What recoil leaves, 1 - b recoil, and what load leaves, a - c load; values' last axis is a, b, c."""
    return 1.0 - values[..., 1] * recoil, values[..., 0] - values[..., 2] * load
