"""EmulatedRig: controller, microphone and operator together, within this process or in one of its own.

`emulate_rig` sets up a rig in this process. `start_emulator` starts one whose controller is behind a
pseudo-terminal and whose operator is addressed through its standard input.
"""

from __future__ import annotations

import base64
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path
from typing import Any

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
    AudioSource,
    Clock,
    Controller,
    Detection,
    Samples,
    VirtualClock,
)
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.plan import Plan

STOP_LEVEL_DB, MOVING_LEVEL_DB = 20.0, 0.0  # dB


class EmulatedMicrophone:
    """A `Source` of the sound that the joints of an emulated controller make.

    Parameters
    ----------
    unit : Unit
    acoustics : Acoustics
        Of the same step period.
    rng : Generator
    """

    def __init__(self, unit: EmulatedController, acoustics: Acoustics, rng: np.random.Generator) -> None:
        self.rate = acoustics.rate
        self._unit = unit
        self._acoustics = acoustics
        self._rng = rng
        self._heard_until = unit.clock.now()

    def read(self, seconds: float) -> Samples:
        """See `Source.read`; whole step periods, at least one."""
        period, clock = self._acoustics.period, self._unit.clock
        slots = max(round(seconds / period), 1)
        self._heard_until = max(clock.now(), self._heard_until + slots * period)
        clock.sleep(self._heard_until - clock.now())
        began = self._heard_until - slots * period
        moving, at_stop = self._steps(began + (np.arange(slots) + 0.5) * period)
        return Samples(synthesize_sound(self._acoustics, began, moving, at_stop, self._rng))

    def close(self) -> None:
        """See `Source.close`."""

    def _steps(self, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether a step is made at each time, and whether it pushes against a stop."""
        self._unit.advance()
        moving, at_stop = np.zeros((2, len(middles)), bool)
        for made in reversed(self._unit.manipulator.made):
            if made.ended <= middles[0]:
                break
            number = np.floor((middles - made.began) / made.period)
            within = (number >= 0) & (number < made.steps)
            moving |= within
            at_stop |= within & (number >= made.moving)
        return moving, at_stop


class IdealDetector:
    """An `Ear` that knows at which step the stop was met."""

    def __init__(self, unit: EmulatedController) -> None:
        self._unit = unit
        self._heard_until = unit.clock.now()

    def begin(self) -> None:
        """See `Ear.begin`."""
        self._heard_until = self._unit.clock.now()

    def check(self, seconds: float) -> Detection:
        """See `Ear.check`."""
        self._unit.advance()
        at_stop = False
        for made in reversed(self._unit.manipulator.made):
            if made.ended <= self._heard_until + made.period / 2:
                break
            at_stop |= made.moving < made.steps
        self._heard_until = self._unit.clock.now()
        return Detection(at_stop, STOP_LEVEL_DB if at_stop else MOVING_LEVEL_DB)

    def close(self) -> None:
        """See `Ear.close`."""


DIALECTS: dict[str, type[EmulatedController]] = {"new": NewDialect, "old": OldDialect}
SOUND_STREAM = 2  # a stream of random numbers beside those of the truth


@dataclass(frozen=True, eq=False)
class EmulatedRig:
    """An emulated rig within this program, by a clock of its own.

    Attributes
    ----------
    unit : Unit
        Takes and gives the bytes of its dialect.
    """

    unit: EmulatedController

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
        line = LineTransport(EmulatedTransport(self.unit), self.clock, self.unit.ends)
        if isinstance(self.unit, OldDialect):
            return OldNanoControl(line, self.unit.period)
        return NanoControl(line, tell, self.unit.period)

    def microphone(self, acoustics: Acoustics) -> EmulatedMicrophone:
        """A source of what a microphone hears; `acoustics` with the unit's step period."""
        rng = np.random.default_rng([self.hands.truth.seed, SOUND_STREAM])
        return EmulatedMicrophone(self.unit, acoustics, rng)

    def perfect_ear(self) -> IdealDetector:
        """An ear that is always right."""
        return IdealDetector(self.unit)


def emulate_rig(
    truth: HiddenLaws, dialect: str = "new", clock: Clock | None = None, period: float = STEP_PERIOD
) -> EmulatedRig:
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
    >>> from stickslip_fit.simulation import LawValues
    >>> values = {(3, "+", None): np.array([976e-9, 0.3, 438e-9])}
    >>> rig = emulate_rig(HiddenLaws(LawValues({3: Prismatic()}, values), load_machine()))
    >>> controller = rig.controller(tell=print)
    >>> controller.step(3, 1000)
    >>> round(1e6 * rig.hands.position(3)), rig.clock.now()
    (976, 10.0)
    """
    if dialect not in DIALECTS:
        raise InputError(InputIssue(f"give one of {', '.join(DIALECTS)}", column="dialect", value=dialect))
    return EmulatedRig(DIALECTS[dialect](Manipulator(truth), clock or VirtualClock(), period))


class EmulatedOperator:
    """Passes everything on to a person, and does with the emulated rig what they have agreed to do.

    Parameters
    ----------
    person : Person
    hands : Manipulator
    clock : Clock
        Goes on while the person sets things and sleeps.
    plan : Plan
        Says when its sessions begin, and how long setting takes.
    """

    def __init__(self, operator: Operator, hands: Manipulator, clock: Clock, plan: Plan) -> None:
        self.operator = operator
        self.hands = hands
        self.clock = clock
        self.plan = plan

    def tell(self, text: str) -> None:
        """See `Person.tell`."""
        self.operator.tell(text)

    def begin_session(self, label: str) -> OperatorReply:
        """See `Person.begin_session`."""
        answer = self.operator.begin_session(label)
        begins = next(each.begins for each in self.plan.sessions if each.label == label)
        self.clock.sleep((begins.replace(tzinfo=UTC) - self.clock.today()).total_seconds())
        self.hands.begin_session(label)
        self.hands.set(**answer.conditions)
        return answer

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        """See `Person.set_up`."""
        answer = self.operator.set_up(wanted, before)
        self.hands.set(**answer.conditions)
        if answer.choice is OperatorChoice.GO_ON:
            self.clock.sleep(sum(self.plan.timing.pause) / 2)
            self.hands.set(theta=wanted.theta, psi=wanted.psi)
            stops = self.hands.truth.machine.ranges | {joint: ends for joint, *ends in wanted.stops}
            for joint, (low, high) in stops.items():
                self.hands.set_stops(joint, low, high)
        return answer

    def bring(self, joint: int, position: float) -> OperatorReply:
        """See `Person.bring`."""
        answer = self.operator.bring(joint, position)
        self.hands.set(**answer.conditions)
        if answer.choice is OperatorChoice.GO_ON:
            self.hands.set(**{f"q{joint}": position})
        return answer

    def begins(self, work: PlannedDrive) -> None:
        """See `Person.begins`."""
        self.operator.begins(work)

    def progress(self, work: PlannedDrive, steps: int, heard: Detection) -> None:
        """See `Person.progress`."""
        self.operator.progress(work, steps, heard)

    def stop_wanted(self) -> bool:
        """See `Person.stop_wanted`."""
        return self.operator.stop_wanted()

    def reading(self, reading: TraverseReading) -> OperatorReply:
        """See `Person.reading`."""
        answer = self.operator.reading(reading)
        self.hands.set(**answer.conditions)
        return answer

    def trouble(self, work: PlannedDrive, why: str) -> OperatorReply:
        """See `Person.trouble`."""
        answer = self.operator.trouble(work, why)
        self.hands.set(**answer.conditions)
        return answer


MAX_READ_BYTES = 65_536


def serve_rig(rig: EmulatedRig, microphone: AudioSource, orders: int, answer: Callable[[str], None]) -> None:
    """Serve until the orders end.

    Parameters
    ----------
    rig : Emulator
        By the real clock.
    microphone : Source
    orders : int
        File descriptor of what the person does: one JSON object a line, see `obeyed`.
    answer : callable
        Is given a line for each order, and before them all the pseudo-terminal's name: ``{"port": NAME}``.
    """
    import pty
    import tty

    master, slave = pty.openpty()
    try:
        tty.setraw(slave)
        answer(json.dumps({"port": os.ttyname(slave)}))
        _serve_loop(rig, microphone, master, orders, answer)
    finally:
        os.close(slave)
        os.close(master)


def _serve_loop(
    rig: EmulatedRig, microphone: AudioSource, master: int, orders: int, answer: Callable[[str], None]
) -> None:
    begun = b""
    while True:
        due = rig.unit.due()
        seconds = None if due is None else max(due - rig.clock.now(), 0.0)
        ready, _, _ = select.select([master, orders], [], [], seconds)
        if master in ready:
            rig.unit.take(os.read(master, MAX_READ_BYTES))
        if orders in ready:
            come = os.read(orders, MAX_READ_BYTES)
            if not come:
                return
            *lines, begun = (begun + come).split(b"\n")
            for line in lines:
                answer(json.dumps(_answer_line(rig, microphone, line)))
        os.write(master, rig.unit.send())


def _answer_line(rig: EmulatedRig, microphone: AudioSource, line: bytes) -> dict[str, Any]:
    try:
        return execute_order(rig, microphone, json.loads(line))
    except (ValueError, TypeError) as error:
        return {"error": f"{line.decode('utf-8', 'replace')!r} is no order: {error}"}
    except InputError as error:
        return {"error": str(error)}


def execute_order(rig: EmulatedRig, microphone: AudioSource, order: dict[str, Any]) -> dict[str, Any]:
    """Carry out an order, and answer it.

    Parameters
    ----------
    rig : Emulator
    microphone : Source
    order : dict
        One of ``{"set": {"theta": ..., "q2": ...}}``, ``{"stops": [joint, low, high]}`` (SI),
        ``{"session": LABEL}``, ``{"listen": SECONDS}``, ``{"position": JOINT}``.

    Returns
    -------
    dict
        ``{"sound": ...}``, float32 in base 64; ``{"position": ...}``; or ``{}``.

    Raises
    ------
    InputError
        For anything else, or what cannot be done.
    """
    rig.unit.advance()
    match order:
        case {"set": dict(quantities)}:
            rig.hands.set(**{name: float(value) for name, value in quantities.items()})
        case {"stops": [joint, low, high]}:
            rig.hands.set_stops(int(joint), float(low), float(high))
        case {"session": str(label)}:
            rig.hands.begin_session(label)
        case {"listen": float(seconds) | int(seconds)}:
            return {"sound": base64.b64encode(microphone.read(seconds).values.tobytes()).decode("ascii")}
        case {"position": int(joint)}:
            return {"position": rig.hands.position(joint)}
        case _:
            raise InputError(f"no such order: {order}; give set, stops, session, listen or position")
    return {}


class EmulatedProcess:
    """A rig to be driven over its port, set by hand and listened to; see `emulator_process`.

    It is a `Source` of the sound that its joints make.

    Attributes
    ----------
    port : str
        The pseudo-terminal behind which its controller is, for `open_controller`.
    rate : int
        Samples of sound per second.
    """

    rate = Acoustics.rate

    def __init__(self, process: subprocess.Popen[str], port: str) -> None:
        self.port = port
        self._process = process

    def set(self, **quantities: float) -> None:
        """See `Manipulator.set`."""
        self._order({"set": quantities})

    def set_stops(self, joint: int, low: float, high: float) -> None:
        """See `Manipulator.set_stops`."""
        self._order({"stops": [joint, low, high]})

    def begin_session(self, label: str) -> None:
        """See `Manipulator.begin_session`."""
        self._order({"session": label})

    def position(self, joint: int) -> float:
        """See `Manipulator.position`."""
        return float(self._order({"position": joint})["position"])

    def read(self, seconds: float) -> Samples:
        """See `Source.read`."""
        sound = base64.b64decode(self._order({"listen": seconds})["sound"])
        return Samples(np.frombuffer(sound, np.float32))

    def close(self) -> None:
        """End the process; for its controller that is being unplugged."""
        self._process.kill()
        self._process.wait()

    def _order(self, order: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            print(json.dumps(order), file=self._process.stdin, flush=True)
            answer = self._process.stdout.readline()
        except OSError:
            answer = ""
        if not answer:
            raise InputError("the emulator has ended; start it again")
        answered = json.loads(answer)
        if "error" in answered:
            raise InputError(answered["error"])
        return answered


@contextmanager
def start_emulator(law: Path, *options: str) -> Iterator[EmulatedProcess]:
    """An emulated rig in a process of its own, by the real clock.

    Parameters
    ----------
    law : Path
        Law file by which it steps.
    *options : str
        Of ``python -m stickslip_fit.capture.emulator``, e.g. ``--dialect``, ``old``.

    Raises
    ------
    InputError
        If it does not come up; with what it says.
    """
    command = [sys.executable, "-m", "stickslip_fit.capture.emulator", str(law), *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        if not first:
            raise InputError(process.communicate()[1].strip())
        rig = EmulatedProcess(process, json.loads(first)["port"])
        try:
            yield rig
        finally:
            rig.close()
