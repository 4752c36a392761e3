"""The published laws of the three joints, and the constant step that labs use without calibration.

Prismatic joint (thesis Eq. 4.5): gamma3 = (1 - b |cos q2|) (a - c cos zeta cos theta), with a the step size
without gravity and recoil, b the recoil of the arm and c the gravity load coefficient. Rotary joints (Eq.
6.10): gamma = gamma0 + d u with the gravity load u; gamma0 and d are linear in q3 for joint 2 (Elbow), and
in the reach rho = -(l2 + q3) sin q2 for joint 1 (Base). ConstantStep: one step size everywhere (Ch. 7).

The thesis is A. Damani, "An Empirical Model of Piezoelectric Stick-Slip Actuation of the Kleindiek MM3A
Micromanipulator", M.S. thesis, Department of Mechanical Engineering, University of Utah, 2013.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from math import pi, radians

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.laws.base import (
    Configuration,
    Counter,
    Parameter,
    Rows,
    StepLaw,
    float_column,
    traverse_length,
)
from stickslip_fit.laws.integration import State, harmonic_counts
from stickslip_fit.machine import Machine, published_load, reach
from stickslip_fit.units import PRISMATIC

LEVEL = SIDE = radians(-90.0)  # q2 with the arm level; theta with the base on its side
REACH_TOL = 1e-6  # m; closer than a lab can set an arm


class Prismatic(StepLaw):
    """Joint 3: step size a without gravity and recoil, less the recoil b and the load c (thesis Eq. 4.5).

    The step size is constant along the guide: the steps over a traverse are its length over the step size.
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
        kept, net = _recoil_and_load_factors(state.recoil, state.load, values[:, None, :])
        return kept * net

    def gamma_slopes(self, state: State, values: Array) -> Array:
        kept, net = _recoil_and_load_factors(state.recoil, state.load, values[:, None, :])
        return np.stack(np.broadcast_arrays(kept, -state.recoil * net, -kept * state.load), axis=-1)

    def start_values(self, mean_step: Array) -> Array:
        return np.stack([1.2 * mean_step, np.full_like(mean_step, 0.2), np.zeros_like(mean_step)], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        return np.stack([mean_step, np.ones_like(mean_step), mean_step], axis=-1)

    def features(self, rows: Rows) -> Array:
        """Recoil |cos q2| and load; see `StepLaw.features`."""
        q2, theta, psi = (float_column(rows, name) for name in ("q2", "theta", "psi"))
        return np.stack([np.abs(np.cos(q2)), published_load(PRISMATIC, 0.0, q2, theta, psi)], axis=-1)

    def calibration(self) -> tuple[Configuration, ...]:
        """The three configurations of thesis Eqs. 6.2 to 6.4: a, then b, then c."""
        return (
            Configuration("arm level: no load along it, no recoil", q2=LEVEL),
            Configuration("arm upright, base on its side: recoil without load", q2=0.0, theta=SIDE),
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
    """The two factors of Eq. 4.5, 1 - b recoil and a - c load; the last axis of `values` is a, b, c."""
    return 1.0 - values[..., 1] * recoil, values[..., 0] - values[..., 2] * load


class Rotary(StepLaw):
    """gamma = sum of basis_k (gamma0_k + d_k u), with u = amplitude cos(q - phase) along the traverse.

    A subclass defines the basis, the load along a traverse and its 2 m parameters: the gamma0_k, then the
    d_k.
    """

    @abstractmethod
    def weights(self, q2: Array, q3: Array) -> list[Array]:
        """Basis functions at positions of joints 2 and 3, m arrays of one shape."""

    @abstractmethod
    def swing(self, rows: Rows) -> tuple[Array, Array]:
        """Amplitude and phase of the load, u = amplitude cos(q - phase), each shape (n,)."""

    def basis(self, rows: Rows) -> Array:
        """Basis functions of each row, shape (n, m)."""
        q2 = float_column(rows, "q2") if "q2" in self.columns else np.zeros(len(float_column(rows, "q3")))
        return np.stack(self.weights(q2, float_column(rows, "q3")), axis=-1)

    def coefficients(self, rows: Rows, values: Array) -> tuple[Array, Array]:
        """gamma0 and d of each row, rad, each shape (n,)."""
        return _weighted_sum(self.basis(rows), values)

    def gamma(self, state: State, values: Array) -> Array:
        weights = self.weights(state.q2, state.q3)
        gamma0 = sum(weight * values[:, k, None] for k, weight in enumerate(weights))
        d = sum(weight * values[:, len(weights) + k, None] for k, weight in enumerate(weights))
        return gamma0 + d * state.load

    def gamma_slopes(self, state: State, values: Array) -> Array:
        weights = self.weights(state.q2, state.q3)
        slopes = [*weights, *(weight * state.load for weight in weights)]
        return np.stack(np.broadcast_arrays(*slopes), axis=-1)

    def counter(self, rows: Rows) -> Counter:
        """Closed form of `StepLaw.counter`; NaN where the step size is not above 0 at every angle."""
        start, stop = float_column(rows, "start"), float_column(rows, "stop")
        basis, (amplitude, phase) = self.basis(rows), self.swing(rows)

        def count(values: Array) -> tuple[Array, Array]:
            gamma0, d = _weighted_sum(basis, values)
            counts, by_gamma0, by_swing = harmonic_counts(gamma0, d * amplitude, phase, start, stop)
            slopes = [basis * by_gamma0[:, None], basis * (by_swing * amplitude)[:, None]]
            return counts, np.concatenate(slopes, axis=1)

        return count

    def features(self, rows: Rows) -> Array:
        amplitude, phase = self.swing(rows)
        load = np.stack([amplitude * np.cos(phase), amplitude * np.sin(phase)], axis=-1)
        return np.concatenate([self.basis(rows), load], axis=1)


def _weighted_sum(basis: Array, values: Array) -> tuple[Array, Array]:
    m = basis.shape[1]
    values = np.broadcast_to(values, (len(basis), 2 * m))
    return np.sum(basis * values[:, :m], axis=1), np.sum(basis * values[:, m:], axis=1)


class Elbow(Rotary):
    """Joint 2: gamma0 and d linear in q3 between the ends of the machine's range of q3 (thesis Eq. 6.10)."""

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
        low, high = self.machine.ranges[3]
        out = (q3 - low) / (high - low)
        return [1.0 - out, out]

    def swing(self, rows: Rows) -> tuple[Array, Array]:
        """u2 = cos(theta) sin(psi - q2)."""
        return np.cos(float_column(rows, "theta")), float_column(rows, "psi") - pi / 2

    def start_values(self, mean_step: Array) -> Array:
        zero = np.zeros_like(mean_step)
        return np.stack([mean_step, mean_step, zero, zero], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        return np.repeat(mean_step[:, None], 4, axis=1)

    def calibration(self) -> tuple[Configuration, ...]:
        """The four configurations: without load and with it, arm in and arm out."""
        arm_in, arm_out = self.machine.ranges[3]
        return (
            Configuration("base on its side: no load, arm in", q3=arm_in, theta=SIDE),
            Configuration("base on its side: no load, arm out", q3=arm_out, theta=SIDE),
            Configuration("base level: gravity acts, arm in", q3=arm_in),
            Configuration("base level: gravity acts, arm out", q3=arm_out),
        )


class Base(Rotary):
    """Joint 1: gamma0 and d linear in the arm's reach rho = -(l2 + q3) sin q2 (thesis Eq. 6.10)."""

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
        rho = reach(self.machine, q2, q3)
        return [np.ones_like(rho), rho]

    def swing(self, rows: Rows) -> tuple[Array, Array]:
        """u1 = cos(theta) sin(psi) sin(q1) + sin(theta) cos(q1)."""
        theta, psi = float_column(rows, "theta"), float_column(rows, "psi")
        sine, cosine = (published_load(1, q1, 0.0, theta, psi) for q1 in (pi / 2, 0.0))
        return np.hypot(sine, cosine), np.arctan2(sine, cosine)

    def start_values(self, mean_step: Array) -> Array:
        zero = np.zeros_like(mean_step)
        return np.stack([mean_step, zero, zero, zero], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        per_reach = mean_step / (self.machine.l2 + self.machine.ranges[3][1])
        return np.stack([mean_step, per_reach, mean_step, per_reach], axis=-1)

    def calibration(self) -> tuple[Configuration, ...]:
        """Joint 2's calibration with the two base orientations interchanged, at two reaches."""
        arm_in, arm_out = self.machine.ranges[3]
        return (
            Configuration("base level: no load, arm level and in", q2=LEVEL, q3=arm_in),
            Configuration("base level: no load, arm level and out", q2=LEVEL, q3=arm_out),
            Configuration(
                "base on its side: gravity acts, arm level and in", q2=LEVEL, q3=arm_in, theta=SIDE
            ),
            Configuration(
                "base on its side: gravity acts, arm level and out", q2=LEVEL, q3=arm_out, theta=SIDE
            ),
        )


class BaseAtOneReach(Base):
    """Joint 1 in a log that has one reach, at q2 and q3 (rad, m): gamma0 and d are constants there."""

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
        return [np.ones_like(q2)]

    def start_values(self, mean_step: Array) -> Array:
        return np.stack([mean_step, np.zeros_like(mean_step)], axis=-1)

    def scales(self, mean_step: Array) -> Array:
        return np.repeat(mean_step[:, None], 2, axis=1)

    def calibration(self) -> tuple[Configuration, ...]:
        """The two base orientations, with the arm where the log has it."""
        return (
            Configuration("base level: no load", q2=self.q2, q3=self.q3),
            Configuration("base on its side: gravity acts", q2=self.q2, q3=self.q3, theta=SIDE),
        )


class ConstantStep(StepLaw):
    """One step size for every configuration (thesis Ch. 7).

    It is calibrated in the configuration `measured_in`, or by any traverse.
    """

    name = "constant"

    def __init__(
        self, joint: int, measured_in: Configuration | None = None, *, prismatic: bool | None = None
    ) -> None:
        self.joint = joint
        self.measured_in = measured_in
        self._prismatic = joint == PRISMATIC if prismatic is None else prismatic
        unit = "nm" if self._prismatic else "µrad"
        self.parameters = (Parameter("gamma", unit, "step size everywhere", lower=0.0),)

    @property
    def prismatic(self) -> bool:
        return self._prismatic

    def gamma(self, state: State, values: Array) -> Array:
        return values[:, :1]

    def gamma_slopes(self, state: State, values: Array) -> Array:
        return np.ones((len(values), 1, 1))

    def start_values(self, mean_step: Array) -> Array:
        return mean_step[:, None]

    def scales(self, mean_step: Array) -> Array:
        return mean_step[:, None]

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: none."""
        return np.zeros((len(float_column(rows, "start")), 0))

    def calibration(self) -> tuple[Configuration, ...]:
        return () if self.measured_in is None else (self.measured_in,)

    def counter(self, rows: Rows) -> Counter:
        """Closed form of `StepLaw.counter`."""
        length = traverse_length(rows)

        def count(values: Array) -> tuple[Array, Array]:
            gamma = np.broadcast_to(values, (len(length), 1))[:, 0]
            counts = length / gamma
            return counts, (-counts / gamma)[:, None]

        return count


def published_law(joint: int, rows: Rows, machine: Machine) -> StepLaw:
    """The law of `joint` that the rows of its traverses can determine.

    Joint 1's gamma0 and d are linear in the reach, and constants where the rows have one reach. InputError
    for a machine without the published geometry.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> published_law(3, {}, load_machine()).name
    'prismatic'
    """
    machine.require_geometry("the published laws")
    if joint == Prismatic.joint:
        return Prismatic()
    if joint == Elbow.joint:
        return Elbow(machine)
    q2, q3 = float_column(rows, "q2"), float_column(rows, "q3")
    if len(q2) and np.ptp(reach(machine, q2, q3)) < REACH_TOL:
        return BaseAtOneReach(machine, float(q2[0]), float(q3[0]))
    return Base(machine)


def is_published(law: StepLaw) -> bool:
    """Whether it is one of the thesis's laws, so that what the thesis says of them concerns it.

    Examples
    --------
    >>> is_published(Prismatic()), is_published(ConstantStep(3))
    (True, False)
    """
    return isinstance(law, Prismatic | Rotary)


def describe_published(law: StepLaw) -> dict[str, str | int | float]:
    """What `restore_published` needs to rebuild the law, as plain JSON types."""
    description: dict[str, str | int | float] = {"name": law.name, "joint": law.joint}
    if isinstance(law, BaseAtOneReach):
        description |= {"q2_rad": law.q2, "q3_m": law.q3}
    return description


def restore_published(description: dict[str, str | int | float], machine: Machine) -> StepLaw:
    """The law that `describe_published` described.

    Raises
    ------
    InputError
        For a law that this version does not know.
    """
    name = description.get("name")
    if name == Prismatic.name:
        return Prismatic()
    if name in (Elbow.name, Base.name):
        return Elbow(machine) if name == Elbow.name else Base(machine)
    if name == BaseAtOneReach.name:
        return BaseAtOneReach(machine, float(description["q2_rad"]), float(description["q3_m"]))
    if name == ConstantStep.name:
        joint = int(description["joint"])
        return ConstantStep(joint, prismatic=machine.is_prismatic(joint))
    raise InputError(f"the saved law {name!r} is unknown to this version; fit the log again")


def constant_law(law: StepLaw) -> ConstantStep:
    """The constant step of thesis Ch. 7 for the joint of `law`, from its first calibration configuration."""
    return ConstantStep(law.joint, next(iter(law.calibration()), None), prismatic=law.prismatic)


def name_of_laws(laws: Iterable[StepLaw]) -> str:
    """What laws are called in a sentence."""
    return "published law" if all(map(is_published, laws)) else "law"
