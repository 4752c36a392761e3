"""Columns that the response follows late, as the temperature of a piezo follows that of the room.

No cause of a log has a lag; where what the causes and structure without a name explain together is what a
column was some time before, that is told. The lag is a delay, or that of a body that follows its surroundings
exponentially, which sees them through a low-pass filter with one time constant. Where a table's times are
regular, a column that explains clearly more through such a filter, in the noise that is likeliest beside it,
is searched as one more column (`causes.late_columns`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.late_columns import find_late, low_pass, name_late, parse_late
from stickslip_fit.diagnosis.autocorrelation import Autocorrelation
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.mean_structure import Mean, most_explained
from stickslip_fit.diagnosis.testability import is_log
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, has_times

LAGS = 60.0 * np.array([2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0])  # s
MIN_SHARE, MIN_MORE = 0.6, 0.15  # of what is explained; by how much more than without a lag
N_LAGS, N_FINER = 10, 11  # of a table; between the two next to the best
MIN_SPACINGS, MAX_RECORD = 2.0, 0.25  # its lags are from so many intervals to such a part of the record
MIN_ADVANTAGE = 6.0  # nats over the column as it is, beside the logarithm of the number of trials


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


def find_late_columns(
    linearized: LinearizedFit, columns: Sequence[str], sample: IntArray, time_unit: str
) -> dict[str, tuple[str, float]]:
    """Columns of a table that explain clearly more with a lag, as of `late_columns.find_late`.

    Parameters
    ----------
    linearized : LinearizedFit
        Of n rows, whose noise counts as independent.
    columns : sequence of str
        Of numbers; at most one lag of each is taken.
    sample : array of int, shape (n,)
        As of `Autocorrelation`.
    time_unit : str
        Of session_seconds.
    """
    rows, n = linearized.rows, len(linearized)
    spacing = rows.groupby("session")["session_seconds"].diff()
    shortest = MIN_SPACINGS * float(spacing[spacing > 0].median())
    longest = MAX_RECORD * float(rows["session_seconds"].max())
    if not (columns and shortest < longest):
        return {}
    plain, independent = Mean.of(linearized, np.zeros((n, 0)), sample), Autocorrelation(sample, None)
    lags, found = np.geomspace(shortest, longest, N_LAGS), dict[str, tuple[str, float]]()
    for column in columns:
        as_it_is = plain.extend(linearized, _linear_effect(linearized, rows[column].to_numpy(float)))
        least = max(plain.value, as_it_is.value) + MIN_ADVANTAGE + float(np.log(len(columns) * N_LAGS))
        search = partial(_find_lag, linearized, column, time_unit, plain)
        name, beside = max(
            (search(lags, independent), search(lags, plain.noise)), key=lambda one: one[1].value
        )
        if beside.value > least and (late := parse_late(name, time_unit)):
            finer = late[1] * (lags[1] / lags[0]) ** np.linspace(-1.0, 1.0, N_FINER)
            found |= find_late([search(finer, beside.noise)[0]], [column], time_unit)
    return found


def _find_lag(
    linearized: LinearizedFit, column: str, time_unit: str, plain: Mean, lags: Array, under: Autocorrelation
) -> tuple[str, Mean]:
    """Name of a column with that of some lags which explains most under some noise, and the mean with it."""
    rows, names = linearized.rows, [name_late(column, lag, time_unit) for lag in lags.tolist()]
    late = find_late(names, [column], time_unit)
    values = rows[column].to_numpy(float)
    effects = [_linear_effect(linearized, low_pass(rows, values, lag)) for _, lag in late.values()]
    best = most_explained(linearized, effects, plain.columns, under)
    return [*late][best], plain.extend(linearized, effects[best])


def _linear_effect(linearized: LinearizedFit, values: Array) -> Array:
    """Standardized values as the test of a signal sees them, shape (n, 1)."""
    standard = (values - values.mean()) / (float(np.std(values)) or 1.0)
    return linearized.project(linearized.whiten(standard[:, None]))


def delay(rows: pd.DataFrame, values: Array, lag: float) -> Array:
    """Values some time before, linear between rows, and a session's first before it; as `low_pass`."""
    late = values.copy()
    for places in rows.groupby("session", sort=False, observed=True).indices.values():
        seconds = rows["session_seconds"].to_numpy(float)[places]
        late[places] = np.interp(seconds - lag, seconds, values[places])
    return late
