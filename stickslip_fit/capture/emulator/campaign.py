"""Captures and tunings at an emulated rig, whose laws may have hidden causes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC

import numpy as np

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import EmulatedOperator, emulate_rig
from stickslip_fit.capture.end_stop import SequentialDetector
from stickslip_fit.capture.journal import JournalReplay
from stickslip_fit.capture.operator import Operator, keep_operator
from stickslip_fit.capture.protocols import (
    AudioSource,
    Clock,
    Controller,
    EndStopDetector,
    PacedClock,
    VirtualClock,
)
from stickslip_fit.capture.rigs import TUNING_CHECKS, CaptureJob, open_journal, run_campaign
from stickslip_fit.capture.terminal import Keyboard, TerminalOperator, UnattendedOperator
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.capture.tuning import Tuning, check_tuning, choose_tuning, record_joint
from stickslip_fit.causes import ExtendedLaw, library
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.plan import Noise, Plan
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.simulation import LawValues
from stickslip_fit.simulation.campaign import INITIAL_HISTORY

RETURN_CHECKS = 2 * TUNING_CHECKS  # checks that take a joint back to the stop it came from, and against it
RETRACTED_JOINT = 3  # the joint that an emulated rig has at its stop when it is switched on


@dataclass(frozen=True, eq=False)
class EmulationOptions:
    """Properties of an emulated rig; `pace` times as fast as the real time, at once where it is None."""

    laws: LawValues
    dialect: str
    ideal_detector: bool
    snr_db: float
    seed: int
    pace: float | None = None


def capture_emulated(
    job: CaptureJob,
    emulation: EmulationOptions,
    unattended: bool,
    watch: Callable[[Operator], Operator] = keep_operator,
) -> str:
    """Capture a plan at an emulated rig; a sentence on how far it got. `watch` as in `capture_real`."""
    with open_journal(job) as (journal, replay):
        if unattended:
            rig, operator = _emulate(job, emulation, replay, watch(UnattendedOperator()))
            return run_campaign(job, journal, replay, rig, operator)
        with Keyboard() as keys:
            rig, operator = _emulate(job, emulation, replay, watch(TerminalOperator(keys)))
            return run_campaign(job, journal, replay, rig, operator)


def _emulate(
    job: CaptureJob, emulation: EmulationOptions, replay: JournalReplay, operator: Operator
) -> tuple[Rig, Operator]:
    """An emulated rig with a tuned detector, and an operator whose actions are carried out there."""
    plan, period = job.plan, job.plan.timing.step_period
    truth = HiddenLaws(emulation.laws, job.machine, plan.noise or Noise({}), emulation.seed)
    begins = replay.last_time or plan.sessions[0].begins.replace(tzinfo=UTC)
    own_clock = PacedClock(emulation.pace, begins) if emulation.pace else VirtualClock(begins)
    rig = emulate_rig(truth, emulation.dialect, own_clock, period)
    controller, clock = rig.controller(operator.show), rig.clock
    rig.manipulator.set(**job.conditions)
    rig.manipulator.remember(replay.rows(), clock.today(), clock.now())
    detector: EndStopDetector = rig.ideal_detector()
    if not emulation.ideal_detector:
        microphone = rig.microphone(Acoustics(emulation.snr_db, period=period))
        tuning = tune_emulated(controller, microphone, clock, plan.check_every)
        check_tuning(tuning)
        operator.show(tuning.conclusion)
        detector = SequentialDetector(microphone, tuning)
    return Rig(controller, detector, clock), EmulatedOperator(operator, rig.manipulator, clock, plan)


def tune_at_emulated_rig(laws: LawValues, check_every: int, step_period: float, snr_db: float) -> Tuning:
    """Tune the detector at an emulated rig."""
    rig = emulate_rig(HiddenLaws(laws, load_machine()), period=step_period)
    microphone = rig.microphone(Acoustics(snr_db, period=step_period))
    return tune_emulated(rig.controller(print), microphone, rig.clock, check_every)


def tune_emulated(controller: Controller, source: AudioSource, clock: Clock, check_every: int) -> Tuning:
    """Record a joint that leaves its stop, and the same joint back at the stop."""
    moving = record_joint(controller, source, clock, RETRACTED_JOINT, TUNING_CHECKS, check_every)
    controller.step(RETRACTED_JOINT, -RETURN_CHECKS * check_every)
    at_stop = record_joint(controller, source, clock, RETRACTED_JOINT, TUNING_CHECKS, -check_every)
    return choose_tuning(moving, at_stop, source.rate, len(moving) / TUNING_CHECKS / source.rate)


def hide_causes(laws: LawValues, names: tuple[str, ...], plan: Plan, machine: Machine) -> LawValues:
    """Extend laws by causes, each of its first starting size; a law file can give any other size.

    Raises
    ------
    InputError
        For an unknown cause, one that depends on conditions that the emulator lacks, or if the laws have
        causes already.
    """
    if not names:
        return laws
    if any(isinstance(law, ExtendedLaw) for law in laws.laws.values()):
        raise InputError("the law file has causes in it already; leave --hide out, or take them out")
    rows = plan.rows().assign(**INITIAL_HISTORY)
    available = {cause.name: cause for cause in library() if set(CONDITIONS).isdisjoint(cause.columns)}
    causes = []
    for name in names:
        if name not in available:
            raise InputError(InputIssue(f"give one of {', '.join(available)}", column="--hide", value=name))
        trials = available[name].trials(rows)
        if not trials:
            message = "has no usual size; write it into a law file, and give that with --truth"
            raise InputError(InputIssue(message, column="--hide", value=name))
        causes.append(trials[0][0].bind(rows, machine))
    sizes = np.array([size for cause in causes for size in cause.scale])
    return LawValues(
        {joint: ExtendedLaw(law, tuple(causes)) for joint, law in laws.laws.items()},
        {key: np.append(values, sizes) for key, values in laws.values.items()},
        laws.day_to_day,
    )
