"""Moments at which something may have changed, and what lasts from there on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes.cause import CauseParameter
from stickslip_fit.laws import State

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# In a session, in a log, and as many as a session has in any case: between two of them a change is seen
# nearly as well.
MOST, ABOUT, LEAST = 120, 700, 6
FEWEST = 3  # traverses on either side


def moments(rows: pd.DataFrame) -> list[tuple[str, Array]]:
    """Halfway between traverses, for each session that has enough of them; s from its first."""
    found, every = [], len(rows) / ABOUT
    for session, mine in rows.groupby(rows["session"].astype(object), sort=False):
        seconds = np.unique(mine["session_seconds"].to_numpy(float))
        between = ((seconds[1:] + seconds[:-1]) / 2)[FEWEST - 1 : 1 - FEWEST]
        if len(between):
            apart = max(len(between) / MOST, min(every, len(between) / LEAST))
            found.append((str(session), between[:: int(np.ceil(apart))]))
    return found


def moment_of(session: str) -> CauseParameter:
    """The parameter that says when, in a session, something changed for good."""
    meaning = "when, from the session's first traverse"
    return CauseParameter("moment", "min", meaning, lower=0.0, session=session, sudden=True)


def since(state: State, session: str, moment: Array) -> Mask:
    """Whether each traverse is one of a session and begins at its moment or later; (n, 1) -> (n, 1)."""
    mine = np.asarray(state.row["session"], dtype=object) == session
    return mine[:, None] & (state.column("session_seconds") >= moment)


def changes_since(
    changes: Callable[[dict[str, Any], Array, Array], Array],
    known: dict[str, Any],
    values: Array,
    session: str,
    trials: Array,
) -> Array:
    """Changes by trials (size, moment): those that a size makes at all times, from its moment on.

    Parameters
    ----------
    changes : callable
        As `Cause.changes`, of a cause that changes a traverse by the whole or not at all.
    known : dict of str to array, shape (n,)
    values : array, shape (n, p)
    session : str
    trials : array, shape (m, 2)

    Returns
    -------
    array, shape (n, m)
    """
    found = np.zeros((len(values), len(trials)))
    mine = np.flatnonzero(np.asarray(known["session"], dtype=object) == session)
    sizes, which = np.unique(trials[:, 0], return_inverse=True)
    at_all_times = np.column_stack([sizes, np.full(len(sizes), -np.inf)])
    there = {name: of[mine] for name, of in known.items()}
    after = there["session_seconds"][:, None] >= trials[:, 1]
    found[mine] = changes(there, values[mine], at_all_times)[:, which] * after
    return found
