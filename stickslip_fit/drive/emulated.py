"""A drive at an emulated rig, within this program.

Its true laws are drawn from the uncertainty of the calibration, so that the drive shows what the calibration
promises; or they are those of a law file, for a manipulator that has changed since. In both, a joint deviates
in each direction by one relative error that is held for the drive, until it meets a stop.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import EmulatedRig, emulate_rig
from stickslip_fit.capture.protocols import STEP_PERIOD, Clock, RealClock, VirtualClock
from stickslip_fit.drive.session import (
    DriveJob,
    DriveRig,
    open_input,
    open_record,
    run_drive,
    summarize_drive,
    summarize_truth,
    timing_of,
)
from stickslip_fit.logs.plan import Noise
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.moves import CalibratedArm, DriveReckoning
from stickslip_fit.moves.arm import invert_covariance, scale_covariance
from stickslip_fit.moves.incremental import GROUPS
from stickslip_fit.simulation import LawValues
from stickslip_fit.units import JOINTS


def drive_emulated(job: DriveJob, truth: LawValues | None, dialect: str, seed: int) -> str:
    """Drive an emulated rig; how it ended, in sentences. A script takes no time."""
    with ExitStack() as opened:
        inputs = opened.enter_context(open_input(job))
        record, drive = opened.enter_context(open_record(job))
        real = RealClock()
        clock = real if job.script is None else VirtualClock(real.today())
        settings = (seed, dialect, job.step_period, record.seconds)
        rig = emulate_drive(drive, truth, clock, *settings)
        controller = rig.controller(lambda message: None)
        timing = timing_of(dialect, job.step_period)
        drive_rig = DriveRig(controller, clock, timing, rig.ideal_detector())
        state = run_drive(job, drive_rig, record, drive, inputs)
        return f"{summarize_drive(state, job)}\n{summarize_truth(state, true_joints(rig), job)}"


def emulate_drive(
    drive: DriveReckoning,
    truth: LawValues | None,
    clock: Clock,
    seed: int = 0,
    dialect: str = "new",
    step_period: float = STEP_PERIOD,
    seconds: float = 0.0,
) -> EmulatedRig:
    """An emulated rig whose joints stand where a drive takes them to be, so many seconds after it began.

    Without a `truth` its laws are those of `draw_laws`.
    """
    arm, rng = drive.arm, np.random.default_rng(seed)
    groups = [group for group in GROUPS if group[0] in arm.result.joints]
    noise = Noise({group: arm.law(*group)[3] for group in groups})
    hidden = HiddenLaws(truth or draw_laws(arm, rng), arm.machine, noise, seed)
    rig = emulate_rig(hidden, dialect, clock, step_period)
    manipulator = rig.manipulator
    positions = {f"q{joint}": drive.q[joint - 1] for joint in JOINTS}
    conditions = {name: value for name, value in arm.conditions.items() if name in CONDITIONS}
    manipulator.set(theta=arm.theta, psi=arm.psi, **positions, **conditions)
    began = clock.now() - seconds - float(arm.conditions.get("session_seconds", 0.0))
    manipulator.begin_session(arm.session, began)
    manipulator.begin_drive()
    return rig


def true_joints(rig: EmulatedRig) -> Array:
    """The joints' true positions, rad, rad, m."""
    return np.array([rig.manipulator.position(joint) for joint in JOINTS])


def draw_laws(arm: CalibratedArm, rng: np.random.Generator) -> LawValues:
    """True laws that a calibration admits: its parameters, with errors drawn from their covariance.

    Parameters of causes are the same in all joints and directions; the others are drawn given these.
    """
    values: dict[tuple[int, str, str | None], Array] = {}
    shared: Array | None = None
    for joint, direction in (group for group in GROUPS if group[0] in arm.result.joints):
        fit = arm.result.joints[joint]
        _, own, covariance, _ = arm.law(joint, direction)
        q = len(own) - len(fit.cause_parameters)
        if shared is None:
            shared = _draw(covariance[q:, q:], rng)
        gain = covariance[:q, q:] @ invert_covariance(covariance[q:, q:])
        rest = covariance[:q, :q] - gain @ covariance[q:, :q]
        error = np.concatenate([gain @ shared + _draw(rest, rng), shared])
        values[joint, direction, None] = own + error
    return LawValues({joint: fit.law for joint, fit in arm.result.joints.items()}, values)


def _draw(covariance: Array, rng: np.random.Generator) -> Array:
    if not len(covariance):
        return np.zeros(0)
    scale, correlation = scale_covariance(covariance)
    return scale * rng.multivariate_normal(np.zeros(len(scale)), correlation, method="svd")
