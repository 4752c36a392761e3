"""Least squares of a law of a table: each session's own parameters and those that all sessions share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.estimation._block_arrow import share_with_all, solve_block_arrow
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.estimation._optimize import Minimum

MAX_SEARCHES = 20  # sessions whose own start is searched


def fit_table_law(law: Any, rows: pd.DataFrame, y: Array, scale: Array) -> Array:
    """Fit a law of a table; see `minimize_table_law`.

    Returns
    -------
    array, shape (n, p)
        Each row's own values, those of its session and the shared ones.
    """
    return minimize_table_law(law, rows, y, scale).values[_sessions(rows).of_row]


def minimize_table_law(law: Any, rows: pd.DataFrame, y: Array, scale: Array) -> Minimum:
    """The minimum of the sum of squares, weighted by 1 / scale^2, over each session's and shared parameters.

    Parameters
    ----------
    rows : DataFrame
        With the law's columns; ``session`` names each row's session, one for all without it.
    y, scale : array, shape (n,)
        Responses and their standard deviations.
    """
    sessions, p = _sessions(rows), len(law.parameters)
    shared = np.arange(p) >= p - law.n_shared
    start = np.tile(law.start_values(rows, y), (len(sessions), 1))
    if len(sessions) > 1 and law.n_shared == 0:
        start = _start_sessions(law, rows, y, sessions, start[0])
    scales = _scales(law, rows, y, start[sessions.of_row])
    lower, upper = np.array([(one.lower, one.upper) for one in law.parameters]).reshape(p, 2).T
    return solve_block_arrow(
        law.model(rows), y, 1.0 / scale**2, sessions, share_with_all(shared, sessions), start,
        np.tile(scales, (len(sessions), 1)), lower=lower, upper=upper,
    )  # fmt: skip


def _start_sessions(law: Any, rows: pd.DataFrame, y: Array, sessions: Groups, whole: Array) -> Array:
    """Where each session begins, shape (g, p): of many sessions most near the values of others."""
    searched = set(np.linspace(0, len(sessions) - 1, min(len(sessions), MAX_SEARCHES)).astype(int).tolist())
    start, known = np.tile(whole, (len(sessions), 1)), [whole]
    for group in sorted(range(len(sessions)), key=lambda one: one not in searched):
        inside = sessions.of_row == group
        near = None if group in searched else known
        start[group] = law.start_values(rows.iloc[inside], y[inside], near)
        known += [start[group]] if group in searched else []
    return start


def _sessions(rows: pd.DataFrame) -> Groups:
    if "session" not in rows:
        return Groups(pd.DataFrame({"session": [""]}), np.zeros(len(rows), dtype=np.intp))
    numbers, names = pd.factorize(rows["session"].astype(object))
    return Groups(pd.DataFrame({"session": names}), numbers)


def _scales(law: Any, rows: pd.DataFrame, y: Array, values: Array) -> Array:
    """A change of each parameter that matters: that by which the response moves as much as it varies."""
    slopes = law.jacobian(rows, values)
    moved = np.sqrt(np.nanmean(slopes**2, axis=0))
    size = float(np.std(y)) or 1.0
    return np.where(moved > 0, size / np.where(moved > 0, moved, 1.0), 1.0)
