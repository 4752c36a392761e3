"""What comes and goes, laid period over period."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.units import from_si

Array = npt.NDArray[np.float64]
PERIOD = re.compile(r"period of ([0-9.]+) (min|traverses)")


def folded(carrier: str, rows: pd.DataFrame, shape: Array) -> tuple[str, Array] | None:
    """Where in its period each row stands, if a finding's carrier is a period.

    Parameters
    ----------
    carrier : str
        As `Finding.carrier`, e.g. "period of 50.0 min".
    rows : DataFrame
        A log's, n of them.
    shape : array, shape (n,)
        What the finding does to each row. A session begins its periods where that is largest: what comes and
        goes in a room takes no notice of when a session begins.

    Returns
    -------
    tuple of str and array, shape (n,), or None
        A label, and minutes or traverses since the last time it was largest.
    """
    found = PERIOD.fullmatch(carrier)
    if found is None:
        return None
    period, unit = float(found[1]), found[2]
    session = pd.factorize(rows["session"].astype(object))[0]
    minutes = from_si(rows["session_seconds"].to_numpy(float), "min")
    clock = minutes if unit == "min" else rows.groupby(session).cumcount().to_numpy(float)
    angle = 2 * np.pi * clock / period
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    largest = np.zeros(len(rows))
    for each in np.unique(session):
        mine = session == each
        size = np.linalg.lstsq(waves[mine], shape[mine], rcond=None)[0]
        largest[mine] = np.arctan2(size[1], size[0])
    share = np.mod(angle - largest, 2 * np.pi) / (2 * np.pi)
    counted = "minutes" if unit == "min" else unit
    return f"{counted} into a period of {period:g} {unit}", share * period
