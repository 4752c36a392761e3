"""A drive at a rig, real or emulated: puts together rig, input, screen and journal, and says how it ended."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import typer

from stickslip_fit._format import format_number, join_words
from stickslip_fit._typing import Array
from stickslip_fit.capture.audio import Microphone
from stickslip_fit.capture.devices import open_controller
from stickslip_fit.capture.end_stop import SequentialDetector
from stickslip_fit.capture.nanocontrol import COMMAND_SECONDS
from stickslip_fit.capture.protocols import Clock, Controller, EndStopDetector, RealClock
from stickslip_fit.capture.terminal import Keyboard
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.capture.tuning import check_tuning, load_tuning
from stickslip_fit.drive.homing import HomingLog, StopFinder
from stickslip_fit.drive.keyboard import HELP, MAX_SPEED, KeyboardDevice
from stickslip_fit.drive.loop import DriveLoop, StepTiming
from stickslip_fit.drive.page import serve_drive_page
from stickslip_fit.drive.picture import draw_arm
from stickslip_fit.drive.record import BurstRecord, begin_record, resume_record
from stickslip_fit.drive.screen import (
    NO_ADVICE,
    Screens,
    ScreenThread,
    TerminalScreen,
    format_advice,
    format_count,
    format_um,
)
from stickslip_fit.drive.script import ScriptDevice, read_script
from stickslip_fit.drive.state import DriveState, InputDevice, Screen
from stickslip_fit.drive.sticks import StickDevice, open_gamepad, open_spacemouse
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.machine import forward
from stickslip_fit.moves import CalibratedArm, DriveReckoning

STICKS = {"gamepad": open_gamepad, "spacemouse": open_spacemouse}
STICK_HELP = "tip along x and y by the (left) stick, z by the right one; start, or the second button, ends"


@dataclass(frozen=True, eq=False)
class DriveJob:
    """What is to be driven, by which input, and what is kept.

    Attributes
    ----------
    start : array, shape (3,), or None
        rad, rad, m; None for a drive that is resumed.
    tolerance : float
        Of the tip's 95 % radius, m.
    script : Path or None
        Velocities; without them a person drives.
    device : {'keyboard', 'gamepad', 'spacemouse', 'page'}
        What they drive by.
    page_port : int
        Of the page, 0 for any free one.
    speed : float
        Of the tip by a key or at full deflection, m/s.
    hold : float
        How long a key press moves, s.
    step_period : float
        Of the controller, s.
    """

    arm: CalibratedArm
    start: Array | None
    tolerance: float
    journal: Path | None
    log: Path | None
    script: Path | None
    device: str
    page_port: int
    speed: float
    hold: float
    step_period: float


@dataclass(frozen=True, eq=False)
class DriveInput:
    """An input device, whether the person interrupts a going home, lines of help, and screens of its own."""

    device: InputDevice
    interrupts: Callable[[float], bool]
    help_lines: tuple[str, ...] = ()
    screens: tuple[Screen, ...] = ()


@dataclass(frozen=True, eq=False)
class DriveRig:
    """Controller, clock, timing and, to go home by, an end-stop detector."""

    controller: Controller
    clock: Clock
    timing: StepTiming
    detector: EndStopDetector | None


def timing_of(dialect: str, step_period: float) -> StepTiming:
    """How long steps take: the old dialect's slow line takes as long for a command as for a step."""
    return StepTiming(step_period, COMMAND_SECONDS if dialect == "old" else 0.0)


@contextmanager
def open_record(job: DriveJob) -> Iterator[tuple[BurstRecord, DriveReckoning]]:
    """Begin or resume a drive and its journal.

    Raises
    ------
    InputError
        If a journal exists, or is to be resumed and does not; as `begin_record` and `resume_record`.
    """
    if job.log is not None and job.log.exists():
        raise InputError(InputIssue("exists and would be written over; name another log", str(job.log)))
    if job.start is None:
        assert job.journal is not None  # the command asks for it
        record, drive = resume_record(job.journal, job.arm)
    else:
        drive = DriveReckoning(job.arm, job.start)
        record = begin_record(job.journal, drive)
    try:
        yield record, drive
    finally:
        record.close()


