"""Where a joint stands after so many steps."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit.laws import StepLaw

MOST_ITERATIONS = 60


def position_after(law: StepLaw, row: pd.DataFrame, values: np.ndarray, steps: float) -> float:
    """Position of the moving joint after `steps` from its start.

    Solves counts(start, x) = steps for x by Newton's method, whose derivative is 1 / step size, kept
    inside the traverse.

    Parameters
    ----------
    law : StepLaw
    row : DataFrame, one row
        A traverse in a log's columns; its stop is the end that the joint may not pass.
    values : array, shape (p,)
        The law's parameters.
    steps : float
        At most the steps of the whole traverse.

    Returns
    -------
    float
        rad or m.
    """
    start, stop = float(row["start"].iloc[0]), float(row["stop"].iloc[0])
    way = np.sign(stop - start)
    low, high = 0.0, abs(stop - start)
    gone = min(steps * _step_at(law, row, values, start), high)
    for _ in range(MOST_ITERATIONS):
        if gone <= 0.0:
            return start
        trial = row.assign(stop=start + way * gone)
        excess = float(law.counts(trial, values)[0][0]) - steps
        low, high = (low, gone) if excess > 0 else (gone, high)
        better = gone - excess * _step_at(law, row, values, start + way * gone)
        if not low <= better <= high:
            better = (low + high) / 2
        if abs(better - gone) <= 1e-13 * abs(stop - start):
            break
        gone = better
    return start + way * gone


def _step_at(law: StepLaw, row: pd.DataFrame, values: np.ndarray, position: float) -> float:
    return float(law.step_size(row, np.array([[position]]), values)[0, 0])
