"""A stage: slider, contact, drive, foot and base; its step, and the step against one quantity at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.step.closed_form import drive_ratio, is_friction_limited
from stickslip_fit.step.coulomb import coulomb_motion, coulomb_step
from stickslip_fit.step.drift import StageDrift
from stickslip_fit.step.friction import BristleModel, Dahl, Elastoplastic, LuGre, spread_maxwell_slip
from stickslip_fit.step.hysteresis import Hysteresis
from stickslip_fit.step.motion import FootMotion, WaveformName, make_motion, motion_from_table
from stickslip_fit.step.ode import Foot, RecoilBase, solve_motion

ContactName = Literal["coulomb", "lugre", "dahl", "elastoplastic", "maxwell-slip"]
GRAVITY = 9.80665  # m/s^2, standard
PERIODS = 6  # until a step is like the one before
HURRIED_PERIODS = 40  # of a Coulomb slider that the next ramp catches moving


@dataclass(frozen=True)
class Contact:
    """Friction between slider and foot.

    Attributes
    ----------
    model : {'coulomb', 'lugre', 'dahl', 'elastoplastic', 'maxwell-slip'}
        All but the first have bristles, and need `stiffness`.
    friction_coefficient : float
        Kinetic.
    preload : float
        Normal force, N.
    static_ratio : float
        Static over kinetic friction.
    stiffness, damping, viscosity : float
        sigma0, N/m; sigma1 and sigma2, N s/m.
    stribeck_speed : float
        vs, m/s.
    exponent : float
        Dahl's i.
    elastic_share : float
        Elastoplastic: break-away deflection over that of steady sliding.
    elements : int
        Of Maxwell-slip.
    """

    friction_coefficient: float
    preload: float
    model: ContactName = "coulomb"
    static_ratio: float = 1.0
    stiffness: float = 0.0
    damping: float = 0.0
    viscosity: float = 0.0
    stribeck_speed: float = 1e-3
    exponent: float = 1.0
    elastic_share: float = 0.5
    elements: int = 8

    @property
    def friction(self) -> float:
        """Kinetic friction, N."""
        return self.friction_coefficient * self.preload

    def bristles(self) -> BristleModel:
        """Make the bristle model.

        Raises
        ------
        InputError
            If the contact has none, or a value is outside the model's domain.
        """
        force, static = self.friction, self.static_ratio * self.friction
        bristles = (self.stribeck_speed, self.stiffness, self.damping, self.viscosity)
        if self.model == "lugre":
            return LuGre(force, static, *bristles)
        if self.model == "elastoplastic":
            steady = force / self.stiffness if self.stiffness else 0.0
            return Elastoplastic(force, static, *bristles, self.elastic_share * steady)
        if self.model == "dahl":
            return Dahl(force, self.stiffness, self.exponent)
        if self.model == "maxwell-slip":
            return spread_maxwell_slip(force, self.stiffness, self.elements, self.damping)
        raise InputError("Coulomb friction has no bristles; choose another model of the contact")


@dataclass(frozen=True)
class Drive:
    """What the piezo is told to do.

    Attributes
    ----------
    voltage : float
        Peak to peak, V.
    gain : float
        Travel of the foot per volt, with hysteresis of a large change, m/V.
    ramp_time, flyback_time, rest_time : float
        s.
    waveform : {'ramp', 'parabola', 's-curve'}
        See `make_motion`.
    table : tuple of two tuples, optional
        Times, s, and shares of the voltage, in place of times and waveform.
    hysteresis : Hysteresis or None
        Of the piezo in settled use; None for a travel that follows the voltage.
    """

    voltage: float
    gain: float
    ramp_time: float = 0.0
    flyback_time: float = 0.0
    rest_time: float = 0.0
    waveform: WaveformName = "ramp"
    table: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    hysteresis: Hysteresis | None = None

    @property
    def amplitude(self) -> float:
        """Travel of the foot, m."""
        swing = self.voltage if self.hysteresis is None else self.hysteresis.span(self.voltage)
        return swing * self.gain

    def motion(self) -> FootMotion:
        """Make the foot's motion; InputError for values that make none."""
        travel = self.voltage * self.gain
        if self.table is not None:
            motion = motion_from_table(self.table[0], travel * np.array(self.table[1]))
        else:
            times = (self.ramp_time, self.flyback_time, self.rest_time)
            motion = make_motion(self.waveform, travel, *times)
        return motion if self.hysteresis is None else self.hysteresis.apply(motion, self.gain)

    def without_hysteresis(self) -> Drive:
        """The drive of a linear piezo with the same travel."""
        return replace(self, gain=self.amplitude / self.voltage, hysteresis=None)


