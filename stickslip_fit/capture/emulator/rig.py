"""EmulatedRig: controller, microphone and operator together; `emulate_rig` sets one up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC

import numpy as np

from stickslip_fit.capture.emulator.acoustics import Acoustics, synthesize_sound
from stickslip_fit.capture.emulator.controller import (
    EmulatedController,
    EmulatedTransport,
    NewDialect,
    OldDialect,
)
from stickslip_fit.capture.emulator.manipulator import HiddenLaws, Manipulator
from stickslip_fit.capture.nanocontrol import LineTransport, NanoControl, OldNanoControl
from stickslip_fit.capture.operator import (
    Operator,
    OperatorChoice,
    OperatorReply,
    PlannedDrive,
    RigSetting,
    TraverseReading,
)
from stickslip_fit.capture.protocols import (
    STEP_PERIOD,
    Clock,
    Controller,
    Detection,
    EndStopDetector,
    Samples,
    VirtualClock,
)
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.plan import Plan

STOP_LEVEL_DB, MOVING_LEVEL_DB = 20.0, 0.0  # dB


class EmulatedMicrophone:
    """An `AudioSource` of the sound of an emulated controller's joints, with the same step period."""

    def __init__(
        self, controller: EmulatedController, acoustics: Acoustics, rng: np.random.Generator
    ) -> None:
        self.rate = acoustics.rate
        self._controller = controller
        self._acoustics = acoustics
        self._rng = rng
        self._heard_until = controller.clock.now()

    def read(self, seconds: float) -> Samples:
        """See `AudioSource.read`; whole step periods, at least one."""
        period, clock = self._acoustics.period, self._controller.clock
        slots = max(round(seconds / period), 1)
        self._heard_until = max(clock.now(), self._heard_until + slots * period)
        clock.sleep(self._heard_until - clock.now())
        began = self._heard_until - slots * period
        moving, at_stop = self._steps(began + (np.arange(slots) + 0.5) * period)
        return Samples(synthesize_sound(self._acoustics, began, moving, at_stop, self._rng))

    def close(self) -> None:
        """See `AudioSource.close`."""

    def _steps(self, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether a step is made at each time, and whether it pushes against a stop."""
        self._controller.advance()
        moving, at_stop = np.zeros((2, len(middles)), bool)
        for record in reversed(self._controller.manipulator.step_records):
            if record.ended <= middles[0]:
                break
            number = np.floor((middles - record.began) / record.period)
            within = (number >= 0) & (number < record.steps)
            moving |= within
            at_stop |= within & (number >= record.moving)
        return moving, at_stop


class IdealDetector(EndStopDetector):
    """An `EndStopDetector` that knows at which step the stop was met."""

    def __init__(self, controller: EmulatedController) -> None:
        self._controller = controller
        self._heard_until = controller.clock.now()

    def begin(self) -> None:
        self._heard_until = self._controller.clock.now()

    def check(self, seconds: float) -> Detection:
        self._controller.advance()
        at_stop = False
        for record in reversed(self._controller.manipulator.step_records):
            if record.ended <= self._heard_until + record.period / 2:
                break
            at_stop |= record.moving < record.steps
        self._heard_until = self._controller.clock.now()
        return Detection(at_stop, STOP_LEVEL_DB if at_stop else MOVING_LEVEL_DB)

    def close(self) -> None:
        """See `EndStopDetector.close`."""


DIALECTS: dict[str, type[EmulatedController]] = {"new": NewDialect, "old": OldDialect}
SOUND_STREAM = 2  # a stream of random numbers beside those of the hidden laws


@dataclass(frozen=True, eq=False)
class EmulatedRig:
    """An emulated rig within this program, with a clock of its own."""

    emulated_controller: EmulatedController

    @property
    def clock(self) -> Clock:
        """The clock of everything in the rig."""
        return self.emulated_controller.clock

    @property
    def manipulator(self) -> Manipulator:
        """The joints, to be set by hand: `set`, `set_stops`, `begin_session`."""
        self.emulated_controller.advance()
        return self.emulated_controller.manipulator

    def controller(self, notify: Callable[[str], None]) -> Controller:
        """A controller that talks to the emulated one in its dialect; see `open_controller`."""
        line = LineTransport(
            EmulatedTransport(self.emulated_controller), self.clock, self.emulated_controller.terminator
        )
        if isinstance(self.emulated_controller, OldDialect):
            return OldNanoControl(line, self.emulated_controller.period)
        return NanoControl(line, notify, self.emulated_controller.period)

    def microphone(self, acoustics: Acoustics) -> EmulatedMicrophone:
        """A microphone at the rig; `acoustics` with the controller's step period."""
        rng = np.random.default_rng([self.manipulator.truth.seed, SOUND_STREAM])
        return EmulatedMicrophone(self.emulated_controller, acoustics, rng)

    def ideal_detector(self) -> IdealDetector:
        """A detector without error."""
        return IdealDetector(self.emulated_controller)


def emulate_rig(
    truth: HiddenLaws, dialect: str = "new", clock: Clock | None = None, period: float = STEP_PERIOD
) -> EmulatedRig:
    """Set up an emulated rig: base level, arm level and drawn in, all joints new.

    Parameters
    ----------
    dialect : {'new', 'old'}
    clock : Clock, optional
        A virtual one by default, so that hours pass in seconds.
    period : float
        Of a step, s.

    Raises
    ------
    InputError
        For another dialect.

    Examples
    --------
    >>> from stickslip_fit.laws import Prismatic
    >>> from stickslip_fit.machine import load_machine
    >>> from stickslip_fit.simulation import LawValues
    >>> values = {(3, "+", None): np.array([976e-9, 0.3, 438e-9])}
    >>> rig = emulate_rig(HiddenLaws(LawValues({3: Prismatic()}, values), load_machine()))
    >>> controller = rig.controller(notify=print)
    >>> controller.step(3, 1000)
    >>> round(1e6 * rig.manipulator.position(3)), rig.clock.now()
    (976, 10.0)
    """
    if dialect not in DIALECTS:
        raise InputError(InputIssue(f"give one of {', '.join(DIALECTS)}", column="dialect", value=dialect))
    return EmulatedRig(DIALECTS[dialect](Manipulator(truth), clock or VirtualClock(), period))


class EmulatedOperator:
    """Passes everything on to an operator, and carries out their actions at the emulated rig.

    The plan says when its sessions begin, and how long an adjustment takes.
    """

    def __init__(self, operator: Operator, manipulator: Manipulator, clock: Clock, plan: Plan) -> None:
        self.operator = operator
        self.manipulator = manipulator
        self.clock = clock
        self.plan = plan
        # What the manipulator has no part in.
        self.show, self.stop_wanted = operator.show, operator.stop_wanted
        self.begin_drive, self.progress = operator.begin_drive, operator.progress

    def begin_session(self, label: str) -> OperatorReply:
        """See `Operator.begin_session`."""
        reply = self.operator.begin_session(label)
        begins = next(session.begins for session in self.plan.sessions if session.label == label)
        self.clock.sleep((begins.replace(tzinfo=UTC) - self.clock.today()).total_seconds())
        self.manipulator.begin_session(label)
        return self._note(reply)

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        """See `Operator.set_up`."""
        reply = self._note(self.operator.set_up(wanted, before))
        if reply.choice is OperatorChoice.GO_ON:
            self.clock.sleep(sum(self.plan.timing.pause) / 2)
            self.manipulator.set(theta=wanted.theta, psi=wanted.psi)
            stops = self.manipulator.truth.machine.ranges | {joint: ends for joint, *ends in wanted.stops}
            for joint, (low, high) in stops.items():
                self.manipulator.set_stops(joint, low, high)
        return reply

    def bring_joint(self, joint: int, position: float) -> OperatorReply:
        """See `Operator.bring_joint`."""
        reply = self._note(self.operator.bring_joint(joint, position))
        if reply.choice is OperatorChoice.GO_ON:
            self.manipulator.set(**{f"q{joint}": position})
        return reply

    def review(self, reading: TraverseReading) -> OperatorReply:
        """See `Operator.review`."""
        return self._note(self.operator.review(reading))

    def handle_failure(self, drive: PlannedDrive, reason: str) -> OperatorReply:
        """See `Operator.handle_failure`."""
        return self._note(self.operator.handle_failure(drive, reason))

    def _note(self, reply: OperatorReply) -> OperatorReply:
        """Set the conditions of a reply."""
        self.manipulator.set(**reply.conditions)
        return reply
