"""Dead reckoning of one drive, step by step, with its covariance in constant memory.

A joint's displacement in one direction is off by two relative errors, both held for the whole drive: that
of the law's parameters, and the noise, whose standard deviation is the repeatability. With the sum G of each
displacement times the gradient of its log step size by the parameters, and the sum D of the displacements,
the variance is G' C G + (repeatability D)^2, however the drive is cut into bursts. `dead_reckon` in contrast
takes every command for a drive of its own, with noise of its own.

Errors are in joint space. Those of parameters that all joints share (a cause's) are correlated between joints
and directions; from the covariance X of a group's parameters with the shared ones, S, two groups have the
covariance X_a S^-1 X_b'. The tip's covariance is J P J' with the Jacobian J at the present positions and
the joints' covariance P. All this is first order in the errors: that a joint which is not where it is taken
to be also steps differently from there on is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.estimation import Result
from stickslip_fit.machine import forward, jacobian, mean_load
from stickslip_fit.moves.arm import CalibratedArm, as_calibrated_arm, check_positions, invert_covariance
from stickslip_fit.moves.dead_reckoning import PoseEstimate
from stickslip_fit.moves.local_step import LocalSteps, MotionHistory
from stickslip_fit.simulation.truth import Group
from stickslip_fit.units import JOINTS

GROUPS: tuple[Group, ...] = tuple((joint, direction) for joint in JOINTS for direction in "+-")
MAX_PAUSE = 2.0  # s; after a longer one the same joint's next steps are a motion of their own


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over a joint's displacements in one direction since its position was known."""

    gradient: Array
    displacement: float


@dataclass(frozen=True)
class _Stretch:
    """Steps of one joint in one direction, with no other's in between."""

    joint: int
    direction: str
    start: float
    before: MotionHistory
    latest: float  # s
    lost: float  # steps that are still to be lost before the joint moves


