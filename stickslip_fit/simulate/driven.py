"""A plan driven through: what is counted, when, and what came before each traverse."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.laws import StepLaw
from stickslip_fit.logs.history import add_history
from stickslip_fit.logs.plan import Plan
from stickslip_fit.simulate.clock import begin_times

MOST_PASSES = 20
HISTORY = {"session_seconds": 0.0, "before_direction": "", "before_load": 0.0, "steps_before": 0}


def drive_through(
    plan: Plan,
    rows: pd.DataFrame,
    wait: npt.NDArray[np.float64],
    seen: Callable[[pd.DataFrame], npt.NDArray[np.int64]],
    laws: Iterable[StepLaw],
) -> pd.DataFrame:
    """A plan's rows with steps, time and history.

    Where a law has causes in it, a count may depend on what came before, and the time of what comes after
    on the count; a few passes make both agree.

    Parameters
    ----------
    plan : Plan
    rows : DataFrame
        Its rows, with whatever else the laws look at.
    wait : array, shape (n,)
        See `begin_times`.
    seen : callable
        From rows with their history to the counts, shape (n,).
    laws : iterable of StepLaw
        By which they are counted.
    """
    passes = MOST_PASSES if any(looks_back(law) for law in laws) else 1
    known = rows.assign(**HISTORY)
    for _ in range(passes):
        steps = seen(known)
        if "steps" in known and np.array_equal(steps, known["steps"]):
            break
        known["steps"] = steps
        known["time"] = begin_times(plan, known, wait).astype("datetime64[ns]")
        known = add_history(known)
    return known


def looks_back(law: StepLaw) -> bool:
    """Whether a law's counts depend on what came before a traverse."""
    return not HISTORY.keys().isdisjoint(law.columns)
