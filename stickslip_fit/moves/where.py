"""Where the tip is after a run of drives, how sure, and when to go back to a stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError
from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves.calibrated import CERTAIN, Calibrated
from stickslip_fit.moves.position import position_after
from stickslip_fit.moves.within_range import check_positions

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Drive:
    """So many steps of one joint in one direction."""

    joint: int
    direction: str
    steps: int


@dataclass(frozen=True)
class Whereabouts:
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
class _Travelled:
    """One drive's displacement (signed), and its relative slopes by the law's parameters."""

    distance: float
    slopes: Array


def where_after(arm: Calibrated, start: Array, drives: Sequence[Drive]) -> Whereabouts:
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
    travelled: dict[tuple[int, str], list[_Travelled]] = {}
    at_stop: set[int] = set()
    for drive in drives:
        reached, part = _follow(arm, q, drive, _variance(arm, drive.joint, travelled))
        if reached != q[drive.joint - 1]:
            arm = arm.driven(arm.drive(q, drive.joint, reached), drive.steps)
        q[drive.joint - 1] = reached
        if part is None:
            travelled = {key: parts for key, parts in travelled.items() if key[0] != drive.joint}
            at_stop.add(drive.joint)
        else:
            at_stop.discard(drive.joint)
            travelled.setdefault((drive.joint, drive.direction), []).append(part)
    variance = np.array([_variance(arm, joint, travelled) for joint in (1, 2, 3)])
    slope = jacobian(arm.machine, q)
    tip_covariance = slope @ np.diag(variance) @ slope.T
    tip, stops = forward(arm.machine, q), tuple(sorted(at_stop))
    return Whereabouts(q, np.sqrt(variance), tip, tip_covariance, stops, arm.before)


def steps_until(arm: Calibrated, at: Whereabouts, joint: int, direction: str, tolerance: float) -> int | None:
    """Further steps of a joint before the tip is no longer known to within `tolerance` at 95 %.

    Parameters
    ----------
    arm : Calibrated
    at : Whereabouts
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
    if end == at.q[joint - 1]:
        return None
    if at.tip_error * CERTAIN > tolerance:
        return 0
    arm = replace(arm, before=at.before)
    way = arm.traverse(at.q, joint, end)
    lever = jacobian(arm.machine, at.q)[:, joint - 1]
    per_travel = way.spread**2 * np.outer(lever, lever)

    def excess(travel: float) -> float:
        covered = at.tip_covariance + per_travel * travel**2
        return CERTAIN * float(np.sqrt(np.linalg.eigvalsh(covered)[-1])) - tolerance

    whole = abs(end - at.q[joint - 1])
    if excess(whole) <= 0:
        return None
    from scipy.optimize import brentq

    travel = brentq(excess, 0.0, whole)
    sign = 1.0 if direction == "+" else -1.0
    return int(arm.traverse(at.q, joint, float(at.q[joint - 1] + sign * travel)).counts)


def _follow(arm: Calibrated, q: Array, drive: Drive, before: float) -> tuple[float, _Travelled | None]:
    """Where a drive takes its joint; no travelled part where it ends at a stop."""
    low, high = arm.machine.ranges[drive.joint]
    end = high if drive.direction == "+" else low
    here = float(q[drive.joint - 1])
    if here == end:
        return end, None
    way = arm.traverse(q, drive.joint, end)
    margin = CERTAIN * float(np.hypot(way.spread, np.sqrt(before) / abs(end - here))) * way.counts
    if drive.steps >= way.counts + margin:
        return end, None
    if drive.steps > way.counts - margin:
        raise InputError(
            f"{drive.steps} steps of joint {drive.joint} in {drive.direction} may or may not reach its stop "
            f"({way.counts:.0f} ± {margin:.0f} steps away): drive {way.counts + margin:.0f} or more to be at "
            f"the stop for sure, or {way.counts - margin:.0f} or fewer to stay short of it"
        )
    reached = float(position_after(way.law, way.row, way.values, drive.steps)[0])
    return reached, _Travelled(reached - here, arm.traverse(q, drive.joint, reached).slopes)


def _variance(arm: Calibrated, joint: int, travelled: dict[tuple[int, str], list[_Travelled]]) -> float:
    total = 0.0
    for (which, direction), parts in travelled.items():
        if which != joint:
            continue
        _, _, covariance, repeatability = arm.law(joint, direction)
        shared = sum(part.distance * part.slopes for part in parts)
        total += float(shared @ covariance @ shared)
        total += sum((repeatability * part.distance) ** 2 for part in parts)
    return total