class DriveReckoning:
    """Where a drive has taken the joints, how surely, and the size of their next steps.

    Parameters
    ----------
    arm : CalibratedArm or Result
        A Result stands for its latest session. Its condition ``session_seconds`` holds as the drive begins.
    start : array_like, shape (3,)
        Joint positions, rad, rad, m; best at stops.
    start_error : array_like, shape (3,), optional
        Their standard deviations; exact without it.

    Attributes
    ----------
    q : list of float
        Joint positions, rad, rad, m.

    Examples
    --------
    >>> from stickslip_fit.estimation import fit_least_squares
    >>> from stickslip_fit.logs import read_log
    >>> fit = fit_least_squares(read_log("data/reference/campaign.csv"))
    >>> drive = DriveReckoning(fit, [0.0, -1.2, 0.004])
    >>> for burst in range(1000):
    ...     moved = drive.advance(3, "+", 1, seconds=0.01 * burst)
    >>> print(f"{drive.q[2] * 1000:.3f} mm, ± {1.96e6 * drive.variance(3) ** 0.5:.1f} µm")
    4.746 mm, ± 4.2 µm
    """

    def __init__(
        self, arm: CalibratedArm | Result, start: npt.ArrayLike, start_error: npt.ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        self.arm = as_calibrated_arm(arm)
        q, error = np.asarray(start, float), np.asarray(start_error, float)
        check_positions(self.arm.machine, q, "start")
        self.q: list[float] = q.tolist()
        self.steps = LocalSteps(self.arm)
        self.history = dict.fromkeys(JOINTS, MotionHistory())
        self._sums: dict[Group, _Sums] = {}
        self._own_variance = dict(zip(JOINTS, (error**2).tolist(), strict=True))
        self._doubt = dict.fromkeys(JOINTS, 0.0)  # rad or m on either side
        self._variance = dict(self._own_variance)
        self._motion: _Stretch | None = None
        self._shared = max(len(fit.cause_parameters) for fit in self.arm.result.joints.values())
        self._shared_inverse = _invert_shared(self.arm, self._shared)
        self._by_shared: dict[int, Array] = {}

    def step_size(self, joint: int, direction: str, seconds: float) -> float:
        """The size of a joint's next step, rad or m; `seconds` since the drive began."""
        return self.steps.at(joint, direction, self.q, seconds, self.history[joint]).size

    def advance(self, joint: int, direction: str, steps: int, seconds: float) -> float:
        """Follow so many steps, a few at most; returns the joint's signed displacement, rad or m.

        A joint that has come to the end of its range stays there.

        Raises
        ------
        InputError
            If the joint is not calibrated in that direction, or stalls.
        """
        motion = self._motion
        if (
            motion is None
            or motion.joint != joint
            or motion.direction != direction
            or seconds - motion.latest > MAX_PAUSE
        ):
            motion = self._begin_motion(joint, direction, seconds)
        local = self.steps.at(joint, direction, self.q, seconds, motion.before)
        effective = max(steps - motion.lost, 0.0)
        self._motion = replace(motion, latest=seconds, lost=max(motion.lost - steps, 0.0))
        last = self.history[joint]
        self.history[joint] = MotionHistory(direction, last.load, last.steps + steps)
        displacement = self._within_range(joint, local.size * (effective if direction == "+" else -effective))
        self.q[joint - 1] += displacement
        self._add(joint, direction, displacement, displacement * local.slopes)
        return displacement

    def variance(self, joint: int) -> float:
        """Variance of a joint's position, rad^2 or m^2."""
        return self._variance[joint]

    @property
    def q_error(self) -> Array:
        """Standard deviations of the joints' positions, rad, rad, m, shape (3,)."""
        return np.sqrt([self._variance[joint] for joint in JOINTS])

    def joint_covariance(self) -> Array:
        """Covariance of the joints' positions, shape (3, 3)."""
        covariance = np.zeros((3, 3))
        if self._by_shared:
            by_shared = np.array([self._by_shared.get(joint, np.zeros(self._shared)) for joint in JOINTS])
            covariance = by_shared @ self._shared_inverse @ by_shared.T
        np.fill_diagonal(covariance, [self._variance[joint] for joint in JOINTS])
        return covariance

    def variance_after(self, joint: int, displacement: float, seconds: float) -> float:
        """`variance` after a further displacement, rad or m, under the law's uncertainty where the arm is."""
        direction = "+" if displacement > 0 else "-"
        local = self.steps.at(joint, direction, self.q, seconds, self.history[joint])
        further = _Sums(displacement * local.slopes, displacement)
        now, then = (self._group_variance(joint, direction, more) for more in (None, further))
        return self._variance[joint] - now + then

    def pose(self) -> PoseEstimate:
        """The pose, as `dead_reckon` returns it."""
        covariance = self.joint_covariance()
        slope = jacobian(self.arm.machine, self.q)
        at_stop = [
            joint
            for joint in JOINTS
            if self._variance[joint] == 0.0 and self.q[joint - 1] in self.arm.machine.ranges[joint]
        ]
        q = np.array(self.q)
        error = np.sqrt(np.diag(covariance))
        tip_covariance = slope @ covariance @ slope.T
        return PoseEstimate(q, error, forward(self.arm.machine, q), tip_covariance, tuple(at_stop))

    def place(self, joint: int, position: float, error: float = 0.0) -> None:
        """A joint's position is known, e.g. at a stop: all its errors so far are gone."""
        self.q[joint - 1] = position
        for direction in "+-":
            self._sums.pop((joint, direction), None)
        self._doubt[joint] = 0.0
        self._own_variance[joint] = error**2
        self._variance[joint] = error**2
        self._by_shared.pop(joint, None)
        self._motion = None

    def doubt(self, joint: int, displacement: float) -> None:
        """The last displacement may or may not have been made: half of it, give or take the other half.

        The halves of several doubts add up, and their sum is taken for a standard deviation: wherever the
        joint stands, it is within 1.96 of them.
        """
        self.q[joint - 1] -= displacement / 2
        self._doubt[joint] += abs(displacement) / 2
        self._update(joint)

    def snapshot(self) -> dict[str, Any]:
        """Position and uncertainty in plain numbers, SI, for a journal; see `restore`."""
        history = [(last.direction, last.load, last.steps) for last in self.history.values()]
        sums = {
            f"{joint}{direction}": [own.displacement, *own.gradient.tolist()]
            for (joint, direction), own in self._sums.items()
        }
        variance, doubt = ([own[joint] for joint in JOINTS] for own in (self._own_variance, self._doubt))
        return {"q": list(self.q), "variance": variance, "doubt": doubt, "history": history, "sums": sums}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from a `snapshot` of a drive by the same law."""
        self.q = [float(position) for position in snapshot["q"]]
        self._own_variance = dict(zip(JOINTS, snapshot["variance"], strict=True))
        self._doubt = dict(zip(JOINTS, snapshot["doubt"], strict=True))
        self.history = {
            joint: MotionHistory(*last) for joint, last in zip(JOINTS, snapshot["history"], strict=True)
        }
        self._sums = {
            (int(key[0]), key[1]): _Sums(np.array(gradient), displacement)
            for key, (displacement, *gradient) in snapshot["sums"].items()
        }
        for joint in JOINTS:
            self._update(joint)

    def _within_range(self, joint: int, displacement: float) -> float:
        low, high = self.arm.machine.ranges[joint]
        position = self.q[joint - 1]
        return min(max(position + displacement, low), high) - position

    def _begin_motion(self, joint: int, direction: str, seconds: float) -> _Stretch:
        """End the motion in progress, whose load the joint's next one follows, and begin another."""
        last = self._motion
        if last is not None:
            angles = self.q[0], self.q[1], self.arm.theta, self.arm.psi
            load = float(mean_load(last.joint, last.start, self.q[last.joint - 1], *angles))
            ended = self.history[last.joint]
            self.history[last.joint] = MotionHistory(last.direction, load, ended.steps)
        before = self.history[joint]
        lost, slopes = self.steps.steps_added(joint, direction, self.q, seconds, before)
        if lost:
            size = self.step_size(joint, direction, seconds) * (1 if direction == "+" else -1)
            self._add(joint, direction, 0.0, -size * slopes)
        return _Stretch(joint, direction, self.q[joint - 1], before, seconds, lost)

    def _add(self, joint: int, direction: str, displacement: float, gradient: Array) -> None:
        group = (joint, direction)
        sums = self._sums.get(group)
        if sums is not None:
            gradient, displacement = sums.gradient + gradient, sums.displacement + displacement
        self._sums[group] = _Sums(gradient, displacement)
        self._update(joint)

    def _update(self, joint: int) -> None:
        moved = sum(self._group_variance(joint, direction, None) for direction in "+-")
        self._variance[joint] = self._own_variance[joint] + self._doubt[joint] ** 2 + moved
        if not self._shared:
            return
        forth, back = (self._covariance_with_shared(joint, direction) for direction in "+-")
        self._by_shared[joint] = forth + back
        self._variance[joint] += 2.0 * float(forth @ self._shared_inverse @ back)

    def _group_variance(self, joint: int, direction: str, further: _Sums | None) -> float:
        """Variance that displacements in one direction have caused, and those that may follow."""
        sums = self._sums.get((joint, direction))
        gradient, displacement = (sums.gradient, sums.displacement) if sums else (0.0, 0.0)
        if further is not None:
            gradient, displacement = gradient + further.gradient, displacement + further.displacement
        elif sums is None:
            return 0.0
        _, _, covariance, repeatability = self.steps.law(joint, direction)
        return float(gradient @ covariance @ gradient) + (repeatability * displacement) ** 2

    def _covariance_with_shared(self, joint: int, direction: str) -> Array:
        """Covariance of a joint's position with the shared parameters, shape (q,)."""
        sums = self._sums.get((joint, direction))
        if sums is None:
            return np.zeros(self._shared)
        _, _, covariance, _ = self.steps.law(joint, direction)
        return sums.gradient @ covariance[:, -self._shared :]


def _invert_shared(arm: CalibratedArm, shared: int) -> Array:
    """Inverse of the covariance of the parameters that all groups share, the last ones of each; (q, q)."""
    if not shared:
        return np.zeros((0, 0))
    fit = next(iter(arm.result.joints.values()))
    covariances = fit.covariance[:, -shared:, -shared:]
    return invert_covariance(covariances[int(np.argmax(np.isfinite(covariances).all(axis=(1, 2))))])
