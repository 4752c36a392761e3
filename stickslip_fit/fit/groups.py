"""Rows into groups: one set of a law's parameters for each session and direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.laws import travel
from stickslip_fit.logs import Log

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Groups:
    """The groups of one joint's rows.

    Attributes
    ----------
    table : DataFrame
        Columns session and direction, one row per group, in order of time.
    of_row : array of int, shape (n,)
        Group of each row.
    """

    table: pd.DataFrame
    of_row: Indices

    def __len__(self) -> int:
        return len(self.table)

    @property
    def sizes(self) -> Indices:
        """Rows in each group, shape (g,)."""
        return np.bincount(self.of_row, minlength=len(self))

    def sums(self, values: Array) -> Array:
        """Sum over each group's rows, shape (n,) -> (g,).

        Examples
        --------
        >>> rows = pd.DataFrame({"session": ["a", "a", "b"], "direction": ["+", "+", "-"]})
        >>> group_rows(rows).sums(np.array([1.0, 2.0, 4.0]))
        array([3., 4.])
        """
        return np.bincount(self.of_row, values, len(self))

    def of(self, some: npt.NDArray[np.bool_]) -> Groups:
        """Some of the groups, with nothing but their rows."""
        number = np.cumsum(some) - 1
        return Groups(self.table[some].reset_index(drop=True), number[self.of_row[some[self.of_row]]])


def group_rows(rows: pd.DataFrame) -> Groups:
    """Group rows, which stand in order of time, by session and direction."""
    session, sessions = pd.factorize(rows["session"].astype(object))
    backwards = (rows["direction"] == "-").to_numpy()
    kinds, of_row = np.unique(2 * session + backwards, return_inverse=True)
    table = pd.DataFrame(
        {
            "session": np.asarray(sessions, dtype=object)[kinds // 2],
            "direction": np.where(kinds % 2 == 1, "-", "+").astype(object),
        }
    )
    return Groups(table, of_row)


def mean_steps(groups: Groups, rows: pd.DataFrame, response: Array) -> Array:
    """Geometric mean of each group's step sizes, shape (g,); `response` is log(steps), shape (n,)."""
    return np.exp(groups.sums(np.log(travel(rows)) - response) / groups.sizes)


def usable_rows(log: Log) -> pd.DataFrame:
    """The traverses of a log that may be fitted.

    Raises
    ------
    InputError
        If there is none.
    """
    rows = log.usable
    if rows.empty:
        raise InputError("the log has no usable traverse: every row is interrupted or excluded")
    return rows
