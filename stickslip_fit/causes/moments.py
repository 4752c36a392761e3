"""Moments at which something may have changed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

MOST = 120  # in a log; between two of them a change is seen nearly as well
FEWEST = 3  # traverses on either side


def moments(rows: pd.DataFrame) -> list[tuple[str, npt.NDArray[np.float64]]]:
    """Halfway between traverses, for each session that has enough of them; s from its first."""
    found, every = [], -(-len(rows) // MOST)
    for session, mine in rows.groupby(rows["session"].astype(object), sort=False):
        seconds = np.unique(mine["session_seconds"].to_numpy(float))
        between = ((seconds[1:] + seconds[:-1]) / 2)[FEWEST - 1 : 1 - FEWEST]
        if len(between):
            found.append((str(session), between[:: min(every, -(-len(between) // 2))]))
    return found
