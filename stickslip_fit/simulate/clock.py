"""When each simulated traverse begins: what the steps take, and what a person takes between them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Plan


def begin_times(plan: Plan, rows: pd.DataFrame, wait: npt.NDArray[np.float64]) -> npt.NDArray[np.datetime64]:
    """The time at which each traverse of a plan begins, to the second.

    Parameters
    ----------
    plan : Plan
    rows : DataFrame
        The plan's rows, with steps.
    wait : array, shape (n,)
        How patiently a person works, between 0 and 1; a session's first entry is not used.

    Raises
    ------
    InputError
        If a session is not over when the next one begins.
    """
    count = plan.traverses_per_session
    busy = (rows["steps"] * rows["step_period"]).to_numpy().reshape(-1, count)
    anew = np.diff(rows["visit"], prepend=0).reshape(-1, count) != 0
    (quick_pause, slow_pause), (quick_turn, slow_turn) = plan.timing.pause, plan.timing.turn
    shortest, longest = np.where(anew, quick_pause, quick_turn), np.where(anew, slow_pause, slow_turn)
    between = shortest + (longest - shortest) * wait.reshape(-1, count)
    # At least a second apart, so that no two traverses of a joint carry the same time.
    gaps = np.maximum(np.ceil(busy[:, :-1] + between[:, 1:]), 1).astype(np.int64)
    elapsed = np.cumsum(np.concatenate([np.zeros((len(gaps), 1), np.int64), gaps], axis=1), axis=1)
    begins = np.array([session.begins for session in plan.sessions], dtype="datetime64[s]")
    _check_overlap(plan, begins, elapsed[:, -1] + np.ceil(busy[:, -1]).astype(np.int64))
    return (begins[:, None] + elapsed).ravel()


def _check_overlap(plan: Plan, begins: npt.NDArray[np.datetime64], length: npt.NDArray[np.int64]) -> None:
    late = begins[:-1] + length[:-1] > begins[1:]
    if late.any():
        number = int(np.argmax(late))
        this, following = plan.sessions[number : number + 2]
        raise InputError(
            f"session {this.label!r} takes {length[number] / 3600:.1f} h and is not over when session "
            f"{following.label!r} begins; plan fewer traverses, shorter pauses or a later date"
        )
