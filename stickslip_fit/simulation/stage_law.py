"""StageLaw: a joint's law whose step size is that of a stage, and changes as the stage does.

Joint 3: the slider carries its own weight, so that the load is g u. A rotary joint's slider sits at the
contact radius R: with the moment of inertia J and the torque of gravity T at full load, the mass there is
J / R^2 and the load's force is T / R. Inertia and torque follow the arm as in `laws.physical`. A payload at
the tip adds its mass, (lever / R)^2 of it on a rotary joint, and its weight. The recoil of joint 3 is that of
thesis Eq. 4.5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Configuration, Parameter, Rows, State, StepLaw, state_at
from stickslip_fit.laws.base import Counter
from stickslip_fit.laws.integration import integrate
from stickslip_fit.laws.physical import PhysicalBase, PhysicalElbow, PhysicalPrismatic
from stickslip_fit.logs.reader import DIRECTIONS
from stickslip_fit.machine import Machine, reach
from stickslip_fit.machine.dynamics import STANDARD_GRAVITY
from stickslip_fit.simulation.schedule import Schedule, schedule_values
from stickslip_fit.simulation.stage_step import WorkingPoints, make_step_function
from stickslip_fit.step import Stage
from stickslip_fit.units import PRISMATIC

COUNT_ACCURACY = 1e-8  # relative
POSE = ("q2", "q3", "theta", "psi")


@dataclass(frozen=True, eq=False)
class MountedStage:
    """A stage in one direction of a joint.

    Attributes
    ----------
    stage : Stage
        Without a load, which the configuration gives.
    schedules : tuple of Schedule
    recoil : float
        Joint 3: b, the share of the step lost with the arm upright.
    radius : float
        Rotary: of the contact about the axis, m.
    inertia : float
        Rotary: gained from one end of the arm's range to the other, as a share of what the stage's mass says.
    shares : tuple of float
        Rotary: torque of gravity at full load over that of friction as the stage has it, with the arm in and
        out (joint 2), or at no and at full reach (joint 1).
    """

    stage: Stage
    schedules: tuple[Schedule, ...] = ()
    recoil: float = 0.0
    radius: float = 1.0
    inertia: float = 0.0
    shares: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def step(self) -> Callable[[WorkingPoints], Array]:
        """The steps as a function of `WorkingPoints`, m; nan where friction does not hold the load."""
        return make_step_function(self.stage)

    def bind(self, sessions: Sequence[str], traverses: int) -> MountedStage:
        """The same in a campaign of these sessions, of so many traverses each; raises as `Course.bind`."""
        bound = replace(self, schedules=tuple(each.bind(sessions, traverses) for each in self.schedules))
        vars(bound)["step"] = self.step  # with what has been solved
        return bound

    def conditions(self, row: Mapping[str, Any]) -> dict[str, Array]:
        """Preload (N), friction (1), voltage, ramp time and payload of each traverse, SI, shape (n,) or (1,).

        Raises
        ------
        InputError
            If a schedule lacks what it depends on, or leaves nothing of a quantity.
        """
        contact, drive = self.stage.contact, self.stage.drive
        nominal = {
            "preload": contact.preload,
            "friction": contact.friction_coefficient,
            "voltage": drive.voltage,
            "ramp time": drive.ramp_time,
            "payload": 0.0,
        }
        changing = {each.quantity for each in self.schedules}
        return {
            name: schedule_values(name, value, self.schedules, row) if name in changing else np.array([value])
            for name, value in nominal.items()
        }


@dataclass(frozen=True, eq=False)
class StageLaw(StepLaw):
    """The step size of a joint that a stage drives; nothing in it is fitted.

    Parameters
    ----------
    joint : {1, 2, 3}
    stages : mapping of str to MountedStage
        By direction.
    machine : Machine
    """

    joint: int
    stages: Mapping[str, MountedStage]
    machine: Machine
    parameters: tuple[Parameter, ...] = field(default=(), init=False)

    name = "stage"
    max_panel = 0.6
    has_kinks = True

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `StepLaw.columns`; those of the schedules."""
        schedules = [each for stage in self.stages.values() for each in stage.schedules]
        own = [name for each in schedules for name in each.course.columns]
        return tuple(dict.fromkeys([*POSE, "start", "stop", *own]))

    def bind(self, sessions: Sequence[str], traverses: int) -> StageLaw:
        """The law in a campaign of these sessions, of so many traverses each; raises as `Course.bind`."""
        return replace(
            self, stages={way: stage.bind(sessions, traverses) for way, stage in self.stages.items()}
        )

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`; InputError for a direction without a stage."""
        positive = state.direction_sign[:, 0] > 0
        parts = [
            (way, mask) for way, mask in zip(DIRECTIONS, (positive, ~positive), strict=True) if mask.any()
        ]
        found = [(mask, self._gamma_in(way, state, mask)) for way, mask in parts]
        gamma = np.empty((len(positive), found[0][1].shape[1]))
        for mask, own in found:
            gamma[mask] = own
        return gamma

    def _gamma_in(self, way: str, state: State, mask: BoolArray) -> Array:
        """Step sizes of the traverses of one direction, shape (m, k) or (m, 1)."""
        if way not in self.stages:
            raise InputError(f"joint {self.joint}, direction {way} has no stage; add a [[stage]] for it")
        mounted = self.stages[way]
        row = {name: np.asarray(values)[mask] for name, values in state.row.items()}
        now = {name: values[:, None] for name, values in mounted.conditions(row).items()}
        friction = now["friction"] * now["preload"]
        against = (1.0 if way == "+" else -1.0) * _rows_of(state.load, mask)
        q2, q3 = _rows_of(state.q2, mask), _rows_of(state.q3, mask)
        count = int(mask.sum())
        mass, weight = self._mass_and_weight(mounted, now["payload"], q2, q3)
        arrays = (weight * against / mass, mass, friction, now["voltage"], now["ramp time"])
        k = int(np.broadcast_shapes(*(np.shape(array) for array in arrays))[1])
        steps = mounted.step(WorkingPoints(*(np.broadcast_to(each, (count, k)) for each in arrays)))
        if self.joint == PRISMATIC:
            return steps * (1.0 - mounted.recoil * _rows_of(state.recoil, mask))
        return steps / mounted.radius

    def _mass_and_weight(
        self, mounted: MountedStage, payload: Array, q2: Array, q3: Array
    ) -> tuple[Array, Array]:
        """Mass at the contact, kg, and force of gravity there at full load, N."""
        stage = mounted.stage
        if self.joint == PRISMATIC:
            mass = stage.mass + payload
            return mass, STANDARD_GRAVITY * mass
        gain = self._arm.inertia_weight(q2, q3)
        assert gain is not None
        length = self.machine.l2 + q3 if self.joint == 2 else self.machine.a1 + reach(self.machine, q2, q3)
        lever = length / mounted.radius
        weights = self._arm.share_weights(q2, q3)
        share = sum(weight * value for weight, value in zip(weights, mounted.shares, strict=True))
        mass = stage.mass * (1.0 + mounted.inertia * gain) + payload * lever**2
        return mass, share * stage.contact.friction + STANDARD_GRAVITY * payload * lever

    @cached_property
    def _arm(self) -> PhysicalElbow | PhysicalBase:
        return (PhysicalElbow if self.joint == PhysicalElbow.joint else PhysicalBase)(self.machine)

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`; there are no parameters to differentiate by."""
        row = {name: np.asarray(rows[name]) for name in self.columns if name in rows}
        start, stop = (np.asarray(row[name], dtype=float) for name in ("start", "stop"))

        def rate(owner: IntArray, position: Array) -> Array:
            own = {name: column[owner] for name, column in row.items()}
            gamma = self.gamma(state_at(self.joint, own, position), np.empty((len(owner), 0)))
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.broadcast_to(np.where(gamma > 0, 1.0 / gamma, np.nan), position.shape)

        def count(values: Array) -> tuple[Array, Array]:
            slopes = np.empty((len(start), 0))
            if self.joint == PRISMATIC:
                return np.abs(stop - start) * rate(np.arange(len(start)), start[:, None])[:, 0], slopes
            stalls = np.zeros(len(start), dtype=bool)

            def integrand(owner: IntArray, position: Array) -> Array:
                own = rate(owner, position)
                stalls[owner[np.isnan(own).any(axis=1)]] = True
                return np.where(stalls[owner, None], 0.0, own)

            counts = integrate(integrand, start, stop, max_panel=self.max_panel, relative=COUNT_ACCURACY)
            return np.where(stalls, np.nan, np.abs(counts)), slopes

        return count

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`: none."""
        return np.empty((len(values), 1, 0))

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`: none."""
        return np.empty((len(mean_step), 0))

    scales = start_values

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: every number that it uses."""
        names = [name for name in self.columns if name in rows]
        return np.stack([np.asarray(rows[name], dtype=float) for name in names], axis=-1)

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`: the published law's."""
        return PhysicalPrismatic().calibration() if self.joint == PRISMATIC else self._arm.calibration()


def _rows_of(values: Array, mask: BoolArray) -> Array:
    """The rows of an array of the state, which may have one for all."""
    if len(values) == len(mask):
        return values[mask]
    return np.broadcast_to(values, (int(mask.sum()), values.shape[1]))
