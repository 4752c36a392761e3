"""Straight moves of the tip, as joints that are driven one after the other make them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError
from stickslip_fit.machine import JOINTS, Machine, forward, nearest_solution
from stickslip_fit.machine.load import mean_load
from stickslip_fit.moves.within_range import check_positions
from stickslip_fit.units import from_si

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_SIGNS = np.array(["", "+", "-"], dtype=object)  # of 0, 1 and -1
SWING = 2.0  # lengths of a move; joints move the tip at right angles to each other, so that it strays by less
UNIT = 1e-6  # how far a direction's length may be from 1


@dataclass(frozen=True, eq=False)
class Part:
    """One drive, in those of the moves where it goes one way.

    Attributes
    ----------
    drive : int
        Its place among a move's drives.
    joint : int
    direction : {"+", "-"}
    moves : array of int, shape (n,)
    start, stop : array, shape (n,)
        Between which positions the joint is to go, rad or m.
    before_direction : array of str, shape (n,)
        Which way it went before; empty if it was not driven.
    before_load : array, shape (n,)
        Its mean load then.
    """

    drive: int
    joint: int
    direction: str
    moves: Indices
    start: Array
    stop: Array
    before_direction: npt.NDArray[np.object_]
    before_load: Array


@dataclass(frozen=True, eq=False)
class Paths:
    """Where the joints shall stand before and after each drive of m moves.

    Attributes
    ----------
    machine : Machine
    stands : array, shape (m, k + 1, 3)
        Joint positions, rad, rad, m: where each move starts, then where each of its k drives shall end.
    order : tuple of int, length k
        The joint of each drive. A joint that need not move is not driven.
    direction : array, shape (m, 3)
        Unit vectors along the moves, base frame.
    theta, psi : array, shape (m,)
        Orientation of the base, rad.
    came : array of int, shape (m, 3)
        How each joint came to where it starts: 1 by a drive in `+`, -1 in `-`, 0 if it was not driven.
    """

    machine: Machine
    stands: Array
    order: tuple[int, ...]
    direction: Array
    theta: Array
    psi: Array
    came: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.stands)

    @cached_property
    def tips(self) -> Array:
        """The tip before and after each drive, base frame, m, shape (m, k + 1, 3)."""
        return forward(self.machine, self.stands)

    def stray(self) -> Array:
        """How far the tip leaves each straight line, at the ends of its drives at most, m, shape (m,).

        Joints that move one after the other take the tip round corners; the more legs, the smaller.
        """
        return split(self.tips - self.tips[:, :1], self.direction[:, None])[1].max(axis=1)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """All drives, in their order; those that lead nowhere are left out."""
        return tuple(self._parts())

    def _parts(self) -> Iterator[Part]:
        came, load = self.came.copy(), np.zeros(self.came.shape)
        for joint in JOINTS:
            here = self.stands[:, 0, joint - 1]
            load[:, joint - 1] = np.where(came[:, joint - 1] != 0, self._load(joint, 0, here, here), 0.0)
        for drive, joint in enumerate(self.order):
            start, stop = self.stands[:, drive, joint - 1], self.stands[:, drive + 1, joint - 1]
            way = np.sign(stop - start).astype(np.int64)
            for sign, direction in ((1, "+"), (-1, "-")):
                moves = np.flatnonzero(way == sign)
                ends, before = (start[moves], stop[moves]), _SIGNS[came[moves, joint - 1]]
                if len(moves):
                    yield Part(drive, joint, direction, moves, *ends, before, load[moves, joint - 1])
            came[:, joint - 1] = np.where(way, way, came[:, joint - 1])
            own = self._load(joint, drive, start, stop)
            load[:, joint - 1] = np.where(way, own, load[:, joint - 1])

    def _load(self, joint: int, drive: int, start: Array, stop: Array) -> Array:
        q1, q2 = self.stands[:, drive, 0], self.stands[:, drive, 1]
        return mean_load(joint, start, stop, q1, q2, self.theta, self.psi)


def straight_path(
    machine: Machine,
    start: npt.ArrayLike,
    direction: npt.ArrayLike,
    length: float,
    legs: int = 1,
    order: Sequence[int] = JOINTS,
    theta: float = 0.0,
    psi: float = 0.0,
) -> Paths:
    """A move of the tip along a straight line, from joints that were not driven before.

    Parameters
    ----------
    machine : Machine
    start : array_like, shape (3,)
        Joint positions, rad, rad, m.
    direction : array_like, shape (3,)
        A vector of length 1, base frame.
    length : float
        m.
    legs : int, optional
        Equal parts of the line. At the end of each the tip is on the line; within one, every joint that has
        to move is driven once.
    order : sequence of int, optional
        Which joint moves first within a leg.
    theta, psi : float, optional
        Orientation of the base, rad.

    Returns
    -------
    Paths
        Of one move.

    Raises
    ------
    InputError
        If the start or the line is out of reach, the arm would have to swing round on the way, or an
        argument makes no sense.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> path = straight_path(load_machine(), [0.0, -1.2, 0.004], [0.0, 0.0, 1.0], 1e-3, legs=4)
    >>> path.tips[0, ::3, 2].round(6)
    array([0.015038, 0.015288, 0.015538, 0.015788, 0.016038])
    >>> print(f"off the line by {path.stray()[0] * 1e6:.0f} µm at most")
    off the line by 88 µm at most
    """
    towards = np.asarray(direction, float)
    if towards.shape != (3,) or abs(np.linalg.norm(towards) - 1.0) > UNIT:
        raise InputError(f"a direction is x, y, z of a vector of length 1, not {towards.tolist()}")
    if sorted(order) != list(JOINTS):
        raise InputError(f"the order names every joint once, such as 1, 2, 3, not {list(order)}")
    if legs < 1:
        raise InputError(f"a path has one leg or more, not {legs}")
    q = np.asarray(start, float)
    check_positions(machine, q, "start")
    stands = corners(machine, q, towards, length, legs, order)
    return Paths(
        machine=machine,
        stands=stands[None],
        order=(*order,) * legs,
        direction=towards[None],
        theta=np.array([theta], float),
        psi=np.array([psi], float),
        came=np.zeros((1, 3), np.int64),
    )


def corners(
    machine: Machine, start: Array, direction: Array, length: float, legs: int, order: Sequence[int]
) -> Array:
    """Where the joints stand before and after each drive along a straight line, shape (3 legs + 1, 3).

    Raises
    ------
    InputError
        If the line leaves the reach of the arm, or the arm would have to swing round to keep to it.
    """
    q, origin = start, forward(machine, start)
    stands = [q]
    for leg in range(1, legs + 1):
        there = nearest_solution(machine, origin + direction * length * leg / legs, q)
        for joint in order:
            q = np.where(np.arange(3) == joint - 1, there, q)
            stands.append(q)
    found = np.array(stands)
    farthest = split(forward(machine, found) - origin, direction)[1].max()
    if farthest > SWING * length:
        raise InputError(
            "the arm cannot keep to this line: a joint at its stop makes it swing round, which takes the tip "
            f"{from_si(farthest, 'mm'):.3g} mm off; choose another start or direction"
        )
    return found


def split(vectors: Array, direction: Array) -> tuple[Array, Array]:
    """Parts of vectors along a direction (signed) and across it (length), (..., 3) -> (...)."""
    along = np.sum(vectors * direction, axis=-1)
    return along, np.linalg.norm(vectors - along[..., None] * direction, axis=-1)
