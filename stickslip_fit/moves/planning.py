"""Planning of moves: the steps for a move of the tip, joint by joint, and of paths driven open loop.

`plan_move` plans one move with its uncertainty. `plan_steps` plans c sessions times m paths at once in
whole steps, carrying the rounding over to the next drive; `simulate_open_loop` says where the joints
truly end under known laws.
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
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves.arm import Z_95, CalibratedArm, check_positions
from stickslip_fit.moves.dead_reckoning import DriveCommand, position_after
from stickslip_fit.moves.path import PathSegment, TipPaths
from stickslip_fit.units import JOINTS


@dataclass(frozen=True)
class MoveSegment:
    """One joint's part of a move.

    Attributes
    ----------
    joint : int
    direction : str
    start, stop : float
        rad or m.
    steps : int
        To command; the nearest whole number.
    low, high : float
        Where 95 % of such moves would have taken the joint all the way.
    error : float
        Standard deviation of where the joint ends, rad or m, the half step of rounding included.
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
    segments : tuple of Leg
        In the order in which they are to be driven.
    tip : array, shape (3,)
        Where the tip ends, base frame, m.
    tip_covariance : array, shape (3, 3)
        m^2; of the move alone, from a start that is known.
    """

    segments: tuple[MoveSegment, ...]
    tip: Array
    tip_covariance: Array

    @property
    def tip_error(self) -> float:
        """Standard deviation of the tip along its least certain direction, m."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.tip_covariance)[-1], 0.0)))


def plan_move(arm: CalibratedArm, start: Array, target: Array, order: Sequence[int] = (1, 2, 3)) -> MovePlan:
    """The steps that take the joints from `start` to `target`, one joint after the other.

    A joint's step size depends on where the others stand, so the order matters: each leg is worked
    out with the joints as the legs before it left them.

    Parameters
    ----------
    arm : Calibrated
    start, target : array, shape (3,)
        Joint positions, rad, rad, m.
    order : sequence of int, optional
        Which joint moves first.

    Returns
    -------
    Move

    Raises
    ------
    InputError
        If a position is outside its joint's range or a law is not known.
    """
    for q, name in ((start, "start"), (target, "target")):
        check_positions(arm.machine, q, name)
    q = np.array(start, dtype=float)
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
    joint_travel = arm.traverse(q, joint, stop)
    final_step = float(
        joint_travel.law.step_size(joint_travel.row, np.array([[stop]]), joint_travel.values)[0, 0]
    )
    travel = abs(stop - q[joint - 1])
    return MoveSegment(
        joint=joint,
        direction=str(joint_travel.row["direction"].iloc[0]),
        start=float(q[joint - 1]),
        stop=stop,
        steps=round(joint_travel.counts),
        low=joint_travel.counts * float(np.exp(-Z_95 * joint_travel.spread)),
        high=joint_travel.counts * float(np.exp(Z_95 * joint_travel.spread)),
        error=float(np.hypot(joint_travel.spread * travel, final_step / np.sqrt(12.0))),
    )


Group = tuple[int, str]
"""Joint and direction."""


@dataclass(frozen=True, eq=False)
class TrueLaws:
    """How the joints truly step in c sessions.

    Attributes
    ----------
    sessions : sequence of str, length c
        Labels, as a cause may look at them; those of several campaigns may be alike.
    laws : mapping of int to StepLaw
        Of each joint; a law may have causes in it.
    values : mapping of (int, str) to array, shape (p,) or (c, p)
        Parameters of each joint and direction, SI.
    factor : mapping of (int, str) to array, shape (c,)
        By which each session's step sizes differ from these; 1 where nothing is said.
    repeatability : mapping of (int, str) to float
        Standard deviation of log(steps); none where nothing is said.
    conditions : mapping of str to array_like that goes with (c, m)
        What a law looks at besides, by a log's columns, SI: ``session_seconds``, ``temperature``, ...
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
        moving = law.in_motion(values) if isinstance(law, ExtendedLaw) else values
        return np.broadcast_to(moving, (len(self.sessions), len(law.parameters)))

    def factors(self, group: Group) -> Array:
        """Each session's factor of a joint and direction, shape (c,)."""
        return np.broadcast_to(self.factor.get(group, 1.0), len(self.sessions))

    def added(self, group: Group, rows: Any, values: Array) -> Array | float:
        """Steps that causes add to drives, shape (n,); a session's factor changes none of them."""
        law = self.laws[group[0]]
        return law.added(rows, values) if isinstance(law, ExtendedLaw) else 0.0


StepModel = Callable[[pd.DataFrame], Array]
"""Rows of a log to the steps that their drives take, shape (n,); NaN where that is not known."""


