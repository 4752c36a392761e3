"""Logged conditions that steps follow late, as the temperature of a piezo follows that of the room.

No cause has a lag; where what the causes and structure without a name explain together is what a column was
some time before, that is told. The lag is a delay, or that of a body that follows its surroundings
exponentially, which sees them through a low-pass filter with one time constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.testability import is_log
from stickslip_fit.logs.fading import Fading
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, has_times

LAGS = 60.0 * np.array([2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0])  # s
MIN_SHARE, MIN_MORE = 0.6, 0.15  # of what is explained; by how much more than without a lag


@dataclass(frozen=True)
class LaggedColumn:
    """A column that structure follows with a lag.

    Attributes
    ----------
    lag : float
        That explains most, s.
    share, without_lag : float
        Of the structure's square, explained by the column with this lag and as it is.
    """

    column: str
    lag: float
    share: float
    without_lag: float


def find_lagged_column(linearized: LinearizedFit, shape: Array) -> LaggedColumn | None:
    """The column that with a lag explains most of whitened structure, shape (n,); None if none does.

    Of logs with times; a table says nothing of the unit of its time.
    """
    rows, found = linearized.rows, []
    if not is_log(linearized) or not has_times(rows):
        return None
    for name in (one for one in rows if one in CONDITIONS or str(one).startswith(COVARIATE_PREFIX)):
        values = rows[name].to_numpy(float)
        if not np.isfinite(values).all() or not np.ptp(values):
            continue
        late = [follow(rows, values, lag) for follow in (delay, low_pass) for lag in LAGS.tolist()]
        columns = linearized.project(linearized.whiten(np.stack([values, *late], axis=1) - values.mean()))
        squares = np.maximum(np.sum(columns**2, axis=0) * (shape @ shape), np.finfo(float).tiny)
        without, *shares = ((columns.T @ shape) ** 2 / squares).tolist()
        best = int(np.argmax(shares))
        found.append(LaggedColumn(name, float(LAGS[best % len(LAGS)]), shares[best], without))
    most = max(found, key=lambda one: one.share, default=None)
    if most is None or most.share < max(MIN_SHARE, most.without_lag + MIN_MORE):
        return None
    return most


def delay(rows: pd.DataFrame, values: Array, lag: float) -> Array:
    """Values some time before, linear between rows, and a session's first before it; as `low_pass`."""
    late = values.copy()
    for places in rows.groupby("session", sort=False, observed=True).indices.values():
        seconds = rows["session_seconds"].to_numpy(float)[places]
        late[places] = np.interp(seconds - lag, seconds, values[places])
    return late


def low_pass(rows: pd.DataFrame, values: Array, lag: float) -> Array:
    """Values as a body of one time constant follows them in each session, see `Fading`.

    Parameters
    ----------
    rows : DataFrame
        With session and session_seconds, those of each session in order of time.
    values : array, shape (n,)
    lag : float
        Time constant, s.
    """
    session = pd.factorize(rows["session"].astype(object))[0].astype(np.int64)
    return Fading(rows["session_seconds"].to_numpy(float), session, lag).follow(values)
