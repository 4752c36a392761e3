"""Planning of moves: the steps for a move of the tip, joint by joint, and of paths driven open loop.

`plan_move` plans one move with its uncertainty. `plan_steps` plans c sessions times m paths at once in
whole steps, adding the rounding error to the joint's next drive; `simulate_open_loop` computes where the
joints end under known laws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves.arm import CalibratedArm, as_calibrated_arm, check_positions
from stickslip_fit.moves.dead_reckoning import position_after
from stickslip_fit.moves.error_ellipsoid import error_radius
from stickslip_fit.moves.path import PathSegment, TipPaths
from stickslip_fit.simulation.truth import Group
from stickslip_fit.units import JOINTS, Z_95


@dataclass(frozen=True)
class MoveSegment:
    """One joint's part of a move.

    Attributes
    ----------
    start, stop : float
        rad or m.
    steps : int
        To command; the nearest whole number.
    low, high : float
        95 % interval of the steps that the drive takes.
    error : float
        Standard deviation of the joint's final position, rad or m, rounding to whole steps included.
    """

    joint: int
    direction: str
    start: float
    stop: float
    steps: int
    low: float
    high: float
    error: float


@dataclass(frozen=True)
class MovePlan:
    """A move of the tip.

    Attributes
    ----------
    segments : tuple of MoveSegment
        In the order in which they are to be driven.
    tip : array, shape (3,)
        Final position of the tip, base frame, m.
    tip_covariance : array, shape (3, 3)
        m^2; from a start without error.
    """

    segments: tuple[MoveSegment, ...]
    tip: Array
    tip_covariance: Array

    @property
    def tip_radius(self) -> float:
        """Radius about `tip` that holds 95 % of its errors, m, see `error_radius`."""
        return float(error_radius(self.tip_covariance))


def plan_move(
    arm: CalibratedArm | Result, start: npt.ArrayLike, target: npt.ArrayLike, order: Sequence[int] = JOINTS
) -> MovePlan:
    """The steps that take the joints from `start` to `target`, one joint after the other.

    The order matters: a joint's step size depends on the positions of the others, as earlier segments left
    them.

    Parameters
    ----------
    arm : CalibratedArm or Result
        A Result stands for its latest session, see `calibrated_arm`.
    start, target : array_like, shape (3,)
        Joint positions, rad, rad, m.
    order : sequence of int, optional
        Of the joints.

    Raises
    ------
    InputError
        If a position is outside its joint's range or a law is not calibrated.
    """
    arm = as_calibrated_arm(arm)
    q, target = np.array(start, dtype=float), np.asarray(target, dtype=float)
    check_positions(arm.machine, q, "start")
    check_positions(arm.machine, target, "target")
    segments, variance = [], np.zeros(3)
    for joint in order:
        if target[joint - 1] == q[joint - 1]:
            continue
        segment = _plan_segment(arm, q, joint, float(target[joint - 1]))
        segments.append(segment)
        variance[joint - 1] = segment.error**2
        q[joint - 1] = target[joint - 1]
    slope = jacobian(arm.machine, q)
    return MovePlan(tuple(segments), forward(arm.machine, q), slope @ np.diag(variance) @ slope.T)


def _plan_segment(arm: CalibratedArm, q: Array, joint: int, stop: float) -> MoveSegment:
    travel = arm.joint_travel(q, joint, stop)
    final_step = float(travel.law.step_size(travel.row, np.array([[stop]]), travel.values)[0, 0])
    distance = abs(stop - q[joint - 1])
    return MoveSegment(
        joint=joint,
        direction=str(travel.row["direction"].iloc[0]),
        start=float(q[joint - 1]),
        stop=stop,
        steps=round(travel.counts),
        low=travel.counts * float(np.exp(-Z_95 * travel.spread)),
        high=travel.counts * float(np.exp(Z_95 * travel.spread)),
        error=float(np.hypot(travel.spread * distance, final_step / np.sqrt(12.0))),
    )


@dataclass(frozen=True, eq=False)
class TrueLaws:
    """The true laws of c sessions.

    Attributes
    ----------
    sessions : sequence of str, length c
        Labels, on which causes may depend; not necessarily different.
    laws : mapping of int to StepLaw
        Of each joint, with or without causes.
    values : mapping of (int, str) to array, shape (p,) or (c, p)
        Parameters of each joint and direction, SI.
    factor : mapping of (int, str) to array, shape (c,)
        Multiplies each session's step sizes; 1 by default.
    repeatability : mapping of (int, str) to float
        Standard deviation of log(steps); 0 by default.
    conditions : mapping of str to array_like, broadcast to (c, m)
        Other columns of a log on which a law depends, SI: ``session_seconds``, ``temperature``, ...
    """

    sessions: Sequence[str]
    laws: Mapping[int, StepLaw]
    values: Mapping[Group, Array]
    factor: Mapping[Group, Array] = field(default_factory=dict)
    repeatability: Mapping[Group, float] = field(default_factory=dict)
    conditions: Mapping[str, npt.ArrayLike] = field(default_factory=dict)

    def session_values(self, group: Group) -> Array:
        """Each session's parameters of a joint and direction in motion, shape (c, p)."""
        law, values = self.laws[group[0]], np.asarray(self.values[group], float)
        moving = law.without_stop_effects(values) if isinstance(law, ExtendedLaw) else values
        return np.broadcast_to(moving, (len(self.sessions), len(law.parameters)))

    def factors(self, group: Group) -> Array:
        """Each session's factor of a joint and direction, shape (c,)."""
        return np.broadcast_to(self.factor.get(group, 1.0), len(self.sessions))

    def added(self, group: Group, rows: Any, values: Array) -> Array | float:
        """Steps that causes add to drives, shape (n,); the session's factor does not apply to them."""
        law = self.laws[group[0]]
        return law.steps_added_by_causes(rows, values) if isinstance(law, ExtendedLaw) else 0.0


