"""Whether outlying counts are isolated or a pattern: in time, in a session, in a configuration, in a place.

A slip stands alone; an effect that the law leaves out shows in many counts that have something in common.
What they have in common is tested by permutation: of all choices of as many rows, how many have as much in
common? Five things are looked at, and the p-values adjusted over them by Holm's method, so that isolated
errors are called a pattern in at most 1 of 100 logs with them. Of two outlying counts, only whether one
follows the other is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.logs.schema import has_times, position_columns

LEVEL = 0.01
MIN_COUNT = 3  # of outlying counts; fewer may only follow each other
N_PERMUTATIONS = 1999
DECIMALS = 9  # of a position that make it another
MIN_VARIANCE = 1e-9  # of pairs, where nearly all rows have one label
EARLY = 0.25  # of a session's traverses


@dataclass(frozen=True)
class OutlierPattern:
    """What outlying counts have in common.

    Attributes
    ----------
    kind : str
        ``begin``, ``time``, ``session``, ``configuration`` or ``place``.
    text : str
        In a sentence after "the outlying counts".
    p_value : float
        Adjusted over the kinds.
    """

    kind: str
    text: str
    p_value: float


@dataclass(frozen=True, eq=False)
class _CommonProperty:
    """A thing that rows may have in common.

    `measure` gives how much of it choices of rows have, (m, k) -> (m,), and `describe` says it of one choice.
    """

    name: str
    measure: Callable[[IntArray], Array]
    describe: Callable[[IntArray], str]


def find_pattern(rows: pd.DataFrame, outlying: BoolArray) -> OutlierPattern | None:
    """What the outlying rows of one joint have in common beyond chance, if anything.

    Parameters
    ----------
    rows : DataFrame
        A log's usable rows of one joint, in order of time.
    outlying : array of bool, shape (n,)
    """
    chosen = np.flatnonzero(outlying)
    if len(chosen) < MIN_COUNT:
        return _find_neighbours(rows, chosen)
    kinds = list(_kinds(rows))
    random = np.random.default_rng(0)
    draws = np.array([random.choice(len(rows), len(chosen), replace=False) for _ in range(N_PERMUTATIONS)])
    p_values = [
        (1 + np.sum(kind.measure(draws) >= kind.measure(chosen[None])[0] - 1e-9)) / (N_PERMUTATIONS + 1)
        for kind in kinds
    ]
    best = int(np.argmin(p_values))
    # The smallest p-value by Holm's method, which alone is of interest.
    adjusted = min(1.0, len(kinds) * float(p_values[best]))
    if adjusted >= LEVEL:
        return None
    return OutlierPattern(kinds[best].name, kinds[best].describe(chosen), adjusted)


def _find_neighbours(rows: pd.DataFrame, chosen: IntArray) -> OutlierPattern | None:
    if len(chosen) < 2 or not has_times(rows):
        return None
    session = rows["session"].astype(object).to_numpy()
    follows = session[1:] == session[:-1]
    p_value = follows.sum() / (len(rows) * (len(rows) - 1) / 2)  # of all pairs, those in a row
    if np.diff(chosen)[0] == 1 and follows[chosen[0]] and p_value < LEVEL:
        return OutlierPattern("time", "follow each other", float(p_value))
    return None


def _kinds(rows: pd.DataFrame) -> Iterator[_CommonProperty]:
    session = pd.factorize(rows["session"])[0]
    if has_times(rows):
        yield from _kinds_of_time(session)
    if len(np.unique(session)) > 1:
        yield _of_group("session", session, "are of the same session")
    columns = [*position_columns(rows), "start", "stop"]
    columns = [name for name in columns if name in rows and rows[name].nunique() > 1]
    if not columns:
        return
    positions = rows[columns].round(DECIMALS)
    configuration = positions.assign(direction=rows["direction"].to_numpy())
    key = configuration.groupby(list(configuration), dropna=False, sort=False, observed=True).ngroup()
    yield _of_group("configuration", key.to_numpy(), "are of the same configuration and direction")
    yield _of_place(positions)


def _kinds_of_time(session: IntArray) -> Iterator[_CommonProperty]:
    """Early in their session; one after the other. `session` is that of each row."""
    order = pd.Series(session).groupby(session).cumcount().to_numpy()
    share = order / np.bincount(session)[session]

    def follow_each_other(chosen: IntArray) -> Array:
        chosen = np.sort(chosen, axis=1)
        same = (np.diff(chosen, axis=1) == 1) & (np.diff(session[chosen], axis=1) == 0)
        return same.sum(axis=1).astype(float)

    def describe_early(chosen: IntArray) -> str:
        count = int(np.sum(share[chosen] < EARLY))
        return f"come early in their session ({count} of {len(chosen)} in its first quarter)"

    def describe_row(chosen: IntArray) -> str:
        return (
            f"follow each other ({int(follow_each_other(chosen[None])[0])} of {len(chosen)} the one before)"
        )

    yield _CommonProperty("begin", lambda chosen: -share[chosen].mean(axis=1), describe_early)
    yield _CommonProperty("time", follow_each_other, describe_row)


def _of_group(name: str, group: IntArray, text: str) -> _CommonProperty:
    """Rows that have a label in common, as the number of pairs that have it."""

    def describe(chosen: IntArray) -> str:
        return f"{text} ({int(np.bincount(group[chosen]).max())} of {len(chosen)})"

    return _CommonProperty(name, lambda chosen: _count_pairs(group[chosen]), describe)


def _of_place(positions: pd.DataFrame) -> _CommonProperty:
    """Rows that have one coordinate in common, whichever it is: the pairs beyond what chance gives."""
    labels = {str(name): pd.factorize(positions[name], use_na_sentinel=False)[0] for name in positions}
    shares = {name: np.bincount(label) / len(label) for name, label in labels.items()}
    expected = {name: float(np.sum(share**2)) for name, share in shares.items()}

    def excess(chosen: IntArray, name: str) -> Array:
        mean = expected[name] * chosen.shape[1] * (chosen.shape[1] - 1) / 2
        sd = float(np.sqrt(max(mean * (1 - expected[name]), MIN_VARIANCE)))
        return (_count_pairs(labels[name][chosen]) - mean) / sd

    def measure(chosen: IntArray) -> Array:
        return np.max(np.array([excess(chosen, name) for name in labels]), axis=0)

    def describe(chosen: IntArray) -> str:
        name = max(labels, key=lambda name: float(excess(chosen[None], name)[0]))
        count = int(np.bincount(labels[name][chosen]).max())
        where = {"start": "beginning", "stop": "end"}.get(name, name)
        return f"have the same {where} ({count} of {len(chosen)})"

    return _CommonProperty("place", measure, describe)


def _count_pairs(labels: IntArray) -> Array:
    """Pairs of equal labels in each row, (m, k) -> (m,)."""
    ordered = np.sort(labels, axis=1)
    pairs, run = np.zeros(len(ordered)), np.zeros(len(ordered))
    for k in range(1, ordered.shape[1]):
        run = np.where(ordered[:, k] == ordered[:, k - 1], run + 1, 0.0)
        pairs += run
    return pairs
