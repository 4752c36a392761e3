"""Captures and tunings at a real rig: opens it, tunes its detector, runs a campaign.

How `emulator.campaign` does the same at an emulated rig is no part of this module, which knows no law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from stickslip_fit.capture.audio import Microphone, read_wav
from stickslip_fit.capture.campaign import Campaign, begin_journal, resume_journal
from stickslip_fit.capture.devices import open_controller
from stickslip_fit.capture.end_stop import SequentialDetector
from stickslip_fit.capture.journal import Journal, JournalReplay
from stickslip_fit.capture.operator import CountPredictor, Operator, keep_operator
from stickslip_fit.capture.protocols import AudioSource, Clock, Controller, RealClock
from stickslip_fit.capture.terminal import Keyboard, TerminalOperator
from stickslip_fit.capture.traverse import DriveLimits, Rig
from stickslip_fit.capture.tuning import Tuning, check_tuning, choose_tuning, load_tuning, record_joint
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import Machine

TUNING_CHECKS = 60  # of a recording: 3 s with 5 steps of 10 ms


@dataclass(frozen=True, eq=False)
class CaptureJob:
    """What is to be captured, and into which log; see `Campaign`."""

    plan: Plan
    machine: Machine
    log: Path
    resuming: bool
    predictor: CountPredictor | None
    count_predictor: CountPredictor | None
    drive_limits: DriveLimits
    conditions: Mapping[str, float]


@dataclass(frozen=True)
class RigConnection:
    """Port and dialect of the controller, and the microphone, of a real rig."""

    port: str
    dialect: str
    device: str | None


def capture_real(
    job: CaptureJob,
    connection: RigConnection,
    tuning: Path,
    watch: Callable[[Operator], Operator] = keep_operator,
) -> str:
    """Capture a plan at a real rig; a sentence on how far it got, raises as `run_campaign`.

    `watch` gives an operator that passes everything on, and may show it elsewhere.
    """
    tuned = load_tuning(tuning)
    check_tuning(tuned, tuning)
    with Keyboard() as keys, open_journal(job) as (journal, replay):
        operator = watch(TerminalOperator(keys))
        with open_rig(connection, job.plan.timing.step_period, operator) as (controller, source):
            rig = Rig(controller, SequentialDetector(source, tuned), RealClock())
            return run_campaign(job, journal, replay, rig, operator)


@contextmanager
def open_journal(job: CaptureJob) -> Iterator[tuple[Journal, JournalReplay]]:
    """Begin or continue the journal of a capture."""
    journal, replay = resume_journal(job.log) if job.resuming else begin_journal(job.log)
    with journal:
        yield journal, replay


def run_campaign(
    job: CaptureJob, journal: Journal, replay: JournalReplay, rig: Rig, operator: Operator
) -> str:
    """Run a campaign; a sentence on how far it got.

    Raises
    ------
    InputError
        As `Campaign.run`, and if it ends early without having recorded a reading.
    """
    before = replay.made
    inputs = (job.plan, job.machine, job.log, journal, replay, rig, operator)
    complete = Campaign(*inputs, job.predictor, job.count_predictor, job.drive_limits, job.conditions).run()
    total = job.plan.traverses_per_session * len(job.plan.sessions)
    progress = f"{len(replay.finished):,} of {total:,} traverses are done; the log is {job.log}"
    if not replay.made or (replay.made == before and not complete):
        raise InputError(
            f"no traverse was recorded; {'all are left out' if complete else 'go on with --resume'}"
        )
    return progress if complete else f"{progress}; --resume goes on"


@contextmanager
def open_rig(
    connection: RigConnection, step_period: float, operator: Operator
) -> Iterator[tuple[Controller, AudioSource]]:
    """Open the controller and the microphone of a real rig."""
    microphone = Microphone(connection.device)
    try:
        controller = open_controller(connection.port, connection.dialect, operator.show, step_period)
        try:
            yield controller, microphone
        finally:
            controller.close()
    finally:
        microphone.close()


def tune_at_rig(connection: RigConnection, joint: int, check_every: int, step_period: float) -> Tuning:
    """Tune the detector at a real rig, with an operator who says when the joint has met its stop."""
    with Keyboard() as keys:
        if not keys.at_terminal:
            raise InputError(
                "a key has to be pressed when the joint has met its stop: tune at a terminal, or from "
                "recordings with --moving and --at-stop"
            )
        operator = TerminalOperator(keys)
        with open_rig(connection, step_period, operator) as (controller, microphone):
            return tune_by_hand(controller, microphone, RealClock(), joint, check_every, keys, operator)


def tune_by_hand(
    controller: Controller,
    source: AudioSource,
    clock: Clock,
    joint: int,
    check_every: int,
    keys: Keyboard,
    operator: Operator,
) -> Tuning:
    """Record a joint that moves freely, then at its stop, which the operator says it has met.

    Raises
    ------
    InputError
        If nobody says so before the joint must have met it.
    """
    operator.show(f"Bring joint {joint} well away from its stops by hand, and be quiet.\n  [Enter listens]")
    keys.key()
    moving = record_joint(controller, source, clock, joint, TUNING_CHECKS, check_every)
    operator.show(f"Joint {joint} goes - now.\n  [press a key when it has met its stop]")
    for _ in range(DriveLimits().max_steps // check_every):
        if keys.pressed():
            break
        controller.step(joint, -check_every)
    else:
        raise InputError("nobody said that the joint has met its stop; tune again")
    at_stop = record_joint(controller, source, clock, joint, TUNING_CHECKS, -check_every)
    return choose_tuning(moving, at_stop, source.rate, len(moving) / TUNING_CHECKS / source.rate)


def tune_from_recordings(moving: Path, at_stop: Path, seconds: float) -> Tuning:
    """Tune the detector by recordings of the moving joint and of the joint at its stop.

    Raises
    ------
    InputError
        If the recordings differ in their sample rate; as `read_wav` and `choose_tuning`.
    """
    freely, pushing = read_wav(moving), read_wav(at_stop)
    if freely.rate != pushing.rate:
        rates = f"has {pushing.rate:,} samples per second and {moving} has {freely.rate:,}"
        raise InputError(InputIssue(f"{rates}; record both alike", str(at_stop)))
    return choose_tuning(freely.values, pushing.values, freely.rate, seconds)
