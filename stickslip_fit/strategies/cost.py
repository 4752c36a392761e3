"""What traverses cost: the steps themselves, and what people and base need between them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.logs.plan import Timing

Array = npt.NDArray[np.float64]


def stepping_seconds(rows: pd.DataFrame) -> Array:
    """Steps times step period, shape (n,); where the log has no period, that which plans take without one."""
    return rows["steps"].to_numpy(float) * rows["step_period"].fillna(Timing().step_period).to_numpy(float)


def handling_seconds(rows: pd.DataFrame) -> float:
    """From the end of a traverse to the beginning of the next, the median over a log; 0 for one traverse.

    Nights and lunch breaks are long but few, so that the median does not see them.

    Parameters
    ----------
    rows : DataFrame
        All rows of a log in order of time, whatever their status.

    Examples
    --------
    >>> times = pd.to_datetime(["2012-03-05T09:00:00", "2012-03-05T09:03:00", "2012-03-05T09:05:00"])
    >>> rows = pd.DataFrame({"session": "Mon", "time": times, "steps": 10_000, "step_period": 0.01})
    >>> handling_seconds(rows)
    50.0
    """
    following = rows["session"].to_numpy()[1:] == rows["session"].to_numpy()[:-1]
    apart = rows["time"].diff().dt.total_seconds().to_numpy()[1:]
    idle = (apart - stepping_seconds(rows)[:-1])[following]
    return float(np.median(np.maximum(idle, 0.0))) if len(idle) else 0.0
