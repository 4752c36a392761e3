"""What is known of each traverse, and what stands in where a quantity is not."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.laws import Rows, column

# A joint's first traverse of a session follows none.
FIRST = {"before_direction": "", "before_load": 0.0}
NEEDED = {
    "session": "the session's name",
    "session_seconds": "the time since the session's first traverse, s",
    "steps_before": "the steps that the joint has made so far",
}


def known_of(rows: Rows, columns: Iterable[str]) -> dict[str, Any]:
    """Start, stop and the given columns of each traverse, as arrays of shape (n,).

    A joint that nothing is said of follows no other traverse, under the log's mean conditions (as an empty
    cell does). How long a session has run and how many steps a joint has made have no such value.

    Raises
    ------
    InputError
        For a column that is not there and has none.

    Examples
    --------
    >>> known_of({"start": [0.0], "stop": [0.012]}, ["temperature"])["temperature"]
    array([nan])
    """
    known: dict[str, Any] = {"start": column(rows, "start"), "stop": column(rows, "stop")}
    lacking = [name for name in columns if name in NEEDED and name not in rows]
    if lacking:
        raise InputError([Problem(f"the law needs {NEEDED[name]}: give it", column=name) for name in lacking])
    for name in columns:
        stands_in = np.full(len(known["start"]), FIRST.get(name, np.nan))
        known[name] = np.asarray(rows[name]) if name in rows else stands_in
    return known