def plan_steps(
    paths: TipPaths,
    steps_for: Mapping[Group, StepModel],
    sessions: Sequence[str],
    conditions: Mapping[str, npt.ArrayLike],
) -> Array:
    """Whole steps of every drive by a calibration.

    Parameters
    ----------
    paths : Paths
    steps_for : mapping of (int, str) to callable
        Of each joint and direction: rows to steps. Rows are the drives as planned, in a log's columns; all
        moves of the first session come first, and `number` is the place of the session among the c.
    sessions, conditions
        See `Truth`.

    Returns
    -------
    array, shape (c, m, k)
        0 where a joint need not move; NaN where the calibration does not know.

    Raises
    ------
    InputError
        If a joint and direction that is to be driven has no calibration.
    """
    count = len(sessions)
    steps, remainder = np.zeros((count, len(paths), len(paths.order))), np.zeros((count, len(paths), 3))
    for segment in paths.parts:
        if (segment.joint, segment.direction) not in steps_for:
            raise InputError(f"joint {segment.joint} has no calibration in direction {segment.direction}")
        q, stop = paths.joint_positions[segment.moves, segment.drive], segment.stop
        rows = build_drive_rows(segment, paths, q, sessions, conditions) | {"stop": stop}
        rows = {name: np.broadcast_to(of, (count, len(stop))).ravel() for name, of in rows.items()}
        exact = np.asarray(steps_for[segment.joint, segment.direction](pd.DataFrame(rows)), float)
        rounded, left_over = round_steps(
            exact.reshape(count, len(stop)),
            stop - segment.start,
            remainder[:, segment.moves, segment.joint - 1],
        )
        steps[:, segment.moves, segment.drive], remainder[:, segment.moves, segment.joint - 1] = (
            rounded,
            left_over,
        )
    return steps


def round_steps(exact: Array, displacement: Array, remainder: Array) -> tuple[Array, Array]:
    """Steps to the nearest whole one, where what rounding left undone before is made up for.

    Parameters
    ----------
    exact : array
        Steps that the way takes.
    displacement, remainder : array
        Signed, rad or m.

    Returns
    -------
    steps, remainder : array
        To command, 0 or more, and what they leave undone, rad or m.

    Examples
    --------
    >>> steps, owed = round_steps(np.array(10.4), np.array(-1.04e-3), np.array(0.0))
    >>> print(steps, owed.round(9), round_steps(np.array(10.4), np.array(-1.04e-3), owed)[0])
    10.0 -4e-05 11.0
    """
    length = displacement / exact
    steps = np.maximum(np.rint(exact + remainder / length), 0.0)
    return steps, remainder + (exact - steps) * length


def step_model_from_parameters(law: StepLaw, values: Array) -> StepModel:
    """Steps by a law with parameters of its own for each session, shape (c, p), or (p,) for all.

    Steps that are lost in hearing the stop are left out: a drive that ends before it hears none.
    """
    if isinstance(law, FixedCauseLaw):
        return step_model_from_parameters(law.extended, law.whole(np.asarray(values, float)))
    moving = law.in_motion(values) if isinstance(law, ExtendedLaw) else np.asarray(values, float)

    def steps_for(rows: pd.DataFrame) -> Array:
        own = moving[rows["number"].to_numpy()] if moving.ndim == 2 else moving
        return np.exp(law.predict(rows, own))

    return steps_for


def step_models_from_truth(truth: TrueLaws) -> dict[Group, StepModel]:
    """The calibration that is right: all that it leaves is whole steps and what does not repeat."""
    return {group: _true_step_model(truth, group) for group in truth.values}


def _true_step_model(truth: TrueLaws, group: Group) -> StepModel:
    law, values = truth.laws[group[0]], truth.session_values(group)

    def steps_for(rows: pd.DataFrame) -> Array:
        number = rows["number"].to_numpy()
        added = truth.added(group, rows, values[number])
        return added + (np.exp(law.predict(rows, values[number])) - added) / truth.factors(group)[number]

    return steps_for


def build_drive_rows(
    segment: PathSegment,
    paths: TipPaths,
    q: Array,
    sessions: Sequence[str],
    conditions: Mapping[str, npt.ArrayLike],
) -> dict[str, Any]:
    """A drive's columns with the joints at q, shape (..., 3); every column goes with (c, part.moves)."""
    shape = len(sessions), len(paths)
    covariates = {name: np.broadcast_to(of, shape)[:, segment.moves] for name, of in conditions.items()}
    joints = {f"q{joint}": q[..., joint - 1] for joint in JOINTS} | {f"q{segment.joint}": np.nan}
    return covariates | joints | {
        "session": np.array(sessions, dtype=object)[:, None], "number": np.arange(len(sessions))[:, None],
        "joint": segment.joint, "direction": segment.direction, "start": q[..., segment.joint - 1],
        "theta": paths.theta[segment.moves], "psi": paths.psi[segment.moves],
        "before_direction": segment.before_direction, "before_load": segment.before_load,
    }  # fmt: skip