@contextmanager
def open_input(job: DriveJob) -> Iterator[DriveInput]:
    """The input device: a script, which waits while a joint goes home, or what a person drives by."""
    if job.script is not None:
        yield DriveInput(ScriptDevice(read_script(job.script)), lambda now: False)
        return
    if job.device in STICKS:
        stick = StickDevice(STICKS[job.device], job.speed)
        try:
            yield DriveInput(stick, partial(wants_something, stick), (f"{job.device}: {STICK_HELP}",))
        finally:
            stick.close()
        return
    if job.device == "page":
        title = f"session {job.arm.session}"
        with serve_drive_page(job.arm.machine, title, MAX_SPEED, job.page_port) as page:
            typer.echo(f"open {page.address}")
            yield DriveInput(page, page.interrupts, (f"open {page.address}",), (page,))
        return
    with Keyboard() as keys:
        if not keys.at_terminal:
            raise InputError("keys can be pressed at a terminal only; drive there, or by --script")
        keyboard = KeyboardDevice(keys.take, job.speed, job.hold)
        yield DriveInput(keyboard, partial(wants_something, keyboard), HELP)


def wants_something(device: InputDevice, now: float) -> bool:
    """Whether a person commands anything, if only to stand still."""
    wanted = device.read(now)
    return wanted.ends or wanted.tip_velocity is not None or wanted.joint_velocity is not None


def run_drive(
    job: DriveJob, rig: DriveRig, record: BurstRecord, drive: DriveReckoning, inputs: DriveInput
) -> DriveState:
    """Run a drive to its end, shown in the terminal."""
    terminal = TerminalScreen(inputs.help_lines, lambda state, *size: draw_arm(state, job.arm.machine, *size))
    with ExitStack() as closing:
        closing.callback(terminal.close)
        screen: Screen = Screens((terminal, *inputs.screens))
        age: Callable[[], float] = lambda: 0.0  # noqa: E731
        if isinstance(rig.clock, RealClock) and sys.stdout.isatty():
            thread = ScreenThread(screen, rig.clock.now)
            closing.callback(thread.close)
            screen, age = thread, thread.age
        how = (job.tolerance, rig.timing, age)
        loop = DriveLoop(drive, rig.controller, rig.clock, inputs.device, screen, record, *how)
        if rig.detector is not None:
            loop.homing = StopFinder(
                drive=drive,
                rig=Rig(rig.controller, rig.detector, rig.clock),
                record=record,
                log=HomingLog(job.log, job.arm.machine),
                seconds=lambda: loop.seconds,
                interrupted=lambda: inputs.interrupts(rig.clock.now()) or loop.screen_is_frozen,
                progress=loop.show,
                step_period=rig.timing.step_period,
            )
        return loop.run()


def drive_real(job: DriveJob, port: str, dialect: str, device: str | None, tuning: Path | None) -> str:
    """Drive a real rig; how it ended, in sentences."""
    with ExitStack() as opened:
        inputs = opened.enter_context(open_input(job))
        record, drive = opened.enter_context(open_record(job))
        detector = None
        if tuning is not None:
            tuned = load_tuning(tuning)
            check_tuning(tuned, tuning)
            microphone = Microphone(device)
            opened.callback(microphone.close)
            detector = SequentialDetector(microphone, tuned)
        # What the controller says unasked would break the screen; it answers every command anyway.
        controller = open_controller(port, dialect, lambda message: None, job.step_period)
        opened.callback(controller.close)
        rig = DriveRig(controller, RealClock(), timing_of(dialect, job.step_period), detector)
        return summarize_drive(run_drive(job, rig, record, drive, inputs), job)


def summarize_drive(state: DriveState, job: DriveJob) -> str:
    """Where the tip is, how surely, and what to do, in sentences."""
    steps = join_words([format_count(count) for count in state.steps])
    sentences = [
        f"Tip at {format_tip(state.tip)}, within {format_um(state.tip_radius)} (95 %); the tolerance is "
        f"{format_um(state.tolerance)}.",
        f"Joints 1, 2 and 3 made {steps} steps in {state.time:.1f} s, those in − taken off.",
        f"Advice: {format_advice(state) or f'{NO_ADVICE}.'}",
    ]
    if state.message:
        sentences.append(f"Last: {state.message}.")
    if job.journal is not None:
        sentences.append(f"The journal {job.journal} keeps the position; --resume goes on.")
    return "\n".join(sentences)


def summarize_truth(state: DriveState, positions: Array, job: DriveJob) -> str:
    """How far off the estimate is at an emulated rig, whose joints are known."""
    tip = forward(job.arm.machine, positions)
    off = format_um(float(np.linalg.norm(tip - state.tip)))
    return f"Emulated: the tip truly is at {format_tip(tip)}, {off} from where it is taken to be."


def format_tip(tip: Array) -> str:
    """A tip position for people, to a tenth of a micrometre."""
    return "({}) mm".format(", ".join(format_number(float(x), "mm", 4) for x in tip))
