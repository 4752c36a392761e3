"""How many steps take the tip from here to there, joint by joint, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves.calibrated import CERTAIN, Calibrated
from stickslip_fit.moves.within_range import check_positions

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Leg:
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
class Move:
    """A move of the tip.

    Attributes
    ----------
    legs : tuple of Leg
        In the order in which they are to be driven.
    tip : array, shape (3,)
        Where the tip ends, base frame, m.
    tip_covariance : array, shape (3, 3)
        m^2; of the move alone, from a start that is known.
    """

    legs: tuple[Leg, ...]
    tip: Array
    tip_covariance: Array

    @property
    def tip_error(self) -> float:
        """Standard deviation of the tip along its least certain direction, m."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.tip_covariance)[-1], 0.0)))


def steps_for_move(arm: Calibrated, start: Array, target: Array, order: Sequence[int] = (1, 2, 3)) -> Move:
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
    legs, variance = [], np.zeros(3)
    for joint in order:
        if target[joint - 1] == q[joint - 1]:
            continue
        leg = _leg(arm, q, joint, float(target[joint - 1]))
        legs.append(leg)
        variance[joint - 1] = leg.error**2
        q[joint - 1] = target[joint - 1]
    slope = jacobian(arm.machine, q)
    return Move(tuple(legs), forward(arm.machine, q), slope @ np.diag(variance) @ slope.T)


def _leg(arm: Calibrated, q: Array, joint: int, stop: float) -> Leg:
    way = arm.traverse(q, joint, stop)
    ahead = float(way.law.step_size(way.row, np.array([[stop]]), way.values)[0, 0])
    travel = abs(stop - q[joint - 1])
    return Leg(
        joint=joint,
        direction=str(way.row["direction"].iloc[0]),
        start=float(q[joint - 1]),
        stop=stop,
        steps=round(way.counts),
        low=way.counts * float(np.exp(-CERTAIN * way.spread)),
        high=way.counts * float(np.exp(CERTAIN * way.spread)),
        error=float(np.hypot(way.spread * travel, ahead / np.sqrt(12.0))),
    )