def plan_drives(arm: CalibratedArm, path: TipPaths) -> tuple[DriveCommand, ...]:
    """What to command for a straight move; `where_after` says where that takes the tip, and how sure.

    Parameters
    ----------
    arm : Calibrated
    path : Paths
        Of one move, see `straight_path`; the base stands as `arm` has it.

    Raises
    ------
    InputError
        If a law is not known, or stalls on the way.

    Examples
    --------
    A millimetre upwards, in two legs, by the latest session of the reference campaign:

    >>> from stickslip_fit.estimation import fit_least_squares
    >>> from stickslip_fit.logs import read_log
    >>> from stickslip_fit.moves import calibrated_arm, dead_reckon, straight_path
    >>> arm = calibrated_arm(fit_least_squares(read_log("data/reference/campaign.csv")))
    >>> path = straight_path(arm.machine, [0.0, -1.2, 0.004], [0.0, 0.0, 1.0], 1e-3, legs=2)
    >>> drives = plan_drives(arm, path)
    >>> for drive in drives:
    ...     print(f"joint {drive.joint}: {drive.steps} steps in {drive.direction}")
    joint 2: 143 steps in +
    joint 3: 258 steps in +
    joint 2: 141 steps in +
    joint 3: 267 steps in +
    >>> found = dead_reckon(arm, path.joint_positions[0, 0], drives)
    >>> off = np.linalg.norm(found.tip - path.tips[0, -1])
    >>> print(f"{off * 1e6:.1f} µm off for whole steps, and ± {found.tip_error * 1e6:.1f} µm (1 sd)")
    0.7 µm off for whole steps, and ± 2.0 µm (1 sd)
    """
    if len(path) != 1:
        raise InputError(f"drives are worked out for one move at a time, not for {len(path)}")
    remainder, drives = np.zeros(3), []
    for segment in path.parts:
        joint_travel = arm.traverse(
            path.joint_positions[0, segment.drive], segment.joint, float(segment.stop[0])
        )
        steps, left_over = round_steps(
            np.array(joint_travel.counts), segment.stop - segment.start, remainder[segment.joint - 1]
        )
        remainder[segment.joint - 1] = left_over[0]
        drives.append(DriveCommand(segment.joint, segment.direction, int(steps[0])))
        arm = arm.driven(joint_travel.row, drives[-1].steps)
    return tuple(drives)


def simulate_open_loop(paths: TipPaths, truth: TrueLaws, steps: Array, noise: Array | None = None) -> Array:
    """Where the joints truly stand after so many steps.

    Every drive begins where the ones before have truly left the joints, and ends at a mechanical stop if it
    meets one. What a cause does to hearing the stop plays no part.

    Parameters
    ----------
    paths : Paths
        Where the moves start, and which way each drive goes.
    truth : Truth
    steps : array, shape (c, m, k)
        As `steps_to_command` returns them.
    noise : array, shape (c, m, k), optional
        Departures of log(steps) with standard deviation 1, see `simulate.draw_noise`; without it every drive
        goes as far as it does on average.

    Returns
    -------
    array, shape (c, m, 3)
        rad, rad, m; NaN where steps are.

    Raises
    ------
    InputError
        If a joint truly comes to a halt.
    """
    q = np.broadcast_to(paths.joint_positions[:, 0], (len(steps), len(paths), 3)).copy()
    for segment in paths.parts:
        group, steps_made = (segment.joint, segment.direction), steps[:, segment.moves, segment.drive]
        if noise is not None:
            steps_made = steps_made * np.exp(
                -truth.repeatability.get(group, 0.0) * noise[:, segment.moves, segment.drive]
            )
        end = paths.machine.ranges[segment.joint][segment.direction == "+"]
        rows = build_drive_rows(segment, paths, q[:, segment.moves], truth.sessions, truth.conditions) | {
            "stop": end
        }
        rows = {name: np.broadcast_to(of, steps_made.shape).ravel() for name, of in rows.items()}
        reached = _true_positions(truth, group, rows, steps_made.ravel())
        q[:, segment.moves, segment.joint - 1] = reached.reshape(steps_made.shape)
    return q


def _true_positions(truth: TrueLaws, group: Group, rows: dict[str, Any], steps_made: Array) -> Array:
    """Where drives truly end after so many steps, shape (n,); NaN for steps that are."""
    law, reached = truth.laws[group[0]], np.full(len(steps_made), np.nan)
    moving = np.isfinite(steps_made) & np.isfinite(rows["start"])
    rows, steps_made = {name: of[moving] for name, of in rows.items()}, steps_made[moving]
    values = truth.session_values(group)[rows["number"]]
    added = truth.added(group, rows, values)
    effective = added + (steps_made - added) * truth.factors(group)[rows["number"]]
    reached[moving] = position_after(law, rows, values, np.maximum(effective, 0.0))
    return reached