StepModel = Callable[[pd.DataFrame], Array]
"""From rows of a log to the steps of their drives, shape (n,); NaN where they are not calibrated."""


def plan_steps(
    paths: TipPaths,
    steps_for: Mapping[Group, StepModel],
    sessions: Sequence[str],
    conditions: Mapping[str, npt.ArrayLike],
) -> Array:
    """Whole steps of every drive by a calibration, shape (c, m, k).

    0 where a joint does not move; NaN where the calibration gives none.

    Parameters
    ----------
    steps_for : mapping of (int, str) to callable
        Of each joint and direction: rows to steps. Rows are the planned drives, in a log's columns; all
        moves of the first session come first, and `number` is the index of the session.
    sessions, conditions
        See `TrueLaws`.

    Raises
    ------
    InputError
        If a joint and direction of a drive has no calibration.
    """
    count = len(sessions)
    steps, remainder = np.zeros((count, len(paths), len(paths.order))), np.zeros((count, len(paths), 3))
    for segment in paths.segments:
        if (segment.joint, segment.direction) not in steps_for:
            raise InputError(f"joint {segment.joint} has no calibration in direction {segment.direction}")
        q, stop = paths.joint_positions[segment.moves, segment.drive_index], segment.stop
        rows = build_drive_rows(segment, paths, q, sessions, conditions) | {"stop": stop}
        rows = {name: np.broadcast_to(column, (count, len(stop))).ravel() for name, column in rows.items()}
        exact = np.asarray(steps_for[segment.joint, segment.direction](pd.DataFrame(rows)), float)
        own = (slice(None), segment.moves, segment.joint - 1)
        rounded, left_over = round_steps(exact.reshape(count, -1), stop - segment.start, remainder[own])
        steps[:, segment.moves, segment.drive_index], remainder[own] = rounded, left_over
    return steps


def round_steps(exact: Array, displacement: Array, remainder: Array) -> tuple[Array, Array]:
    """Whole steps of a displacement, with the remainder of earlier roundings added to it.

    `exact` are the steps of the displacement. Returned are the steps to command, 0 or more, and the
    displacement that they leave undone; displacements and remainders are signed, rad or m.

    Examples
    --------
    >>> steps, remainder = round_steps(np.array(10.4), np.array(-1.04e-3), np.array(0.0))
    >>> print(steps, remainder.round(9), round_steps(np.array(10.4), np.array(-1.04e-3), remainder)[0])
    10.0 -4e-05 11.0
    """
    length = displacement / exact
    steps = np.maximum(np.rint(exact + remainder / length), 0.0)
    return steps, remainder + (exact - steps) * length


