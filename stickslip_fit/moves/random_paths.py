"""Moves drawn at random, all over the workspace and in all directions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import pi

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError
from stickslip_fit.machine import JOINTS, Machine, forward, inverse, jacobian
from stickslip_fit.moves.path import Paths, corners

Array = npt.NDArray[np.float64]

AT_ONCE = 256
MOST_FAILURES = 3000  # for each move found


def random_paths(
    machine: Machine,
    count: int,
    seed: int,
    length: float = 1e-3,
    legs: int = 1,
    order: Sequence[int] = JOINTS,
    theta: tuple[float, float] = (-pi / 2, 0.0),
    psi: tuple[float, float] = (-pi / 2, pi / 2),
) -> Paths:
    """Straight moves whose starts are uniform over the reachable workspace, and directions over the sphere.

    A start from which the tip cannot go straight so far in its direction is drawn anew, with the direction.
    Where several stands of the joints lead to a start, each is as likely. Every joint came to its start in
    `+` or `-`, as likely.

    Parameters
    ----------
    machine : Machine
    count : int
    seed : int
    length : float, optional
        m.
    legs : int, optional
        See `straight_path`.
    order : sequence of int, optional
    theta, psi : (float, float), optional
        Ranges of the base's angles, rad, uniform; without them those of the reference campaign.

    Raises
    ------
    InputError
        If hardly any move of that length is within reach.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> paths = random_paths(load_machine(), count=100, seed=1)
    >>> gone = paths.tips[:, -1] - paths.tips[:, 0]
    >>> bool(np.allclose(np.linalg.norm(gone, axis=1), 1e-3))
    True
    """
    if count < 1:
        raise InputError(f"draw one move or more, not {count}")
    rng = np.random.default_rng(seed)
    stands, directions, failures = [], [], 0
    for start, direction in _draws(machine, rng):
        try:
            stands.append(corners(machine, start, direction, length, legs, order))
        except InputError:
            failures += 1
            if failures > MOST_FAILURES * (len(stands) + 1):
                raise InputError(
                    f"hardly any move of {length * 1e3:.4g} mm is within reach: draw shorter ones"
                ) from None
            continue
        directions.append(direction)
        if len(stands) == count:
            break
    return Paths(
        machine=machine,
        stands=np.array(stands),
        order=(*order,) * legs,
        direction=np.array(directions),
        theta=rng.uniform(*theta, count),
        psi=rng.uniform(*psi, count),
        came=rng.choice([-1, 1], (count, 3)),
    )


def _draws(machine: Machine, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Starts, shape (3,), and directions, shape (3,), without end."""
    low, high = np.array([machine.ranges[joint] for joint in JOINTS]).T
    farthest = machine.l2 + high[2]
    largest = (machine.a1 + farthest) * farthest
    while True:
        q = rng.uniform(low, high, (AT_ONCE, 3))
        # The space that the tip has around a stand of the joints.
        volume = np.abs(np.linalg.det(jacobian(machine, q)))
        vectors, luck = rng.standard_normal((AT_ONCE, 3)), rng.random(AT_ONCE)
        for place in np.flatnonzero(luck * largest < volume):
            ways = len(inverse(machine, forward(machine, q[place])))
            if luck[place] * largest * ways < volume[place]:
                yield q[place], vectors[place] / np.linalg.norm(vectors[place])
