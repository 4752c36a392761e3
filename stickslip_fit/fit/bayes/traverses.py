"""One joint's traverses in one direction, laid out session by session."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.fit.groups import Groups, group_rows, usable_rows
from stickslip_fit.laws import StepLaw, published_law
from stickslip_fit.logs import Log

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# Rows for which the law is evaluated at a time: enough to drown the cost of a call, and in cache.
ROWS_AT_A_TIME = 20_000


@dataclass(frozen=True, eq=False)
class Traverses:
    """What is fitted: log steps under a law.

    Attributes
    ----------
    law : StepLaw
    rows : DataFrame
        The n rows.
    groups : Groups
        Their S sessions.
    y, rounding : array, shape (n,)
        log(steps) and the variance that the rounding adds; see `StepLaw.response`.
    place : array of int, shape (S, m)
        Positions of each session's rows, -1 beyond its last.
    first, like : array of int
        Rows of which no two are replicates, and for each row the place of its like among them.
    """

    law: StepLaw
    rows: pd.DataFrame
    groups: Groups
    y: Array
    rounding: Array
    place: Indices
    first: Indices
    like: Indices

    def padded(self, column: Array, fill: float) -> Array:
        """A column, shape (n, ...), session by session, shape (S, m, ...)."""
        beyond = (self.place < 0).reshape(*self.place.shape, *[1] * (column.ndim - 1))
        return np.where(beyond, fill, column[self.place])

    def predict(self, values: Array) -> Array:
        """log(steps) by each draw of the sessions' parameters, shape (d, S, p) -> (d, n); NaN at a stall."""
        distinct = values[:, self.groups.of_row[self.first]]
        return predict_draws(self.law, self.rows.iloc[self.first], distinct)[:, self.like]


def each_group(log: Log) -> Iterator[tuple[int, str, Traverses]]:
    """Every joint and direction of a log with its usable traverses, under the published law.

    Raises
    ------
    InputError
        If no traverse is usable.
    """
    rows = usable_rows(log)
    for joint in log.joints:
        mine = rows[rows["joint"] == joint]
        for direction in ("+", "-"):
            these = mine[mine["direction"] == direction]
            if len(these):
                # Both directions have one law, whatever reaches each of them covers.
                yield joint, direction, lay_out(published_law(joint, mine, log.machine), these)


def lay_out(law: StepLaw, rows: pd.DataFrame) -> Traverses:
    """Lay out the rows of one joint and direction."""
    groups = group_rows(rows)
    y, rounding = law.response(rows)
    order = np.argsort(groups.of_row, kind="stable")
    ends = np.cumsum(groups.sizes)
    place = np.full((len(groups), int(groups.sizes.max())), -1)
    within = np.arange(len(order)) - (ends - groups.sizes)[groups.of_row[order]]
    place[groups.of_row[order], within] = order
    alike = list(dict.fromkeys(["session", *law.columns, "start", "stop"]))
    kind = rows.groupby(alike, dropna=False, observed=True, sort=False).ngroup().to_numpy()
    _, first, like = np.unique(kind, return_index=True, return_inverse=True)
    return Traverses(law, rows, groups, y, rounding, place, first, like)


def predict_draws(law: StepLaw, rows: pd.DataFrame, values: Array) -> Array:
    """log(steps) of n rows under d draws of their parameters, shape (d, n, p) -> (d, n)."""
    draws, n, p = values.shape
    at_a_time = min(max(ROWS_AT_A_TIME // n, 1), draws)
    predict = _response(law, rows.iloc[np.tile(np.arange(n), at_a_time)])
    found = np.empty((draws, n))
    for first in range(0, draws, at_a_time):
        # The last block reaches back, so that one laying out serves all blocks.
        first = min(first, draws - at_a_time)
        block = values[first : first + at_a_time].reshape(-1, p)
        found[first : first + at_a_time] = predict(block).reshape(at_a_time, n)
    return found


def _response(law: StepLaw, rows: pd.DataFrame) -> Callable[[Array], Array]:
    """log(steps) as a function of the values; without derivatives where these take most of the time."""
    if not isinstance(law, ExtendedLaw):
        model = law.model(rows)
        return lambda values: model(values)[0]
    steps = law.steps(rows)

    def predict(values: Array) -> Array:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(steps(values))

    return predict
