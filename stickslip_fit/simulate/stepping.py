"""Literally stepping a joint until it meets its stop: slow, and right by construction."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError
from stickslip_fit.laws import Rows, StepLaw, column

Array = npt.NDArray[np.float64]
HALT = 1e7  # a joint that much further from its stop than a step is creeping towards where its step size is 0


def step_through(law: StepLaw, rows: Rows, values: Array) -> npt.NDArray[np.int64]:
    """Step every traverse from where it starts until it is at its stop or beyond.

    What the closed forms and the quadrature approximate, one step after another; for tests and for
    measuring what they save.

    Parameters
    ----------
    law : StepLaw
    rows : mapping of str to array, shape (n,)
    values : array, shape (p,) or (n, p)

    Returns
    -------
    array of int, shape (n,)
        Steps made.

    Raises
    ------
    InputError
        If a joint comes to a halt.

    Examples
    --------
    >>> from stickslip_fit.laws import Prismatic
    >>> row = {"q2": [-np.pi / 2], "theta": [0.0], "psi": [0.0], "start": [0.0], "stop": [0.012]}
    >>> step_through(Prismatic(), row, np.array([976e-9, 0.3, 438e-9]))
    array([12296])
    """
    position, stop = column(rows, "start").copy(), column(rows, "stop")
    arrays = {name: rows[name] for name in (*law.columns, "start", "stop") if name in rows}
    values = np.broadcast_to(values, (len(position), len(law.parameters)))
    way = np.sign(stop - position)
    steps = np.zeros(len(position), np.int64)
    moving = way * (stop - position) > 0
    while moving.any():
        gamma = law.step_size(arrays, position[:, None], values)[:, 0]
        if np.any(HALT * gamma < np.abs(stop - position), where=moving):
            raise InputError(f"joint {law.joint} comes to a halt: its step size falls to 0 within a traverse")
        position = np.where(moving, position + way * gamma, position)
        steps += moving
        moving = way * (stop - position) > 0
    return steps