def step_model_from_parameters(law: StepLaw, values: Array) -> StepModel:
    """Steps by a law with parameters for each session, shape (c, p), or for all, shape (p,).

    Steps lost in detecting the stop are left out: a drive that ends before the stop loses none.
    """
    if isinstance(law, FixedCauseLaw):
        return step_model_from_parameters(law.extended, law.whole(np.asarray(values, float)))
    moving = law.without_stop_effects(values) if isinstance(law, ExtendedLaw) else np.asarray(values, float)

    def steps_for(rows: pd.DataFrame) -> Array:
        own = moving[rows["number"].to_numpy()] if moving.ndim == 2 else moving
        return np.exp(law.predict(rows, own))

    return steps_for


def build_drive_rows(
    segment: PathSegment,
    paths: TipPaths,
    q: Array,
    sessions: Sequence[str],
    conditions: Mapping[str, npt.ArrayLike],
) -> dict[str, Any]:
    """A drive's columns with the joints at q, shape (..., 3), each broadcast to (c, segment.moves)."""
    shape = len(sessions), len(paths)
    covariates = {name: np.broadcast_to(of, shape)[:, segment.moves] for name, of in conditions.items()}
    joints = {f"q{joint}": q[..., joint - 1] for joint in JOINTS} | {f"q{segment.joint}": np.nan}
    columns = dict(
        session=np.array(sessions, dtype=object)[:, None],
        number=np.arange(len(sessions))[:, None],
        joint=segment.joint,
        direction=segment.direction,
        start=q[..., segment.joint - 1],
        theta=paths.theta[segment.moves],
        psi=paths.psi[segment.moves],
        before_direction=segment.before_direction,
        before_load=segment.before_load,
    )
    return covariates | joints | columns


def simulate_open_loop(paths: TipPaths, truth: TrueLaws, steps: Array, noise: Array | None = None) -> Array:
    """Joint positions under the true laws after so many steps, rad, rad, m, shape (c, m, 3).

    Every drive starts from the joints' true positions and ends at a mechanical stop if it reaches one.
    Effects on detecting the stop play no part. Positions are NaN where steps are.

    Parameters
    ----------
    paths : TipPaths
        Starts of the moves, and directions of their drives.
    steps : array, shape (c, m, k)
        As `plan_steps` returns them.
    noise : array, shape (c, m, k), optional
        Deviations of log(steps) with standard deviation 1, see `simulation.draw_noise`; none by default.

    Raises
    ------
    InputError
        If a joint stalls.
    """
    q = np.broadcast_to(paths.joint_positions[:, 0], (len(steps), len(paths), 3)).copy()
    for segment in paths.segments:
        group, drive = (segment.joint, segment.direction), (slice(None), segment.moves, segment.drive_index)
        effective = steps[drive]
        if noise is not None:
            effective = effective * np.exp(-truth.repeatability.get(group, 0.0) * noise[drive])
        rows = build_drive_rows(segment, paths, q[:, segment.moves], truth.sessions, truth.conditions)
        rows["stop"] = paths.machine.ranges[segment.joint][segment.direction == "+"]
        rows = {name: np.broadcast_to(column, effective.shape).ravel() for name, column in rows.items()}
        position = _true_positions(truth, group, rows, effective.ravel())
        q[:, segment.moves, segment.joint - 1] = position.reshape(effective.shape)
    return q


def _true_positions(truth: TrueLaws, group: Group, rows: dict[str, Any], steps_made: Array) -> Array:
    """True final positions of drives after so many steps, shape (n,); NaN where steps are."""
    law, reached = truth.laws[group[0]], np.full(len(steps_made), np.nan)
    moving = np.isfinite(steps_made) & np.isfinite(rows["start"])
    rows, steps_made = {name: of[moving] for name, of in rows.items()}, steps_made[moving]
    values = truth.session_values(group)[rows["number"]]
    added = truth.added(group, rows, values)
    effective = added + (steps_made - added) * truth.factors(group)[rows["number"]]
    reached[moving] = position_after(law, rows, values, np.maximum(effective, 0.0))
    return reached
