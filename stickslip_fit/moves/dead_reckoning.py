"""Dead reckoning: the pose after a sequence of drives, its uncertainty, and when to go back to a stop.

Errors of a law's parameters are common to all drives of a joint and direction and add up; the
repeatability is independent in each drive. A stop that is surely reached makes the joint's position
known again. The position after N steps is found by Newton's method on the law's counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Rows, StepLaw, float_column
from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves.arm import Z_95, CalibratedArm, check_positions

MAX_ITERATIONS = 60
STEP_TOL = 1e-6  # of a step; Newton's method doubles the digits once more as it settles


def position_after(law: StepLaw, rows: Rows, values: Array, steps: npt.ArrayLike) -> Array:
    """Positions of the moving joint after so many steps from where each traverse starts.

    Solves counts(start, x) = steps for x by Newton's method, whose derivative is 1 / step size, kept
    between what is known to be too short and too far.

    Parameters
    ----------
    law : StepLaw
    rows : mapping of str to array, shape (n,)
        Traverses in a log's columns; a joint that meets its row's stop stays there.
    values : array, shape (p,) or (n, p)
        The law's parameters.
    steps : array_like, shape (n,) or ()
        0 or more, not necessarily whole.

    Returns
    -------
    array, shape (n,)
        rad or m.

    Raises
    ------
    InputError
        If a joint comes to a halt on its way.

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
    """Steps over each traverse; where a cause adds some, they may be 0 or fewer."""
    return law.steps(rows)(values) if isinstance(law, ExtendedLaw) else law.counts(rows, values)[0]


def _check_no_stall(law: StepLaw, gamma: Array) -> None:
    if not np.all(gamma > 0):
        raise InputError(
            f"joint {law.joint} comes to a halt on its way: its law gives a step size of zero or less there"
        )


@dataclass(frozen=True)
class DriveCommand:
    """So many steps of one joint in one direction."""

    joint: int
    direction: str
    steps: int


