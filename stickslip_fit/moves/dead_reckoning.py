"""Dead reckoning: the pose after a sequence of drives, its uncertainty, and when to go back to a stop.

Errors of a law's parameters are common to all drives of a joint and direction and add up; the
repeatability is independent in each drive. Each command is one drive, as one row of a log is: cut into many,
its noise would average away, which no repeatability of whole drives promises. Where a drive is made in
bursts, as by hand, `incremental.DriveReckoning` holds the noise for the whole drive.
A drive into a stop makes the joint's position known again.
The position after N steps is the root of the law's counts, by Newton's method.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError, check_count
from stickslip_fit.estimation import Result
from stickslip_fit.laws import Rows, StepLaw, float_column
from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves.arm import CalibratedArm, as_calibrated_arm, check_positions
from stickslip_fit.moves.error_ellipsoid import error_radius
from stickslip_fit.simulation.truth import Group
from stickslip_fit.units import JOINTS, Z_95

MAX_ITERATIONS = 60
STEP_TOL = 1e-6  # of a step; the last Newton step makes the error far smaller


def position_after(law: StepLaw, rows: Rows, values: Array, steps: npt.ArrayLike) -> Array:
    """Positions of the moving joint after so many steps of each traverse, rad or m, shape (n,).

    Solves counts(start, x) = steps for x by Newton's method, with derivative 1 / step size, safeguarded by
    bisection.

    Parameters
    ----------
    rows : mapping of str to array, shape (n,)
        Traverses in a log's columns; a joint that reaches its row's stop stays there.
    values : array, shape (p,) or (n, p)
        The law's parameters.
    steps : array_like, shape (n,) or ()
        0 or more, not necessarily whole.

    Raises
    ------
    InputError
        If a joint stalls.

    Examples
    --------
    >>> from stickslip_fit.laws import Prismatic
    >>> rows = {"q2": [-np.pi / 2] * 3, "theta": [0.0] * 3, "psi": [0.0] * 3, "start": [0.0] * 3}
    >>> values = np.array([976e-9, 0.3, 438e-9])
    >>> position_after(Prismatic(), rows | {"stop": [0.012] * 3}, values, [0, 1000, 20000]).round(9)
    array([0.      , 0.000976, 0.012   ])
    """
    start, stop = float_column(rows, "start"), float_column(rows, "stop")
    values = np.broadcast_to(values, (len(start), len(law.parameters)))
    columns = {name: np.asarray(rows[name]) for name in (*law.columns, "start", "stop") if name in rows}
    steps = np.broadcast_to(np.asarray(steps, float), start.shape)
    sign, total = np.sign(stop - start), np.abs(stop - start)
    lower, upper = np.zeros(len(start)), np.full(len(start), np.inf)
    gamma = law.step_size(columns, start[:, None], values)[:, 0]
    travelled = np.minimum(steps * gamma, total)
    active = np.flatnonzero((steps > 0) & (total > 0))
    _check_no_stall(law, gamma[active])
    for _ in range(MAX_ITERATIONS):
        rows_here, distance = {name: of[active] for name, of in columns.items()}, travelled[active]
        position = rows_here["start"] + sign[active] * distance
        excess = _traverse_counts(law, rows_here | {"stop": position}, values[active]) - steps[active]
        gamma = law.step_size(rows_here, position[:, None], values[active])[:, 0]
        _check_no_stall(law, np.where(np.isnan(excess), 0.0, gamma))
        lower[active] = np.where(excess > 0, lower[active], distance)
        upper[active] = np.where(excess > 0, distance, upper[active])
        newton = distance - excess * gamma
        bisection = (lower[active] + np.minimum(upper[active], total[active])) / 2
        newton = np.where((newton < lower[active]) | (newton > upper[active]), bisection, newton)
        travelled[active] = np.minimum(newton, total[active])
        active = active[np.abs(travelled[active] - distance) > STEP_TOL * gamma]
        if not len(active):
            break
    return np.where(travelled >= total, stop, start + sign * travelled)


def _traverse_counts(law: StepLaw, rows: Rows, values: Array) -> Array:
    """Steps of each traverse; with those that a cause adds they may be 0 or negative."""
    return law.steps(rows)(values) if isinstance(law, ExtendedLaw) else law.counts(rows, values)[0]


def _check_no_stall(law: StepLaw, gamma: Array) -> None:
    if not np.all(gamma > 0):
        raise InputError(
            f"joint {law.joint} comes to a halt on its way: its law gives a step size of zero or less there"
        )


@dataclass(frozen=True)
class DriveCommand:
    """So many steps of one joint in one direction; InputError for what no controller can do."""

    joint: int
    direction: str
    steps: int

    def __post_init__(self) -> None:
        if self.direction not in ("+", "-"):
            raise InputError(f"the direction of a drive must be '+' or '-', not {self.direction!r}")
        check_count("steps", self.steps, least=0)


@dataclass(frozen=True)
class PoseEstimate:
    """The pose after a sequence of drives.

    Attributes
    ----------
    q, q_error : array, shape (3,)
        Joint positions and their standard deviations, rad, rad, m.
    tip : array, shape (3,)
        Base frame, m.
    tip_covariance : array, shape (3, 3)
        m^2.
    at_stop : tuple of int
        Joints whose last drive took them into a mechanical stop: their error is none again.
    history : mapping of int to mapping of str to object
        What each joint's next drive follows, see `Calibrated`.
    """

    q: Array
    q_error: Array
    tip: Array
    tip_covariance: Array
    at_stop: tuple[int, ...]
    history: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def tip_radius(self) -> float:
        """Radius about `tip` that holds 95 % of its errors, m, see `error_radius`."""
        return float(error_radius(self.tip_covariance))


_Displacement = tuple[float, Array]
"""A drive's signed displacement, and the derivatives of its logarithm by the law's parameters."""


def dead_reckon(
    arm: CalibratedArm | Result, start: npt.ArrayLike, drives: Sequence[DriveCommand]
) -> PoseEstimate:
    """The pose after a sequence of drives, with its uncertainty.

    Errors of a law's parameters are the same in every drive of its joint and direction and add up; the
    repeatability is that of one command, and independent of the others': do not cut a drive into commands
    for its accuracy, see `DriveReckoning`. A drive that reaches a stop with certainty ends there without
    error. Each drive's history is the joint's previous one.

    Parameters
    ----------
    arm : CalibratedArm or Result
        A Result stands for its latest session, see `calibrated_arm`.
    start : array_like, shape (3,)
        Joint positions, rad, rad, m, taken as exact; best at stops.
    drives : sequence of DriveCommand

    Raises
    ------
    InputError
        If a drive may or may not have reached the stop, so that the joint's position is unknown.
    """
    arm, q = as_calibrated_arm(arm), np.array(start, dtype=float)
    check_positions(arm.machine, q, "start")
    displacements: dict[Group, list[_Displacement]] = {}
    at_stop: set[int] = set()
    for drive in drives:
        joint = drive.joint
        position, displacement = _follow_drive(arm, q, drive, _joint_variance(arm, joint, displacements))
        if position != q[joint - 1]:
            arm = arm.after_drive(arm.drive_row(q, joint, position), drive.steps)
        q[joint - 1] = position
        if displacement is None:
            displacements = {group: own for group, own in displacements.items() if group[0] != joint}
            at_stop.add(joint)
        else:
            at_stop.discard(joint)
            displacements.setdefault((joint, drive.direction), []).append(displacement)
    variance = np.array([_joint_variance(arm, joint, displacements) for joint in JOINTS])
    tip, slope = forward(arm.machine, q), jacobian(arm.machine, q)
    tip_covariance = slope @ np.diag(variance) @ slope.T
    return PoseEstimate(q, np.sqrt(variance), tip, tip_covariance, tuple(sorted(at_stop)), arm.history)


def steps_before_recalibration(
    arm: CalibratedArm, pose: PoseEstimate, joint: int, direction: str, tolerance: float
) -> int | None:
    """Further steps of a joint until the tip's 95 % radius exceeds a tolerance in m.

    0 where it exceeds the tolerance now; None where the joint reaches its stop first.
    """
    low, high = arm.machine.ranges[joint]
    end = high if direction == "+" else low
    if end == pose.q[joint - 1]:
        return None
    if pose.tip_radius > tolerance:
        return 0
    arm = replace(arm, history=pose.history)
    lever = jacobian(arm.machine, pose.q)[:, joint - 1]
    relative = arm.joint_travel(pose.q, joint, end).spread ** 2 * np.outer(lever, lever)

    def excess(travel: float) -> float:
        covariance = pose.tip_covariance + relative * travel**2
        return float(error_radius(covariance)) - tolerance

    distance = abs(end - pose.q[joint - 1])
    if excess(distance) <= 0:
        return None
    from scipy.optimize import brentq

    stop = pose.q[joint - 1] + np.sign(end - pose.q[joint - 1]) * brentq(excess, 0.0, distance)
    return int(arm.joint_travel(pose.q, joint, float(stop)).counts)


def _follow_drive(
    arm: CalibratedArm, q: Array, drive: DriveCommand, variance: float
) -> tuple[float, _Displacement | None]:
    """A joint's position after a drive, and its displacement; None at a stop."""
    low, high = arm.machine.ranges[drive.joint]
    end = high if drive.direction == "+" else low
    position = float(q[drive.joint - 1])
    if position == end:
        return end, None
    travel = arm.joint_travel(q, drive.joint, end)
    counts = travel.counts
    margin = Z_95 * float(np.hypot(travel.spread, np.sqrt(variance) / abs(end - position))) * counts
    if drive.steps >= counts + margin:
        return end, None
    if drive.steps > counts - margin:
        raise InputError(
            f"{drive.steps} steps of joint {drive.joint} in {drive.direction} may or may not reach its stop "
            f"({counts:.0f} ± {margin:.0f} steps away): drive {counts + margin:.0f} or more to be at "
            f"the stop for sure, or {counts - margin:.0f} or fewer to stay short of it"
        )
    final = float(position_after(travel.law, travel.row, travel.values, drive.steps)[0])
    return final, (final - position, arm.joint_travel(q, drive.joint, final).slopes)


def _joint_variance(
    arm: CalibratedArm, joint: int, displacements: Mapping[Group, Sequence[_Displacement]]
) -> float:
    """Variance of a joint's position after drives, rad^2 or m^2."""
    total = 0.0
    for group, own in displacements.items():
        if group[0] == joint:
            _, _, covariance, repeatability = arm.law(*group)
            gradient = sum(distance * slopes for distance, slopes in own)
            total += float(gradient @ covariance @ gradient)
            total += sum((repeatability * distance) ** 2 for distance, _ in own)
    return total
