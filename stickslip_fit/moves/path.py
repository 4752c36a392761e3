"""Straight paths of the tip as sequences of single-joint drives, and random paths in the workspace.

The joints move one after the other, so that the tip leaves the line; more segments keep it closer.
Random paths start uniformly in the reachable workspace, with directions uniform on the sphere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array, Int64Array, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.machine import Machine, forward, inverse, jacobian, mean_load, nearest_solution
from stickslip_fit.moves.arm import check_positions
from stickslip_fit.units import JOINTS, from_si

_DIRECTION_BY_SIGN = np.array(["", "+", "-"], dtype=object)  # of 0, 1 and -1
MAX_STRAY_RATIO = 2.0  # lengths of a move; joints move the tip at right angles, so that it deviates by less
UNIT_VECTOR_TOL = 1e-6  # how far a direction's length may be from 1


@dataclass(frozen=True, eq=False)
class PathSegment:
    """One drive, in those moves where it has the same direction.

    Attributes
    ----------
    drive_index : int
        Among a move's drives.
    direction : {"+", "-"}
    moves : array of int, shape (n,)
    start, stop : array, shape (n,)
        Planned positions of the joint, rad or m.
    before_direction : array of str, shape (n,)
        Direction of the joint's previous drive; empty if there was none.
    before_load : array, shape (n,)
        Mean load in the previous drive.
    """

    drive_index: int
    joint: int
    direction: str
    moves: IntArray
    start: Array
    stop: Array
    before_direction: npt.NDArray[np.object_]
    before_load: Array


@dataclass(frozen=True, eq=False)
class TipPaths:
    """Planned joint positions before and after each drive of m moves.

    Attributes
    ----------
    joint_positions : array, shape (m, k + 1, 3)
        Joint positions, rad, rad, m: at the start of each move, then at the end of each of its k drives.
    order : tuple of int, length k
        The joint of each drive; one that is in position is not driven.
    direction : array, shape (m, 3)
        Unit vectors along the moves, base frame.
    theta, psi : array, shape (m,)
        Orientation of the base, rad.
    arrival_direction : array of int, shape (m, 3)
        Of each joint's drive to its start: 1 for `+`, -1 for `-`, 0 if it was not driven.
    """

    machine: Machine
    joint_positions: Array
    order: tuple[int, ...]
    direction: Array
    theta: Array
    psi: Array
    arrival_direction: Int64Array

    def __len__(self) -> int:
        return len(self.joint_positions)

    @cached_property
    def tips(self) -> Array:
        """The tip before and after each drive, base frame, m, shape (m, k + 1, 3)."""
        return forward(self.machine, self.joint_positions)

    def max_deviation(self) -> Array:
        """Largest distance of the tip from each straight line at the ends of its drives, m, shape (m,)."""
        return decompose(self.tips - self.tips[:, :1], self.direction[:, None])[1].max(axis=1)

    @cached_property
    def segments(self) -> tuple[PathSegment, ...]:
        """All drives, in their order; those without displacement are left out."""
        return tuple(self._build_segments())

    def _build_segments(self) -> Iterator[PathSegment]:
        directions, load = self.arrival_direction.copy(), np.zeros(self.arrival_direction.shape)
        for joint in JOINTS:
            start = self.joint_positions[:, 0, joint - 1]
            driven = directions[:, joint - 1] != 0
            load[:, joint - 1] = np.where(driven, self._load(joint, 0, start, start), 0.0)
        for k, joint in enumerate(self.order):
            start, stop = (self.joint_positions[:, k + end, joint - 1] for end in (0, 1))
            signs = np.sign(stop - start).astype(np.int64)
            last, last_load = directions[:, joint - 1], load[:, joint - 1]
            for sign, direction in ((1, "+"), (-1, "-")):
                moves = np.flatnonzero(signs == sign)
                if len(moves):
                    before = _DIRECTION_BY_SIGN[last[moves]], last_load[moves]
                    yield PathSegment(k, joint, direction, moves, start[moves], stop[moves], *before)
            directions[:, joint - 1] = np.where(signs, signs, last)
            load[:, joint - 1] = np.where(signs, self._load(joint, k, start, stop), last_load)

    def _load(self, joint: int, drive: int, start: Array, stop: Array) -> Array:
        q1, q2 = self.joint_positions[:, drive, 0], self.joint_positions[:, drive, 1]
        return mean_load(joint, start, stop, q1, q2, self.theta, self.psi)


def straight_path(
    machine: Machine,
    start: npt.ArrayLike,
    direction: npt.ArrayLike,
    length: float,
    n_segments: int = 1,
    order: Sequence[int] = JOINTS,
    theta: float = 0.0,
    psi: float = 0.0,
) -> TipPaths:
    """A move of the tip along a straight line, by joints that were not driven before.

    Parameters
    ----------
    start : array_like, shape (3,)
        Joint positions, rad, rad, m.
    direction : array_like, shape (3,)
        A vector of length 1, base frame.
    length : float
        m.
    n_segments : int, optional
        Equal parts of the line. The tip is on the line at the end of each, and every joint is driven at most
        once within it.
    order : sequence of int, optional
        Of the joints within a segment.
    theta, psi : float, optional
        Orientation of the base, rad.

    Returns
    -------
    TipPaths
        Of one move.

    Raises
    ------
    InputError
        If the start or the line is out of reach, the arm would have to change to its other solution on the
        way, or an argument is invalid.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> path = straight_path(load_machine(), [0.0, -1.2, 0.004], [0.0, 0.0, 1.0], 1e-3, n_segments=4)
    >>> path.tips[0, ::3, 2].round(6)
    array([0.015038, 0.015288, 0.015538, 0.015788, 0.016038])
    >>> print(f"off the line by {path.max_deviation()[0] * 1e6:.0f} µm at most")
    off the line by 88 µm at most
    """
    unit_vector = np.asarray(direction, float)
    if unit_vector.shape != (3,) or abs(np.linalg.norm(unit_vector) - 1.0) > UNIT_VECTOR_TOL:
        raise InputError(f"a direction is x, y, z of a vector of length 1, not {unit_vector.tolist()}")
    if sorted(order) != list(JOINTS):
        raise InputError(f"the order names every joint once, such as 1, 2, 3, not {list(order)}")
    if n_segments < 1:
        raise InputError(f"a path has one segment or more, not {n_segments}")
    q = np.asarray(start, float)
    check_positions(machine, q, "start")
    joint_positions = path_corners(machine, q, unit_vector, length, n_segments, order)
    return TipPaths(
        machine=machine,
        joint_positions=joint_positions[None],
        order=(*order,) * n_segments,
        direction=unit_vector[None],
        theta=np.array([theta], float),
        psi=np.array([psi], float),
        arrival_direction=np.zeros((1, 3), np.int64),
    )


def path_corners(
    machine: Machine, start: Array, direction: Array, length: float, n_segments: int, order: Sequence[int]
) -> Array:
    """Joint positions before and after each drive along a straight line, shape (3 n_segments + 1, 3).

    Raises
    ------
    InputError
        If the line is out of reach, or the arm would have to change to its other solution on the way.
    """
    q, origin = start, forward(machine, start)
    joint_positions = [q]
    for segment in range(1, n_segments + 1):
        goal = nearest_solution(machine, origin + direction * length * segment / n_segments, q)
        for joint in order:
            q = np.where(np.arange(3) == joint - 1, goal, q)
            joint_positions.append(q)
    positions = np.array(joint_positions)
    max_deviation = decompose(forward(machine, positions) - origin, direction)[1].max()
    if max_deviation > MAX_STRAY_RATIO * length:
        raise InputError(
            "the arm cannot follow this line: a joint at its stop makes it swing round, which takes the tip "
            f"{from_si(max_deviation, 'mm'):.3g} mm off; choose another start or direction"
        )
    return positions


def decompose(vectors: Array, direction: Array) -> tuple[Array, Array]:
    """Components of vectors along a direction (signed) and across it (length), (..., 3) -> (...)."""
    along = np.sum(vectors * direction, axis=-1)
    return along, np.linalg.norm(vectors - along[..., None] * direction, axis=-1)


PATHS_PER_CHUNK = 256
MAX_FAILURES = 3000  # for each move found


def draw_random_paths(
    machine: Machine,
    count: int,
    seed: int,
    length: float = 1e-3,
    n_segments: int = 1,
    order: Sequence[int] = JOINTS,
    theta: tuple[float, float] = (-pi / 2, 0.0),
    psi: tuple[float, float] = (-pi / 2, pi / 2),
) -> TipPaths:
    """Straight moves with starts uniform over the reachable workspace and directions uniform over the sphere.

    Starts and directions of moves that are out of reach are drawn again. Where inverse kinematics has
    several solutions at a start, they are equally likely, as are `+` and `-` of each joint's previous drive.

    Parameters
    ----------
    length : float, optional
        m.
    n_segments : int, optional
        See `straight_path`.
    order : sequence of int, optional
    theta, psi : (float, float), optional
        Ranges of the base's angles, rad, uniform; by default those of the reference campaign.

    Raises
    ------
    InputError
        If hardly any move of that length is within reach.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> paths = draw_random_paths(load_machine(), count=100, seed=1)
    >>> gone = paths.tips[:, -1] - paths.tips[:, 0]
    >>> bool(np.allclose(np.linalg.norm(gone, axis=1), 1e-3))
    True
    """
    if count < 1:
        raise InputError(f"draw one move or more, not {count}")
    rng = np.random.default_rng(seed)
    joint_positions, directions, failures = [], [], 0
    for start, direction in _draw_moves(machine, rng):
        try:
            joint_positions.append(path_corners(machine, start, direction, length, n_segments, order))
        except InputError:
            failures += 1
            if failures > MAX_FAILURES * (len(joint_positions) + 1):
                raise InputError(
                    f"hardly any move of {length * 1e3:.4g} mm is within reach: draw shorter ones"
                ) from None
            continue
        directions.append(direction)
        if len(joint_positions) == count:
            break
    return TipPaths(
        machine=machine,
        joint_positions=np.array(joint_positions),
        order=(*order,) * n_segments,
        direction=np.array(directions),
        theta=rng.uniform(*theta, count),
        psi=rng.uniform(*psi, count),
        arrival_direction=rng.choice([-1, 1], (count, 3)),
    )


def _draw_moves(machine: Machine, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Starts, shape (3,), and directions, shape (3,), without end."""
    low, high = np.array([machine.ranges[joint] for joint in JOINTS]).T
    max_reach = machine.l2 + high[2]
    max_volume = (machine.a1 + max_reach) * max_reach
    while True:
        q = rng.uniform(low, high, (PATHS_PER_CHUNK, 3))
        # Density of the tip's position under uniform joint positions is 1 / volume.
        volume = np.abs(np.linalg.det(jacobian(machine, q)))
        vectors, uniform = rng.standard_normal((PATHS_PER_CHUNK, 3)), rng.random(PATHS_PER_CHUNK)
        for k in np.flatnonzero(uniform * max_volume < volume):
            n_solutions = len(inverse(machine, forward(machine, q[k])))
            if uniform[k] * max_volume * n_solutions < volume[k]:
                yield q[k], vectors[k] / np.linalg.norm(vectors[k])
