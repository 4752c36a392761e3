"""Where joints truly stand after the steps that were commanded, with nothing to watch them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.moves.command import drive_columns
from stickslip_fit.moves.path import Paths
from stickslip_fit.moves.position import position_after
from stickslip_fit.moves.truth import Group, Truth

Array = npt.NDArray[np.float64]


def driven(paths: Paths, truth: Truth, steps: Array, noise: Array | None = None) -> Array:
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
    q = np.broadcast_to(paths.stands[:, 0], (len(steps), len(paths), 3)).copy()
    for part in paths.parts:
        group, made = (part.joint, part.direction), steps[:, part.moves, part.drive]
        if noise is not None:
            made = made * np.exp(-truth.repeatability.get(group, 0.0) * noise[:, part.moves, part.drive])
        end = paths.machine.ranges[part.joint][part.direction == "+"]
        rows = drive_columns(part, paths, q[:, part.moves], truth.sessions, truth.conditions) | {"stop": end}
        rows = {name: np.broadcast_to(of, made.shape).ravel() for name, of in rows.items()}
        reached = _reached(truth, group, rows, made.ravel())
        q[:, part.moves, part.joint - 1] = reached.reshape(made.shape)
    return q


def _reached(truth: Truth, group: Group, rows: dict[str, Any], made: Array) -> Array:
    """Where drives truly end after so many steps, shape (n,); NaN for steps that are."""
    law, reached = truth.laws[group[0]], np.full(len(made), np.nan)
    moving = np.isfinite(made) & np.isfinite(rows["start"])
    rows, made = {name: of[moving] for name, of in rows.items()}, made[moving]
    values = truth.of_sessions(group)[rows["number"]]
    lost = truth.added(group, rows, values)
    effective = lost + (made - lost) * truth.factors(group)[rows["number"]]
    reached[moving] = position_after(law, rows, values, np.maximum(effective, 0.0))
    return reached
