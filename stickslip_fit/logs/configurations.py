"""Which configurations a log covers, in which directions, and how often."""

from __future__ import annotations

import numpy as np
import pandas as pd

# Finer than anything that can be set, coarser than what unit conversion rounds off (rad, m).
_DECIMALS = 10
_POSITION = ["q1", "q2", "q3", "theta", "psi", "low", "high"]


def configurations(rows: pd.DataFrame) -> pd.DataFrame:
    """Count the traverses of each configuration.

    Parameters
    ----------
    rows : DataFrame
        Rows of a Log.

    Returns
    -------
    DataFrame
        One row per session, joint and configuration, in that order: session, joint, q1, q2, q3 (NaN for
        the moving joint), theta, psi, low and high (the stretch traversed, rad or m), ``+`` and ``-``
        (traverses in each direction), replicates (those that repeat another of the same direction).
    """
    table = rows[["session", "joint", "q1", "q2", "q3", "theta", "psi"]].assign(
        low=np.minimum(rows["start"], rows["stop"]),
        high=np.maximum(rows["start"], rows["stop"]),
        forward=(rows["direction"] == "+").astype(np.int64),
        backward=(rows["direction"] == "-").astype(np.int64),
    )
    # Adding zero makes -0.0 and 0.0 one configuration to look at, as they are to the joint.
    with np.errstate(over="ignore"):
        table[_POSITION] = table[_POSITION].round(_DECIMALS) + 0.0
    counts = table.groupby(["session", "joint", *_POSITION], dropna=False, sort=True)[["forward", "backward"]]
    found = counts.sum().reset_index().rename(columns={"forward": "+", "backward": "-"})
    return found.assign(replicates=(found["+"] - 1).clip(lower=0) + (found["-"] - 1).clip(lower=0))
