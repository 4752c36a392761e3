"""RowTable: rows, and what is computed from them once for all fits."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import IntArray


class RowTable:
    """Rows, and what follows from them alone, whatever the law and its noise.

    A search fits laws to the same rows again and again. What is computed once is not sent to other processes,
    which compute their own.

    Examples
    --------
    >>> table = RowTable(pd.DataFrame({"steps": [100, 200]}))
    >>> table.once(lambda table: int(table.frame["steps"].sum()))
    300
    """

    def __init__(self, frame: pd.DataFrame) -> None:
        self.frame = frame
        self._known: dict[tuple[Hashable, ...], Any] = {}
        self._subsets: dict[bytes, RowSubset] = {}

    def __len__(self) -> int:
        return len(self.frame)

    def __reduce__(self) -> tuple[type[RowTable], tuple[pd.DataFrame]]:
        return RowTable, (self.frame,)

    def once[T](self, compute: Callable[..., T], *given: Hashable) -> T:
        """What a function finds in the rows, with what else it is given, computed the first time only."""
        if (key := (compute, *given)) not in self._known:
            self._known[key] = compute(self, *given)
        known: T = self._known[key]
        return known

    @cached_property
    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Columns of the rows, as arrays; cached, since every cause reads them."""
        return {str(name): self.frame[name].to_numpy() for name in self.frame}

    def subset(self, rows: IntArray) -> RowSubset:
        """Columns of some rows, as arrays."""
        key = rows.tobytes()
        if key not in self._subsets:
            self._subsets[key] = RowSubset(self.frame, rows)
        return self._subsets[key]


class RowSubset(Mapping[str, npt.NDArray[Any]]):
    """Some rows of a table, as arrays: of the columns that are asked for, since a law needs few of many."""

    def __init__(self, table: pd.DataFrame, rows: IntArray) -> None:
        self._table, self._rows = table, rows
        self._known: dict[str, npt.NDArray[Any]] = {}

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        if name not in self._known:
            self._known[name] = self._table[name].to_numpy()[self._rows]
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._table)

    def __len__(self) -> int:
        return self._table.shape[1]
