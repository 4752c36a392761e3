"""Where the traverses of a fitted log went, and how much of another traverse lies where none of them did."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray

Stretches = tuple[tuple[float, float], ...]
"""Lowest and highest position of each stretch, in order and apart, rad or m."""

MIN_GAP = 0.01  # of a joint's range: what is narrower no smooth function of the travel can follow


def driven_stretches(rows: pd.DataFrame) -> dict[str, Stretches]:
    """The stretches that a joint's traverses cover together, by direction.

    Examples
    --------
    >>> rows = pd.DataFrame({"direction": ["+", "+", "-"], "start": [0, 5, 9], "stop": [6, 8, 1]})
    >>> driven_stretches(rows)
    {'+': ((0.0, 8.0),), '-': ((1.0, 9.0),)}
    """
    ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1)
    ways = rows["direction"].to_numpy(object)
    return {str(way): _unite(ends[ways == way]) for way in sorted(set(ways))}


def _unite(ends: Array) -> Stretches:
    """Stretches, shape (n, 2), that overlap or touch as one."""
    ends = ends[np.argsort(ends[:, 0])]
    reach = np.maximum.accumulate(ends[:, 1])
    first = np.flatnonzero(np.append(True, ends[1:, 0] > reach[:-1]))
    last = np.append(first[1:], len(ends)) - 1
    return tuple(zip(ends[first, 0].tolist(), reach[last].tolist(), strict=True))


def unite_travel(one: dict[str, Stretches], other: dict[str, Stretches]) -> dict[str, Stretches]:
    """The stretches of either, by direction.

    Examples
    --------
    >>> unite_travel({"+": ((0.0, 3.0),)}, {"+": ((2.0, 5.0),), "-": ((0.0, 1.0),)})
    {'+': ((0.0, 5.0),), '-': ((0.0, 1.0),)}
    """
    both = {way: (*one.get(way, ()), *other.get(way, ())) for way in sorted({*one, *other})}
    return {way: _unite(np.array(stretches)) for way, stretches in both.items()}


def close_gaps(stretches: Stretches, span: float) -> Stretches:
    """The stretches, those united between which less than `MIN_GAP` of the joint's range `span` is."""
    closed: list[tuple[float, float]] = []
    for low, high in stretches:
        if closed and low - closed[-1][1] < MIN_GAP * span:
            low, _ = closed.pop()
        closed.append((low, high))
    return tuple(closed)


def undriven_share(start: Array, stop: Array, stretches: Stretches, span: float) -> Array:
    """Share of each traverse, shape (n,), outside the stretches; less than `MIN_GAP` of the range is none."""
    low, high = np.minimum(start, stop)[:, None], np.maximum(start, stop)[:, None]
    driven = np.array(close_gaps(stretches, span)).reshape(-1, 2)
    covered = np.clip(np.minimum(high, driven[:, 1]) - np.maximum(low, driven[:, 0]), 0.0, None).sum(axis=1)
    length = (high - low)[:, 0]
    outside = length - covered
    return np.where(outside < MIN_GAP * span, 0.0, outside / np.where(length > 0, length, 1.0))


def undriven_pieces(start: float, stop: float, stretches: Stretches, span: float) -> Stretches:
    """The parts of a traverse outside the stretches, from its start on.

    Examples
    --------
    >>> undriven_pieces(30.0, 0.0, ((10.0, 20.0),), 100.0)
    ((30.0, 20.0), (10.0, 0.0))
    """
    low, high = sorted((start, stop))
    edges = [low, *(np.clip(end, low, high) for one in close_gaps(stretches, span) for end in one), high]
    pieces = [(float(a), float(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]
    return tuple(pieces) if stop > start else tuple((b, a) for a, b in reversed(pieces))


def are_stretches(stretches: Sequence[Sequence[float]]) -> bool:
    """Whether they are what `driven_stretches` returns: in order, apart, each with a length."""
    ends: BoolArray = np.diff(np.ravel(np.array(stretches, float))) > 0
    return bool(ends.all()) and all(len(one) == 2 for one in stretches)