@dataclass(frozen=True)
class Stage:
    """A stick-slip stage.

    Attributes
    ----------
    name : str
    mass : float
        Of the slider with all that it carries, kg.
    contact : Contact
    drive : Drive
    load : float
        G, m/s^2, positive against the motion.
    foot : Foot or None
        None for one that follows the waveform.
    base : RecoilBase or None
        None for one that stands.
    drift : StageDrift or None
        What use does to it; None for nothing.

    Examples
    --------
    >>> stage = Stage("example", 5e-3, Contact(0.2, 1.25), Drive(80.0, 30e-9, 1.4e-4, 5e-6, 2.25e-4))
    >>> stage.is_friction_limited, float(round(1e9 * stage.step(), 3))
    (True, 980.0)
    """

    name: str
    mass: float
    contact: Contact
    drive: Drive
    load: float = 0.0
    foot: Foot | None = None
    base: RecoilBase | None = None
    drift: StageDrift | None = None

    @property
    def friction_acceleration(self) -> float:
        """a_f, m/s^2."""
        return self.contact.friction / self.mass

    @property
    def is_rigid(self) -> bool:
        """Whether slip and stick of Coulomb friction are the whole motion."""
        dynamic = self.foot is not None and self.foot.is_dynamic
        return self.contact.model == "coulomb" and not dynamic and self.base is None

    @property
    def has_ramp(self) -> bool:
        """Whether the closed forms of `step_size` describe the foot's motion."""
        drive = self.drive
        return drive.table is None and drive.waveform == "ramp" and drive.hysteresis is None

    @property
    def drive_ratio(self) -> float:
        """lambda; nan without a ramp."""
        ratio = drive_ratio(self.friction_acceleration, self.drive.ramp_time, self.drive.amplitude)
        return float(ratio) if self.has_ramp else float("nan")

    @property
    def is_friction_limited(self) -> bool:
        """Whether the slider stays slower than the foot, by the closed form of a ramp."""
        drive = self.drive
        limited = is_friction_limited(self.friction_acceleration, drive.ramp_time, drive.amplitude, self.load)
        return bool(limited) and self.has_ramp

    @property
    def rests_between_steps(self) -> bool:
        """Whether a slider with Coulomb friction rests when the next step begins."""
        motion = coulomb_motion(self.drive.motion(), self.friction_acceleration, self.load)
        return bool(motion.time[-1] <= self.drive.motion().period * (1 + 1e-9))

    def step(self) -> float:
        """Compute the step once steps are alike, m.

        Raises
        ------
        InputError
            For values that have no step; `StepLimitError` where the solver gives up.
        """
        if self.is_rigid:
            values = (self.drive.motion(), self.friction_acceleration, self.load)
            ratio = self.contact.static_ratio
            if self.rests_between_steps:
                return float(coulomb_step(*values, breakaway=ratio))
            # The first steps and the last coast are not like the others.
            longer, shorter = (
                periods * float(coulomb_step(*values, breakaway=ratio, periods=periods))
                for periods in (HURRIED_PERIODS, HURRIED_PERIODS // 2)
            )
            return (longer - shorter) / (HURRIED_PERIODS - HURRIED_PERIODS // 2)
        return float(self._solve(0).steps[-1])

    def trace(self, samples: int = 400) -> StepTrace:
        """Solve one step in time, the first for Coulomb friction, else one that others are like."""
        motion = self.drive.motion()
        if self.is_rigid:
            solved = coulomb_motion(
                motion, self.friction_acceleration, self.load, breakaway=self.contact.static_ratio
            )
            time = np.linspace(0, max(float(motion.period), solved.time[-1]), samples)
            phase = np.clip(np.searchsorted(solved.time, time, side="right") - 1, 0, len(solved.slip) - 1)
            held = np.where(time > solved.time[-1], self.load, solved.friction[phase])
            foot = np.where(time < motion.period, motion.at(np.minimum(time, motion.period)), 0.0)
            return StepTrace(time, foot, solved.at(time), self.mass * held)
        whole = self._solve(samples)
        last = whole.time >= whole.time[-1] - float(motion.period) * (1 + 1e-9)
        slider = whole.slider[last] - whole.slider[last][0]
        return StepTrace(
            whole.time[last] - whole.time[last][0], whole.foot[last], slider, whole.friction[last]
        )

    def after(self, steps: int) -> Stage:
        """The stage after so many steps one after the other; each slides as far as the first.

        Raises
        ------
        InputError
            If nothing holds the load any more, or no friction, preload or travel is left.
        """
        if self.drift is None:
            return self
        time = steps * float(self.drive.motion().period)
        return apply_drift(self, self.drift, time, steps * self.trace().sliding)

    def _solve(self, samples: int):  # type: ignore[no-untyped-def]
        if self.contact.model == "coulomb":
            message = "with a foot that has a resonance, or a base, choose a contact model with bristles"
            raise InputError(f"Coulomb friction is solved for a foot that follows its waveform; {message}")
        return solve_motion(
            self.drive.motion(),
            self.mass,
            self.contact.bristles(),
            self.load,
            foot=self.foot,
            base=self.base,
            periods=PERIODS,
            samples=samples,
        )


@dataclass(frozen=True, eq=False)
class StepTrace:
    """One step in time.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s.
    foot, slider : ndarray, shape (n,)
        Positions, m; the slider's from the beginning of the step on.
    friction : ndarray, shape (n,)
        Force on the slider, N.
    """

    time: Array
    foot: Array
    slider: Array
    friction: Array

    @property
    def sliding(self) -> float:
        """How far slider and foot slide on each other, m."""
        return float(np.abs(np.diff(self.slider - self.foot)).sum())


def apply_drift(stage: Stage, drift: StageDrift, time: float, distance: float) -> Stage:
    """The stage after some use; parameters and errors as of `StageDrift.factors`."""
    factors = drift.factors(time, distance)
    contact = replace(
        stage.contact,
        friction_coefficient=stage.contact.friction_coefficient * factors.friction,
        preload=stage.contact.preload * factors.preload,
    )
    return replace(stage, contact=contact, drive=replace(stage.drive, gain=stage.drive.gain * factors.gain))


CHANGES: Mapping[str, Callable[[Stage, float], Stage]] = {
    "load": lambda stage, value: replace(stage, load=value),
    "mass": lambda stage, value: replace(stage, mass=value),  # the load, an acceleration, stays
    "voltage": lambda stage, value: replace(stage, drive=replace(stage.drive, voltage=value)),
    "preload": lambda stage, value: replace(stage, contact=replace(stage.contact, preload=value)),
    "ramp time": lambda stage, value: replace(stage, drive=replace(stage.drive, ramp_time=value)),
}
"""The stage with another value of a quantity, SI."""


@dataclass(frozen=True, eq=False)
class StepSweep:
    """Step size against one quantity.

    Attributes
    ----------
    quantity : str
        Of `CHANGES`.
    values : ndarray, shape (n,)
        SI.
    steps : ndarray, shape (n,)
        m; nan where the stage has no step.
    """

    quantity: str
    values: Array
    steps: Array


def quantity_of(stage: Stage, quantity: str) -> float:
    """The stage's own value of a quantity, SI."""
    return {
        "load": stage.load,
        "mass": stage.mass,
        "voltage": stage.drive.voltage,
        "preload": stage.contact.preload,
        "ramp time": stage.drive.ramp_time,
    }[quantity]


def step_or_nan(stage: Stage) -> float:
    """The step, m; nan where friction does not hold the load."""
    return stage.step() if stage.mass * abs(stage.load) < stage.contact.friction else float("nan")


def sweep_step(stage: Stage, quantity: str, values: npt.ArrayLike) -> StepSweep:
    """Compute the step against one quantity, all others as they are.

    Parameters
    ----------
    quantity : {'load', 'mass', 'voltage', 'preload', 'ramp time'}
    values : array_like, shape (n,)
        SI.

    Raises
    ------
    InputError
        For an unknown quantity, or a ramp time of a waveform from a table.

    Examples
    --------
    >>> stage = Stage("example", 5e-3, Contact(0.2, 1.25), Drive(80.0, 30e-9, 1.4e-4, 5e-6, 2.25e-4))
    >>> (1e9 * sweep_step(stage, "mass", [5e-3, 10e-3]).steps).round(3)
    array([980., 490.])
    """
    if quantity not in CHANGES:
        raise InputError(f"{quantity!r} is none of {', '.join(CHANGES)}")
    if quantity == "ramp time" and stage.drive.table is not None:
        raise InputError("a waveform from a table has no ramp time to change")
    own = np.atleast_1d(np.asarray(values, dtype=float))
    steps = np.full(len(own), np.nan)
    for place, value in enumerate(own):
        steps[place] = step_or_nan(CHANGES[quantity](stage, float(value)))
    return StepSweep(quantity, own, steps)
