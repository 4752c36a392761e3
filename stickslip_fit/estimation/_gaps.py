"""Empty cells of what a lab reads beside its counts, filled in where the readings next to them tell."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX

SET_BY_HAND = ("payload",)  # what changes in steps has no value between two readings
MAX_ERROR = 0.7  # of values between two readings, over that of the session's mean
MIN_READINGS = 10  # that can be compared with the readings beside them


def fill_gaps(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of a log in order of time, empty cells of conditions and covariates filled in, session by session.

    A cell has the value on the line through the readings before and after it in its session, or the nearest
    one, if the column is so smooth that this predicts its readings better than the session's mean does.
    Others stay empty: a cause takes the column's mean there.
    """
    names = [
        str(name)
        for name in rows.columns
        if (name in CONDITIONS or str(name).startswith(COVARIATE_PREFIX))
        and name not in SET_BY_HAND
        and rows[name].dtype.kind == "f"
        and rows[name].isna().any()
    ]
    filled = {name: own for name in names if (own := _interpolate(rows, name)) is not None}
    return rows.assign(**filled) if filled else rows


def _interpolate(rows: pd.DataFrame, name: str) -> Array | None:
    """A column with its gaps filled in; None where its readings do not tell what is between them."""
    values = rows[name].to_numpy(float).copy()
    clock = rows["session_seconds"].to_numpy(float) if "session_seconds" in rows else np.arange(len(rows))
    errors, departures = [], []
    for _, places in rows.groupby("session", sort=False).indices.items():
        known = places[np.isfinite(values[places])]
        if not len(known):
            continue
        t, x = clock[known], values[known]
        if len(known) > 2:
            width = np.maximum(t[2:] - t[:-2], np.finfo(float).tiny)
            errors.append(x[1:-1] - x[:-2] - (x[2:] - x[:-2]) * (t[1:-1] - t[:-2]) / width)
            departures.append(x[1:-1] - x.mean())
        empty = np.setdiff1d(places, known)
        values[empty] = np.interp(clock[empty], t, x)
    if sum(map(len, errors)) < MIN_READINGS:
        return None
    error, departure = (np.sqrt(np.mean(np.concatenate(one) ** 2)) for one in (errors, departures))
    return values if error <= MAX_ERROR * departure else None
