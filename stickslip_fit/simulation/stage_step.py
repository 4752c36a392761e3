"""Steps of one stage at many working points at once: loads, masses, frictions, voltages, ramp times.

Coulomb friction on a ramp has a closed form, on any other waveform the event-driven solution; both are exact.
Contacts with bristles, a foot with a resonance or a base take a differential equation for each point:
`StepTable` solves few points and interpolates between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.simulation.step_table import StepTable
from stickslip_fit.step import FootMotion, Stage, coulomb_step, settling_time, step_size

HURRIED_PERIODS = 40  # of a slider that the next ramp catches moving, as in `Stage.step`
SAME_STEP = 1e-9  # relative, of the first step and the second


@dataclass(frozen=True, eq=False)
class WorkingPoints:
    """Where a stage works, arrays of one shape.

    Attributes
    ----------
    load : array
        Deceleration of the slider, m/s^2.
    mass, friction, voltage, ramp_time : array
        Slider, kg; kinetic friction, N; V; s.
    """

    load: Array
    mass: Array
    friction: Array
    voltage: Array
    ramp_time: Array

    def stacked(self) -> Array:
        """The points that friction holds or not, shape (n, 5)."""
        arrays = (self.load, self.mass, self.friction, self.voltage, self.ramp_time)
        return np.stack([array.ravel() for array in arrays], axis=-1)


def stage_at(stage: Stage, load: float, mass: float, friction: float, voltage: float, ramp: float) -> Stage:
    """A stage at one working point; the bristles' stiffness stays."""
    preload = friction / stage.contact.friction_coefficient
    return replace(
        stage,
        load=load,
        mass=mass,
        contact=replace(stage.contact, preload=preload),
        drive=replace(stage.drive, voltage=voltage, ramp_time=ramp),
    )


def make_step_function(stage: Stage) -> Callable[[WorkingPoints], Array]:
    """The steps of a stage as a function of `WorkingPoints`, m; nan where friction does not hold the load.

    Examples
    --------
    >>> from stickslip_fit.step import Contact, Drive
    >>> stage = Stage("example", 5e-3, Contact(0.2, 1.25), Drive(80.0, 30e-9, 1.4e-4, 5e-6, 2.25e-4))
    >>> one = np.ones(2)
    >>> points = WorkingPoints(np.array([0.0, 9.80665]), 5e-3 * one, 0.25 * one, 80 * one, 1.4e-4 * one)
    >>> (1e9 * make_step_function(stage)(points)).round(3)
    array([980.   , 658.614])
    """
    if not stage.is_rigid:
        table = StepTable(
            lambda point: stage_at(stage, *point).step(), lambda x: np.abs(x[:, 0]) * x[:, 1] < x[:, 2]
        )
        return lambda points: table.steps(points.stacked()).reshape(points.load.shape)
    compute = _ramp_steps if stage.has_ramp else _waveform_steps
    return lambda points: compute(stage, points)


def _ramp_steps(stage: Stage, points: WorkingPoints) -> Array:
    drive = stage.drive
    acceleration, travel = points.friction / points.mass, points.voltage * drive.gain
    values = (acceleration, points.ramp_time, travel, points.load, drive.flyback_time)
    steps = step_size(*values)
    left = drive.flyback_time + drive.rest_time
    moving = settling_time(*values) > left * (1 + SAME_STEP)
    if moving.any():
        steps[moving] = _waveform_steps(stage, _subset(points, moving))
    return steps


def _waveform_steps(stage: Stage, points: WorkingPoints) -> Array:
    """Event by event, one motion of the foot after the other."""
    steps = np.full(points.load.shape, np.nan)
    held = np.abs(points.load) * points.mass < points.friction
    drives = np.stack([points.voltage, points.ramp_time], axis=-1)
    for voltage, ramp in np.unique(drives[held], axis=0):
        subset = held & (drives[..., 0] == voltage) & (drives[..., 1] == ramp)
        motion = replace(stage.drive, voltage=float(voltage), ramp_time=float(ramp)).motion()
        acceleration = points.friction[subset] / points.mass[subset]
        steps[subset] = _repeated_steps(motion, acceleration, points.load[subset], stage.contact.static_ratio)
    return steps


def _repeated_steps(motion: FootMotion, acceleration: Array, load: Array, breakaway: float) -> Array:
    """The step once steps are alike, which the first is if the slider rests before the second."""

    def way(periods: int, which: BoolArray | slice) -> Array:
        values = acceleration[which], load[which]
        return periods * coulomb_step(motion, *values, breakaway=breakaway, periods=periods)

    every = slice(None)
    steps = way(1, every)
    scale = np.maximum(np.abs(steps), SAME_STEP * np.ptp(motion.position))
    hurried = np.abs(way(2, every) - 2 * steps) > SAME_STEP * scale
    if hurried.any():
        fewer = HURRIED_PERIODS // 2
        steps[hurried] = (way(HURRIED_PERIODS, hurried) - way(fewer, hurried)) / (HURRIED_PERIODS - fewer)
    return steps


def _subset(points: WorkingPoints, which: BoolArray) -> WorkingPoints:
    arrays = (points.load, points.mass, points.friction, points.voltage, points.ramp_time)
    return WorkingPoints(*(array[which] for array in arrays))
