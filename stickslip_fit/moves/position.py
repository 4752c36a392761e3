"""Where a joint stands after so many steps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Rows, StepLaw, column

Array = npt.NDArray[np.float64]

MOST_ITERATIONS = 60
CLOSE = 1e-6  # of a step; Newton's method doubles the digits once more as it settles


def position_after(law: StepLaw, rows: Rows, values: Array, steps: npt.ArrayLike) -> Array:
    """Positions of the moving joint after so many steps from where each traverse starts.

    Solves counts(start, x) = steps for x by Newton's method, whose derivative is 1 / step size, kept
    between what is known to be too short and too far.

    Parameters
    ----------
    law : StepLaw
    rows : mapping of str to array, shape (n,)
        Traverses in a log's columns; a joint that meets its row's stop stays there.
    values : array, shape (p,) or (n, p)
        The law's parameters.
    steps : array_like, shape (n,) or ()
        0 or more, not necessarily whole.

    Returns
    -------
    array, shape (n,)
        rad or m.

    Raises
    ------
    InputError
        If a joint comes to a halt on its way.

    Examples
    --------
    >>> from stickslip_fit.laws import Prismatic
    >>> rows = {"q2": [-np.pi / 2] * 3, "theta": [0.0] * 3, "psi": [0.0] * 3, "start": [0.0] * 3}
    >>> values = np.array([976e-9, 0.3, 438e-9])
    >>> position_after(Prismatic(), rows | {"stop": [0.012] * 3}, values, [0, 1000, 20000]).round(9)
    array([0.      , 0.000976, 0.012   ])
    """
    start, stop = column(rows, "start"), column(rows, "stop")
    values = np.broadcast_to(values, (len(start), len(law.parameters)))
    known = {name: np.asarray(rows[name]) for name in (*law.columns, "start", "stop") if name in rows}
    steps = np.broadcast_to(np.asarray(steps, float), start.shape)
    way, whole = np.sign(stop - start), np.abs(stop - start)
    short, far = np.zeros(len(start)), np.full(len(start), np.inf)
    gamma = law.step_size(known, start[:, None], values)[:, 0]
    gone = np.minimum(steps * gamma, whole)
    left = np.flatnonzero((steps > 0) & (whole > 0))
    _refuse_halt(law, gamma[left])
    for _ in range(MOST_ITERATIONS):
        here, there = {name: of[left] for name, of in known.items()}, gone[left]
        at = here["start"] + way[left] * there
        excess = _counts(law, here | {"stop": at}, values[left]) - steps[left]
        gamma = law.step_size(here, at[:, None], values[left])[:, 0]
        _refuse_halt(law, np.where(np.isnan(excess), 0.0, gamma))
        short[left] = np.where(excess > 0, short[left], there)
        far[left] = np.where(excess > 0, there, far[left])
        better = there - excess * gamma
        middle = (short[left] + np.minimum(far[left], whole[left])) / 2
        better = np.where((better < short[left]) | (better > far[left]), middle, better)
        gone[left] = np.minimum(better, whole[left])
        left = left[np.abs(gone[left] - there) > CLOSE * gamma]
        if not len(left):
            break
    return np.where(gone >= whole, stop, start + way * gone)


def _counts(law: StepLaw, rows: Rows, values: Array) -> Array:
    """Steps over each traverse; where a cause adds some, they may be 0 or fewer."""
    return law.steps(rows)(values) if isinstance(law, ExtendedLaw) else law.counts(rows, values)[0]


def _refuse_halt(law: StepLaw, gamma: Array) -> None:
    if not np.all(gamma > 0):
        raise InputError(
            f"joint {law.joint} comes to a halt on its way: its law gives a step size of zero or less there"
        )
