"""How many steps to command for moves that nothing watches, by a calibration.

Everything is worked out for c sessions and m moves at once: each session makes all moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.fit.known_causes import HeldLaw
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import JOINTS
from stickslip_fit.moves.path import Part, Paths
from stickslip_fit.moves.truth import Group, Truth

Array = npt.NDArray[np.float64]
StepsFor = Callable[[pd.DataFrame], Array]
"""Rows of a log to the steps that their drives take, shape (n,); NaN where that is not known."""


def steps_to_command(
    paths: Paths,
    steps_for: Mapping[Group, StepsFor],
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
    steps, owed = np.zeros((count, len(paths), len(paths.order))), np.zeros((count, len(paths), 3))
    for part in paths.parts:
        if (part.joint, part.direction) not in steps_for:
            raise InputError(f"joint {part.joint} has no calibration in direction {part.direction}")
        q, stop = paths.stands[part.moves, part.drive], part.stop
        rows = drive_columns(part, paths, q, sessions, conditions) | {"stop": stop}
        rows = {name: np.broadcast_to(of, (count, len(stop))).ravel() for name, of in rows.items()}
        wanted = np.asarray(steps_for[part.joint, part.direction](pd.DataFrame(rows)), float)
        whole, left = whole_steps(
            wanted.reshape(count, len(stop)), stop - part.start, owed[:, part.moves, part.joint - 1]
        )
        steps[:, part.moves, part.drive], owed[:, part.moves, part.joint - 1] = whole, left
    return steps


def whole_steps(wanted: Array, way: Array, owed: Array) -> tuple[Array, Array]:
    """Steps to the nearest whole one, where what rounding left undone before is made up for.

    Parameters
    ----------
    wanted : array
        Steps that the way takes.
    way, owed : array
        Signed, rad or m.

    Returns
    -------
    steps, owed : array
        To command, 0 or more, and what they leave undone, rad or m.

    Examples
    --------
    >>> steps, owed = whole_steps(np.array(10.4), np.array(-1.04e-3), np.array(0.0))
    >>> print(steps, owed.round(9), whole_steps(np.array(10.4), np.array(-1.04e-3), owed)[0])
    10.0 -4e-05 11.0
    """
    length = way / wanted
    steps = np.maximum(np.rint(wanted + owed / length), 0.0)
    return steps, owed + (wanted - steps) * length


def steps_by_parameters(law: StepLaw, values: Array) -> StepsFor:
    """Steps by a law with parameters of its own for each session, shape (c, p), or (p,) for all.

    Steps that are lost in hearing the stop are left out: a drive that ends before it hears none.
    """
    if isinstance(law, HeldLaw):
        return steps_by_parameters(law.extended, law.whole(np.asarray(values, float)))
    moving = law.in_motion(values) if isinstance(law, ExtendedLaw) else np.asarray(values, float)

    def steps_for(rows: pd.DataFrame) -> Array:
        own = moving[rows["number"].to_numpy()] if moving.ndim == 2 else moving
        return np.exp(law.predict(rows, own))

    return steps_for


def steps_by_truth(truth: Truth) -> dict[Group, StepsFor]:
    """The calibration that is right: all that it leaves is whole steps and what does not repeat."""
    return {group: _true_steps(truth, group) for group in truth.values}


def _true_steps(truth: Truth, group: Group) -> StepsFor:
    law, values = truth.laws[group[0]], truth.of_sessions(group)

    def steps_for(rows: pd.DataFrame) -> Array:
        number = rows["number"].to_numpy()
        lost = truth.added(group, rows, values[number])
        return lost + (np.exp(law.predict(rows, values[number])) - lost) / truth.factors(group)[number]

    return steps_for


def drive_columns(
    part: Part, paths: Paths, q: Array, sessions: Sequence[str], conditions: Mapping[str, npt.ArrayLike]
) -> dict[str, Any]:
    """A drive's columns with the joints at q, shape (..., 3); every column goes with (c, part.moves)."""
    shape = len(sessions), len(paths)
    given = {name: np.broadcast_to(of, shape)[:, part.moves] for name, of in conditions.items()}
    joints = {f"q{joint}": q[..., joint - 1] for joint in JOINTS} | {f"q{part.joint}": np.nan}
    return given | joints | {
        "session": np.array(sessions, dtype=object)[:, None], "number": np.arange(len(sessions))[:, None],
        "joint": part.joint, "direction": part.direction, "start": q[..., part.joint - 1],
        "theta": paths.theta[part.moves], "psi": paths.psi[part.moves],
        "before_direction": part.before_direction, "before_load": part.before_load,
    }  # fmt: skip
