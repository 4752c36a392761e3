"""Carriers: the coordinates, columns of history and columns of the log that vary along a log's traverses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.proposed import (
    ANGLES,
    BEFORE_DIRECTION,
    LENGTH,
    LOAD,
    LOADS,
    POSITION,
    ZETA,
    carrier_values,
)
from stickslip_fit.causes.smooth import cosine_sequence, cosines, prior_sds
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.laws import State, state_at
from stickslip_fit.logs.history import FURTHER_HISTORY, PAST, TIME_OF_DAY, condition_of
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, position_columns

LENGTHS = (0.25, 0.1)  # correlation lengths of functions of a carrier, of its range
BEYOND = 0.15  # of a range of positions, by which that of its functions is wider on either side
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)  # of a carrier along a traverse
HISTORY = ("session_seconds", TIME_OF_DAY, "steps_before", "before_load", BEFORE_DIRECTION)
FURTHER_OF_TRAVERSE = tuple(name for name in FURTHER_HISTORY if name not in ("session_order", TIME_OF_DAY))
# Correlation, above which a condition's past would only stand beside the condition as its rival, or the time
# of day beside that in the session.
MAX_ALIKE = 0.95
SOME_VALUES = 1000  # of a carrier, among which distinct ones are counted first
# Distinct values of a carrier with which it has all functions.
ENOUGH_DISTINCT = 2 + len(prior_sds(min(LENGTHS) / (1.0 + 2.0 * BEYOND)))


@dataclass(frozen=True, eq=False)
class Carrier:
    """A variable along the traverses of a log.

    Attributes
    ----------
    values : array, shape (n, k) or (n, 1)
        NaN where it is unknown.
    low, high : float
        Its range.
    distinct : int
        Number of distinct values; where there are `ENOUGH_DISTINCT`, of a part of them.
    """

    name: str
    values: Array
    low: float
    high: float
    distinct: int

    def waves(self, number: int) -> Array:
        """Cosines over the range, averaged along each traverse, shape (n, number); 0 where it is unknown."""
        waves, known = np.empty((len(self.values), number)), np.isfinite(self.values)
        values = np.where(known, self.values, self.low)
        for k, cosine in enumerate(cosine_sequence(values, self.low, self.high, number)):
            waves[:, k] = traverse_average(cosine * known)
        return waves

    def wave(self, order: int) -> Array:
        """A cosine along each traverse, shape (n, k) or (n, 1); 0 where it is unknown."""
        if order not in self._waves:
            self._waves[order] = np.nan_to_num(cosines(self.values, self.low, self.high, order)[..., -1])
        return self._waves[order]

    @cached_property
    def _waves(self) -> dict[int, Array]:
        return {}


def traverse_average(values: Array) -> Array:
    """A function averaged along each traverse, (n, k) or (n, 1) -> (n,)."""
    return values[:, 0] if values.shape[1] == 1 else values @ (WEIGHTS / 2)


def find_carriers(table: RowTable) -> tuple[Carrier, ...]:
    """The coordinates, history and columns that vary in some rows of a log."""
    return table.once(_find_carriers)


def _find_carriers(table: RowTable) -> tuple[Carrier, ...]:
    rows = table.frame
    own = [str(name) for name in rows.columns if str(name).startswith(COVARIATE_PREFIX)]
    columns = [name for name in (*CONDITIONS, *own) if name in rows]
    history = [name for name in HISTORY if name in rows and rows[name].notna().all()]
    times = [rows[name].to_numpy() for name in ("session_seconds", TIME_OF_DAY) if name in history]
    if len(times) > 1 and not _differ(*times):
        history.remove(TIME_OF_DAY)
    history += [name for name in FURTHER_OF_TRAVERSE if name in rows and rows[name].notna().any()]
    session = pd.factorize(rows["session"].astype(object))[0]
    history = [name for name in history if name not in PAST or _differs_from_condition(rows, name, session)]
    # Where one joint moves, what it did is what all did: of columns that are the same one is enough.
    history = list({rows[name].to_numpy().tobytes(): name for name in reversed(history)}.values())[::-1]
    # A machine without the published geometry has no gravity load.
    load = LOADS if rows["before_load"].notna().any() else ()
    # Where one of the two angles never changes, zeta is the other one.
    zeta = (ZETA,) if load and rows["psi"].nunique() > 1 and rows["q2"].nunique() > 1 else ()
    coordinates = (*ANGLES, *zeta, *position_columns(rows), *load, POSITION, LENGTH)
    names = dict.fromkeys((*coordinates, *columns, *history))
    states = list(_states_along(table))
    carriers = (_make_carrier(name, _along_traverses(len(rows), states, name)) for name in names)
    return tuple(carrier for carrier in carriers if carrier is not None)


def find_load(table: RowTable) -> Carrier | None:
    """The load along the traverses of a log; None where there is none."""
    return next((carrier for carrier in find_carriers(table) if carrier.name == LOAD), None)


def _states_along(table: RowTable) -> Iterator[tuple[IntArray, State]]:
    """The machine along the traverses of each joint, with their rows."""
    of_row = table.columns["joint"]
    for joint in map(int, np.unique(of_row)):
        places = np.flatnonzero(of_row == joint)
        own = table.subset(places)
        start, stop = (np.asarray(own[end], dtype=float)[:, None] for end in ("start", "stop"))
        yield places, state_at(joint, own, (start + stop) / 2 + (stop - start) / 2 * NODES)


def _along_traverses(n: int, states: Sequence[tuple[IntArray, State]], name: str) -> Array:
    """A carrier along n traverses, shape (n, k) or (n, 1); NaN where it is unknown."""
    known = [(places, carrier_values(state, name)) for places, state in states]
    values = np.full((n, max((each.shape[1] for _, each in known), default=1)), np.nan)
    for places, each in known:
        values[places] = each
    return values


def _differs_from_condition(rows: pd.DataFrame, name: str, session: IntArray) -> bool:
    """Whether a condition's past is clearly another than the condition, in its sessions."""
    both = np.stack([rows[column].to_numpy(float) for column in (condition_of(name), name)])
    known = np.isfinite(both).all(axis=0)
    both, session = both[:, known], session[known]
    rows_of = np.maximum(np.bincount(session), 1)
    return _differ(*(one - (np.bincount(session, one) / rows_of)[session] for one in both))


def _differ(one: Array, other: Array) -> bool:
    """Whether two columns, shape (n,), are clearly not the same but for a factor and a constant."""
    one, other = one - one.mean(), other - other.mean()
    return bool(abs(one @ other) < MAX_ALIKE * np.sqrt((one @ one) * (other @ other)))


def _make_carrier(name: str, values: Array) -> Carrier | None:
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    low, high = float(known.min()), float(known.max())
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return None
    along = np.ptp(values[np.isfinite(values).all(axis=1)], axis=1).max(initial=0.0) > 0
    distinct = len(np.unique(known[:: len(known) // SOME_VALUES + 1].round(9)))
    if distinct < ENOUGH_DISTINCT:
        distinct = len(np.unique(known.round(9)))
    return Carrier(name, values if along else values[:, :1], low, high, distinct)


def of_each_joint(table: RowTable, name: str) -> Iterator[tuple[int, Carrier]]:
    """The position of each joint or the length of its traverses, over its own range."""
    joint = table.columns["joint"]
    for carrier in find_carriers(table):
        for number in map(int, np.unique(joint)) if carrier.name == name else ():
            own = np.where((joint == number)[:, None], carrier.values, np.nan)
            if (of_joint := _make_carrier(name, own)) is not None:
                yield number, of_joint
