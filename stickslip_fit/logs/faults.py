"""What is wrong with a log's files, collected until all of it can be told at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs.table import Table

SHOWN = 20
# Line, column, value and message of one fault.
Spot = tuple[int | None, str | None, str | None, str]
Message = str | Callable[[int, str], str]


@dataclass(frozen=True)
class _Cells:
    """The same kind of fault in some cells of a column, not yet looked up in the file."""

    table: Table
    rows: npt.NDArray[np.int64]
    column: str
    message: Message


class Faults:
    """Collects the faults of one reading.

    A column may hold the same fault a million times: the first 20 are shown, the rest counted.
    """

    def __init__(self) -> None:
        self._placed: list[tuple[str, float, int, Problem]] = []
        self._cells: list[_Cells] = []

    def __bool__(self) -> bool:
        return bool(self._placed or self._cells)

    def place(
        self,
        file: str,
        message: str,
        *,
        line: int | None = None,
        column: str | None = None,
        value: str | None = None,
    ) -> None:
        """Add one fault whose place is known."""
        self._placed.append((file, line or 0, 0, Problem(message, file, line, column, value)))

    def lines(self, file: str, faults: Iterable[Spot]) -> None:
        """Add the same kind of fault at many lines, each given as (line, column, value, message)."""
        found = list(faults)
        for line, column, value, message in found[:SHOWN]:
            self.place(file, message, line=line, column=column, value=value)
        if len(found) > SHOWN:
            rest = Problem(f"... and {len(found) - SHOWN:,} more like these", file)
            self._placed.append((file, math.inf, 0, rest))

    def cells(self, table: Table, wrong: npt.NDArray[np.bool_], column: str, message: Message) -> None:
        """Add the same kind of fault in many cells of a column.

        Parameters
        ----------
        table : Table
        wrong : array of bool, shape (table.count,)
        column : str
            As written in the file.
        message : str or function
            The function is handed the row, counted from 0, and the cell's text.
        """
        rows = np.flatnonzero(wrong)
        if len(rows):
            self._cells.append(_Cells(table, rows, column, message))

    def raise_if_any(self) -> None:
        """Tell all of it, file by file, line by line and column by column.

        Raises
        ------
        InputError
            If any fault was added.
        """
        # Lines and cells are looked up only now: a file without faults is never searched for them.
        found = self._placed + [placed for cells in self._cells for placed in _look_up(cells)]
        if found:
            raise InputError(problem for *_, problem in sorted(found, key=lambda placed: placed[:3]))


def _look_up(cells: _Cells) -> Iterator[tuple[str, float, int, Problem]]:
    table, column, shown = cells.table, cells.column, cells.rows[:SHOWN]
    position = table.names.index(column)
    values = table.text(column).take(pa.array(shown)).to_pylist()
    for row, line, value in zip(shown.tolist(), table.lines(shown).tolist(), values, strict=True):
        said = cells.message if isinstance(cells.message, str) else cells.message(row, value)
        if table.header_line is None:
            said += f" (row {line}; Parquet has no lines)"
        yield table.file, line, position, Problem(said, table.file, line, column, value)
    if len(cells.rows) > SHOWN:
        rest = Problem(f"... and {len(cells.rows) - SHOWN:,} more in this column", table.file, column=column)
        yield table.file, math.inf, position, rest
