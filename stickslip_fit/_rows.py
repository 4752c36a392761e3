"""Distinct rows of an array of numbers, and the places of rows among those of their kind."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import IntArray


def unique_rows[T: np.generic](rows: npt.NDArray[T]) -> tuple[npt.NDArray[T], IntArray]:
    """The distinct rows in rising order, and which of them each row is: (n, k) -> (m, k) and (n,).

    As `np.unique` along the first axis, which compares rows as records, several times as slow.

    Examples
    --------
    >>> distinct, which = unique_rows(np.array([[2, 1], [1, 5], [2, 1]]))
    >>> distinct.tolist(), which.tolist()
    ([[1, 5], [2, 1]], [1, 0, 1])
    """
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    first = np.ones(len(rows), dtype=bool)
    first[1:] = np.any(ordered[1:] != ordered[:-1], axis=1)
    which = np.empty(len(rows), dtype=np.intp)
    which[order] = np.cumsum(first) - 1
    return ordered[first], which


def rank_within(kinds: npt.NDArray[np.integer]) -> IntArray:
    """Number of elements of the same kind before each, shape (n,).

    Examples
    --------
    >>> rank_within(np.array([3, 1, 3, 3])).tolist()
    [0, 0, 1, 2]
    """
    order = np.argsort(kinds, kind="stable")
    first = np.flatnonzero(np.diff(kinds[order], prepend=-1))
    rank = np.empty(len(kinds), dtype=np.intp)
    rank[order] = np.arange(len(kinds)) - np.repeat(first, np.diff(first, append=len(kinds)))
    return rank