@dataclass(frozen=True)
class PoseEstimate:
    """Where everything stands after the drives.

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
    before : mapping of int to mapping of str to object
        What each joint's next drive follows, see `Calibrated`.
    """

    q: Array
    q_error: Array
    tip: Array
    tip_covariance: Array
    at_stop: tuple[int, ...]
    before: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def tip_error(self) -> float:
        """Standard deviation of the tip along its least certain direction, m."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.tip_covariance)[-1], 0.0)))


@dataclass(frozen=True)
class _DriveDisplacement:
    """One drive's displacement (signed), and its relative slopes by the law's parameters."""

    distance: float
    slopes: Array


def dead_reckon(arm: CalibratedArm, start: Array, drives: Sequence[DriveCommand]) -> PoseEstimate:
    """Follow a run of drives from joints that stand where `start` says, without error.

    Errors of a law's parameters are the same in every drive of its joint and direction and so add up;
    what does not repeat is new in every drive. A drive that surely reaches a stop ends there, known. Each
    drive follows the one before it of the same joint, which is what some causes look at.

    Parameters
    ----------
    arm : Calibrated
    start : array, shape (3,)
        Joint positions, rad, rad, m; best a stop.
    drives : sequence of Drive

    Returns
    -------
    Whereabouts

    Raises
    ------
    InputError
        If a drive may or may not have reached the stop, so that nobody can say where the joint is.
    """
    check_positions(arm.machine, start, "start")
    q = np.array(start, dtype=float)
    displacements: dict[tuple[int, str], list[_DriveDisplacement]] = {}
    at_stop: set[int] = set()
    for drive in drives:
        position, part = _follow_drive(arm, q, drive, _joint_variance(arm, drive.joint, displacements))
        if position != q[drive.joint - 1]:
            arm = arm.driven(arm.drive(q, drive.joint, position), drive.steps)
        q[drive.joint - 1] = position
        if part is None:
            displacements = {key: parts for key, parts in displacements.items() if key[0] != drive.joint}
            at_stop.add(drive.joint)
        else:
            at_stop.discard(drive.joint)
            displacements.setdefault((drive.joint, drive.direction), []).append(part)
    variance = np.array([_joint_variance(arm, joint, displacements) for joint in (1, 2, 3)])
    slope = jacobian(arm.machine, q)
    tip_covariance = slope @ np.diag(variance) @ slope.T
    tip, stops = forward(arm.machine, q), tuple(sorted(at_stop))
    return PoseEstimate(q, np.sqrt(variance), tip, tip_covariance, stops, arm.before)


def steps_before_recalibration(
    arm: CalibratedArm, pose: PoseEstimate, joint: int, direction: str, tolerance: float
) -> int | None:
    """Further steps of a joint before the tip is no longer known to within `tolerance` at 95 %.

    Parameters
    ----------
    arm : Calibrated
    pose : Whereabouts
    joint, direction
        What would be driven next.
    tolerance : float
        m.

    Returns
    -------
    int or None
        0 where it is not known so well even now: go back to a stop. None where the joint's stop comes first.
    """
    low, high = arm.machine.ranges[joint]
    end = high if direction == "+" else low
    if end == pose.q[joint - 1]:
        return None
    if pose.tip_error * Z_95 > tolerance:
        return 0
    arm = replace(arm, before=pose.before)
    joint_travel = arm.traverse(pose.q, joint, end)
    lever = jacobian(arm.machine, pose.q)[:, joint - 1]
    per_travel = joint_travel.spread**2 * np.outer(lever, lever)

    def excess(travel: float) -> float:
        covered = pose.tip_covariance + per_travel * travel**2
        return Z_95 * float(np.sqrt(np.linalg.eigvalsh(covered)[-1])) - tolerance

    distance = abs(end - pose.q[joint - 1])
    if excess(distance) <= 0:
        return None
    from scipy.optimize import brentq

    travel = brentq(excess, 0.0, distance)
    sign = 1.0 if direction == "+" else -1.0
    return int(arm.traverse(pose.q, joint, float(pose.q[joint - 1] + sign * travel)).counts)


def _follow_drive(
    arm: CalibratedArm, q: Array, drive: DriveCommand, variance: float
) -> tuple[float, _DriveDisplacement | None]:
    """Where a drive takes its joint; no travelled part where it ends at a stop."""
    low, high = arm.machine.ranges[drive.joint]
    end = high if drive.direction == "+" else low
    position = float(q[drive.joint - 1])
    if position == end:
        return end, None
    joint_travel = arm.traverse(q, drive.joint, end)
    margin = (
        Z_95
        * float(np.hypot(joint_travel.spread, np.sqrt(variance) / abs(end - position)))
        * joint_travel.counts
    )
    if drive.steps >= joint_travel.counts + margin:
        return end, None
    if drive.steps > joint_travel.counts - margin:
        raise InputError(
            f"{drive.steps} steps of joint {drive.joint} in {drive.direction} may or may not reach its stop "
            f"({joint_travel.counts:.0f} ± {margin:.0f} steps away): drive {joint_travel.counts + margin:.0f} or more to be at "
            f"the stop for sure, or {joint_travel.counts - margin:.0f} or fewer to stay short of it"
        )
    final = float(position_after(joint_travel.law, joint_travel.row, joint_travel.values, drive.steps)[0])
    return final, _DriveDisplacement(final - position, arm.traverse(q, drive.joint, final).slopes)


def _joint_variance(
    arm: CalibratedArm, joint: int, displacements: dict[tuple[int, str], list[_DriveDisplacement]]
) -> float:
    total = 0.0
    for (which, direction), parts in displacements.items():
        if which != joint:
            continue
        _, _, covariance, repeatability = arm.law(joint, direction)
        shared = sum(part.distance * part.slopes for part in parts)
        total += float(shared @ covariance @ shared)
        total += sum((repeatability * part.distance) ** 2 for part in parts)
    return total
