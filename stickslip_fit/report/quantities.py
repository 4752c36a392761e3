"""Whatever varied in a log, as the axes of figures have it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes.position import reversed_before
from stickslip_fit.logs.columns import CONDITIONS, COVARIATE
from stickslip_fit.machine.load import mean_load
from stickslip_fit.units import from_si

Array = npt.NDArray[np.float64]

BETWEEN = 0.04  # of all hours, between two sessions drawn one after the other
ONE_AFTER_THE_OTHER = "hours, sessions in a row"
HOURS = "hours in session"
OWN_STEPS = "own steps so far (millions)"
LOAD_BEFORE = "load of the traverse before"
REVERSED = "after a reversal (1) or not (0)"
HISTORY = {
    "session_seconds": HOURS,
    "steps_before": OWN_STEPS,
    "before_load": LOAD_BEFORE,
    "before_direction": REVERSED,
}


def label_of(column: str) -> str:
    """The axis that shows a column of the log best, if it is one that a cause follows by itself."""
    if column in CONDITIONS:
        return CONDITIONS[column].axis
    return HISTORY.get(column) or column.removeprefix(COVARIATE)


def quantities(rows: pd.DataFrame) -> dict[str, Array]:
    """What varied, by axis label, in people's units; NaN where it is not known.

    Parameters
    ----------
    rows : DataFrame
        Traverses of one or more joints.

    Returns
    -------
    dict of str to array, shape (n,)
        What people set first, then what came of itself.
    """
    return {label: values for label, values in _all(rows) if _varies(values)}


def _all(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    joint = rows["joint"].to_numpy()
    middle = ((rows["start"] + rows["stop"]) / 2).to_numpy(float)
    yield HOURS, from_si(rows["session_seconds"].to_numpy(float), "h")
    for name, condition in CONDITIONS.items():
        yield condition.axis, from_si(rows[name].to_numpy(float), condition.unit)
    yield "load along the axis", _load(rows)
    yield "q2 (°)", from_si(np.where(joint == 2, middle, rows["q2"].to_numpy(float)), "deg")
    yield "q3 (mm)", from_si(np.where(joint == 3, middle, rows["q3"].to_numpy(float)), "mm")
    yield "q1 (°)", from_si(np.where(joint == 1, middle, rows["q1"].to_numpy(float)), "deg")
    yield "theta (°)", from_si(rows["theta"].to_numpy(float), "deg")
    yield "psi (°)", from_si(rows["psi"].to_numpy(float), "deg")
    yield "steps (thousands)", rows["steps"].to_numpy(float) / 1e3
    yield LOAD_BEFORE, rows["before_load"].to_numpy(float)
    turned = reversed_before(rows["before_direction"], rows["direction"])
    yield REVERSED, turned.astype(float)
    for column in rows.columns:
        if column.startswith(COVARIATE):
            yield column.removeprefix(COVARIATE), rows[column].to_numpy(float)
    if rows["session"].nunique() > 1:
        yield ONE_AFTER_THE_OTHER, in_a_row(rows)
    yield OWN_STEPS, rows["steps_before"].to_numpy(float) / 1e6


def in_a_row(rows: pd.DataFrame) -> Array:
    """Hours, with the nights between sessions cut out."""
    hours = from_si(rows["session_seconds"].to_numpy(float), "h")
    lasts = pd.Series(hours).groupby(rows["session"].astype(object).to_numpy(), sort=False).max()
    begins = np.r_[0.0, np.cumsum(lasts.to_numpy() + BETWEEN * lasts.sum())[:-1]]
    begun = rows["session"].astype(object).map(dict(zip(lasts.index, begins, strict=True)))
    return hours + begun.to_numpy(float)


def _load(rows: pd.DataFrame) -> Array:
    load = np.zeros(len(rows))
    for joint in rows["joint"].unique():
        mine = (rows["joint"] == joint).to_numpy()
        at = [rows[name].to_numpy(float)[mine] for name in ("start", "stop", "q1", "q2", "theta", "psi")]
        load[mine] = mean_load(int(joint), *at)
    return load


def _varies(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 1 and bool(np.ptp(known) > 1e-6 * max(1.0, float(np.abs(known).max())))
