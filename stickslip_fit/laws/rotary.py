"""Laws of the rotary joints (thesis Eq. 6.10): gamma = gamma0 + d u, linear in the arm's extension.

u is the gravity load. gamma0 and d are linear in q3 for joint 2 (Elbow), and in the reach rho = -(l2 +
q3) sin q2 for joint 1 (Base).
"""

from __future__ import annotations

from abc import abstractmethod
from math import pi, radians

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.laws.base import Configuration, Counter, Parameter, Rows, StepLaw, float_column
from stickslip_fit.laws.integration import State, harmonic_counts
from stickslip_fit.machine import Machine, published_load, reach


class Rotary(StepLaw):
    """gamma = sum of basis_k (gamma0_k + d_k u), with u = amplitude cos(q - phase) along the traverse.

    A subclass says what the basis is, how the load swings along a traverse, and what its 2 m
    parameters are called: first the gamma0_k, then the d_k.
    """

    @abstractmethod
    def weights(self, q2: Array, q3: Array) -> list[Array]:
        """Weight of each gamma0_k and d_k where joints 2 and 3 stand, m arrays of one shape."""

    @abstractmethod
    def swing(self, rows: Rows) -> tuple[Array, Array]:
        """Amplitude and phase of the load, u = amplitude cos(q - phase), each shape (n,)."""

    def basis(self, rows: Rows) -> Array:
        """Weights of each gamma0_k and d_k, shape (n, m)."""
        q2 = float_column(rows, "q2") if "q2" in self.columns else np.zeros(len(float_column(rows, "q3")))
        return np.stack(self.weights(q2, float_column(rows, "q3")), axis=-1)

    def coefficients(self, rows: Rows, values: Array) -> tuple[Array, Array]:
        """gamma0 and d of each row, rad, each shape (n,)."""
        return _weighted_sum(self.basis(rows), values)

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""
        weights = self.weights(state.q2, state.q3)
        gamma0 = sum(weight * values[:, k, None] for k, weight in enumerate(weights))
        d = sum(weight * values[:, len(weights) + k, None] for k, weight in enumerate(weights))
        return gamma0 + d * state.load

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`."""
        weights = self.weights(state.q2, state.q3)
        slopes = [*weights, *(weight * state.load for weight in weights)]
        return np.stack(np.broadcast_arrays(*slopes), axis=-1)

    def counter(self, rows: Rows) -> Counter:
        """Closed form of `StepLaw.counter`; NaN where the step size is not above 0 all round."""
        start, stop = float_column(rows, "start"), float_column(rows, "stop")
        basis, (amplitude, phase) = self.basis(rows), self.swing(rows)

        def count(values: Array) -> tuple[Array, Array]:
            gamma0, d = _weighted_sum(basis, values)
            counts, by_gamma0, by_swing = harmonic_counts(gamma0, d * amplitude, phase, start, stop)
            slopes = [basis * by_gamma0[:, None], basis * (by_swing * amplitude)[:, None]]
            return counts, np.concatenate(slopes, axis=1)

        return count

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`."""
        amplitude, phase = self.swing(rows)
        load = np.stack([amplitude * np.cos(phase), amplitude * np.sin(phase)], axis=-1)
        return np.concatenate([self.basis(rows), load], axis=1)


def _weighted_sum(basis: Array, values: Array) -> tuple[Array, Array]:
    m = basis.shape[1]
    values = np.broadcast_to(values, (len(basis), 2 * m))
    return np.sum(basis * values[:, :m], axis=1), np.sum(basis * values[:, m:], axis=1)


class Elbow(Rotary):
    """Joint 2: gamma0 and d linear in q3 between the ends of joint 3's range (thesis Eq. 6.10).

    Parameters
    ----------
    machine : Machine
        Its range of q3 is where the parameters stand.
    """

    name = "rotary-elbow"
    joint = 2
    columns = ("q3", "theta", "psi")
    parameters = (
        Parameter("gamma0_q3_0", "µrad", "step size without load, arm in", lower=0.0),
        Parameter("gamma0_q3_12", "µrad", "step size without load, arm out", lower=0.0),
        Parameter("d_q3_0", "µrad", "step size gained from the full load, arm in"),
        Parameter("d_q3_12", "µrad", "step size gained from the full load, arm out"),
    )

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    def weights(self, q2: Array, q3: Array) -> list[Array]:
        """See `Rotary.weights`."""
        low, high = self.machine.ranges[3]
        out = (q3 - low) / (high - low)
        return [1.0 - out, out]

    def swing(self, rows: Rows) -> tuple[Array, Array]:
        """u2 = cos(theta) sin(psi - q2)."""
        return np.cos(float_column(rows, "theta")), float_column(rows, "psi") - pi / 2

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        none = np.zeros_like(mean_step)
        return np.stack([mean_step, mean_step, none, none], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return np.repeat(mean_step[:, None], 4, axis=1)

    def calibration(self) -> tuple[Configuration, ...]:
        """The four configurations: without load and with it, arm in and arm out."""
        arm_in, arm_out = self.machine.ranges[3]
        side = radians(-90.0)
        return (
            Configuration("base on its side: no load, arm in", q3=arm_in, theta=side),
            Configuration("base on its side: no load, arm out", q3=arm_out, theta=side),
            Configuration("base level: gravity acts, arm in", q3=arm_in),
            Configuration("base level: gravity acts, arm out", q3=arm_out),
        )


class Base(Rotary):
    """Joint 1: gamma0 and d linear in the arm's reach rho = -(l2 + q3) sin q2.

    Parameters
    ----------
    machine : Machine
        Its lengths give the reach.
    """

    name = "rotary-base"
    joint = 1
    columns = ("q2", "q3", "theta", "psi")
    parameters: tuple[Parameter, ...] = (
        Parameter("gamma0_reach_0", "µrad", "step size without load at no reach", lower=0.0),
        Parameter("gamma0_per_mm", "µrad/mm", "change of gamma0 with reach"),
        Parameter("d_reach_0", "µrad", "step size gained from the full load at no reach"),
        Parameter("d_per_mm", "µrad/mm", "change of d with reach"),
    )

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    def weights(self, q2: Array, q3: Array) -> list[Array]:
        """See `Rotary.weights`."""
        rho = reach(self.machine, q2, q3)
        return [np.ones_like(rho), rho]

    def swing(self, rows: Rows) -> tuple[Array, Array]:
        """u1 = cos(theta) sin(psi) sin(q1) + sin(theta) cos(q1)."""
        theta, psi = float_column(rows, "theta"), float_column(rows, "psi")
        along_sine = published_load(1, pi / 2, 0.0, theta, psi)
        along_cosine = published_load(1, 0.0, 0.0, theta, psi)
        return np.hypot(along_sine, along_cosine), np.arctan2(along_sine, along_cosine)

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        none = np.zeros_like(mean_step)
        return np.stack([mean_step, none, none, none], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        per_reach = mean_step / (self.machine.l2 + self.machine.ranges[3][1])
        return np.stack([mean_step, per_reach, mean_step, per_reach], axis=-1)

    def calibration(self) -> tuple[Configuration, ...]:
        """Joint 2's calibration with the two base orientations interchanged, at two reaches."""
        arm_in, arm_out = self.machine.ranges[3]
        level, side = radians(-90.0), radians(-90.0)
        return (
            Configuration("base level: no load, arm level and in", q2=level, q3=arm_in),
            Configuration("base level: no load, arm level and out", q2=level, q3=arm_out),
            Configuration(
                "base on its side: gravity acts, arm level and in", q2=level, q3=arm_in, theta=side
            ),
            Configuration(
                "base on its side: gravity acts, arm level and out", q2=level, q3=arm_out, theta=side
            ),
        )


class BaseAtOneReach(Base):
    """Joint 1 in a log that has one reach: gamma0 and d are constants there.

    Parameters
    ----------
    machine : Machine
    q2, q3 : float
        Where the arm stands, rad and m; new traverses are best made there too.
    """

    name = "rotary-base-one-reach"
    parameters = (
        Parameter("gamma0_reach_0", "µrad", "step size without load at the log's one reach", lower=0.0),
        Parameter("d_reach_0", "µrad", "step size gained from the full load at the log's one reach"),
    )

    def __init__(self, machine: Machine, q2: float, q3: float) -> None:
        super().__init__(machine)
        self.q2 = q2
        self.q3 = q3

    def weights(self, q2: Array, q3: Array) -> list[Array]:
        """See `Rotary.weights`."""
        return [np.ones_like(q2)]

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`."""
        return np.stack([mean_step, np.zeros_like(mean_step)], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return np.repeat(mean_step[:, None], 2, axis=1)

    def calibration(self) -> tuple[Configuration, ...]:
        """The two base orientations, with the arm where the log has it."""
        return (
            Configuration("base level: no load", q2=self.q2, q3=self.q3),
            Configuration("base on its side: gravity acts", q2=self.q2, q3=self.q3, theta=radians(-90.0)),
        )
