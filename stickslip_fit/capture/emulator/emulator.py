"""The whole rig, emulated: controller, microphone, and the hand that turns the base."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stickslip_fit.capture.clock import Clock, VirtualClock
from stickslip_fit.capture.coarse import STEP_PERIOD
from stickslip_fit.capture.controller import Controller
from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.listening import EmulatedMicrophone, PerfectEar
from stickslip_fit.capture.emulator.manipulator import Manipulator
from stickslip_fit.capture.emulator.new_dialect import NewDialect
from stickslip_fit.capture.emulator.old_dialect import OldDialect
from stickslip_fit.capture.emulator.truth import Truth
from stickslip_fit.capture.emulator.unit import Unit
from stickslip_fit.capture.emulator.wire import EmulatedWire
from stickslip_fit.capture.line import Line
from stickslip_fit.capture.nanocontrol import NanoControl
from stickslip_fit.capture.nanocontrol_old import OldNanoControl
from stickslip_fit.errors import InputError, Problem

UNITS: dict[str, type[Unit]] = {"new": NewDialect, "old": OldDialect}
SOUND = 2  # a stream of random numbers beside those of the truth


@dataclass(frozen=True, eq=False)
class Emulator:
    """An emulated rig within this program, by a clock of its own.

    Attributes
    ----------
    unit : Unit
        Takes and gives the bytes of its dialect.
    """

    unit: Unit

    @property
    def clock(self) -> Clock:
        """By which everything in the rig runs."""
        return self.unit.clock

    @property
    def hands(self) -> Manipulator:
        """What a person sets: `set`, `set_stops`, `begin_session`."""
        self.unit.advance()
        return self.unit.manipulator

    def controller(self, tell: Callable[[str], None]) -> Controller:
        """A controller that talks to the unit in its own dialect; see `open_controller`."""
        line = Line(EmulatedWire(self.unit), self.clock, self.unit.ends)
        if isinstance(self.unit, OldDialect):
            return OldNanoControl(line, self.unit.period)
        return NanoControl(line, tell, self.unit.period)

    def microphone(self, acoustics: Acoustics) -> EmulatedMicrophone:
        """A source of what a microphone hears; `acoustics` with the unit's step period."""
        rng = np.random.default_rng([self.hands.truth.seed, SOUND])
        return EmulatedMicrophone(self.unit, acoustics, rng)

    def perfect_ear(self) -> PerfectEar:
        """An ear that is always right."""
        return PerfectEar(self.unit)


def emulate(
    truth: Truth, dialect: str = "new", clock: Clock | None = None, period: float = STEP_PERIOD
) -> Emulator:
    """Set up an emulated rig: base level, arm level and drawn in, all joints new.

    Parameters
    ----------
    truth : Truth
    dialect : {'new', 'old'}
    clock : Clock, optional
        A virtual one unless given, so that hours pass in seconds.
    period : float
        From one step to the next, s.

    Raises
    ------
    InputError
        For another dialect.

    Examples
    --------
    >>> from stickslip_fit.laws import Prismatic
    >>> from stickslip_fit.machine import load_machine
    >>> from stickslip_fit.simulate import LawValues
    >>> values = {(3, "+", None): np.array([976e-9, 0.3, 438e-9])}
    >>> rig = emulate(Truth(LawValues({3: Prismatic()}, values), load_machine()))
    >>> controller = rig.controller(tell=print)
    >>> controller.step(3, 1000)
    >>> round(1e6 * rig.hands.position(3)), rig.clock.now()
    (976, 10.0)
    """
    if dialect not in UNITS:
        raise InputError(Problem(f"give one of {', '.join(UNITS)}", column="dialect", value=dialect))
    return Emulator(UNITS[dialect](Manipulator(truth), clock or VirtualClock(), period))
