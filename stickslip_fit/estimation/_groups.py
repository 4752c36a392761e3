"""The groups of a joint's rows, each of which has parameters of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.errors import InputError, check_type
from stickslip_fit.estimation._gaps import fill_gaps
from stickslip_fit.laws import traverse_length
from stickslip_fit.logs import Log


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
    of_row: IntArray

    def __len__(self) -> int:
        return self._number

    @cached_property
    def _number(self) -> int:
        return len(self.table)  # of a table it takes long, and every sum asks for it

    @cached_property
    def sizes(self) -> IntArray:
        """Rows in each group, shape (g,)."""
        return np.bincount(self.of_row, minlength=len(self))

    @cached_property
    def rows(self) -> list[IntArray]:
        """The rows of each group."""
        order = np.argsort(self.of_row, kind="stable")
        return np.split(order, np.cumsum(self.sizes)[:-1])

    def sums(self, values: Array) -> Array:
        """Sum over each group's rows, shape (n,) -> (g,).

        Examples
        --------
        >>> rows = pd.DataFrame({"session": ["a", "a", "b"], "direction": ["+", "+", "-"]})
        >>> group_rows(rows).sums(np.array([1.0, 2.0, 4.0]))
        array([3., 4.])
        """
        return np.bincount(self.of_row, values, len(self))

    def select(self, some: BoolArray) -> Groups:
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


def mean_step_sizes(groups: Groups, rows: pd.DataFrame, response: Array) -> Array:
    """Geometric mean of each group's step sizes, shape (g,); `response` is log(steps), shape (n,)."""
    return np.exp(groups.sums(np.log(traverse_length(rows)) - response) / groups.sizes)


def usable_rows(log: Log) -> pd.DataFrame:
    """The traverses of a log that may be fitted, gaps of smooth columns filled in (`fill_gaps`).

    Raises
    ------
    InputError
        If there is none, or `log` is no Log.
    """
    check_type("log", log, Log)
    rows = log.usable
    if rows.empty:
        raise InputError("the log has no usable traverse: every row is interrupted or excluded")
    return fill_gaps(rows)
