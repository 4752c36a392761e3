"""What is wrong with a log's files, collected until all of it can be told at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs.table import Table

SHOWN = 20
# Line, column, value and message of one fault.
Spot = tuple[int | None, str | None, str | None, str]
Message = str | Callable[[int, str], str]


class Faults:
    """Collects the faults of one reading.

    A column may hold the same fault a million times: the first 20 are shown, the rest counted.
    """

    def __init__(self) -> None:
        self._found: list[tuple[str, float, int, Problem]] = []

    def __bool__(self) -> bool:
        return bool(self._found)

    def place(
        self,
        file: str,
        message: str,
        *,
        line: int | None = None,
        column: str | None = None,
        value: str | None = None,
        position: int = 0,
    ) -> None:
        """Add one fault; those of one line are told in the order of `position`."""
        self._found.append((file, line or 0, position, Problem(message, file, line, column, value)))

    def lines(self, file: str, faults: Iterable[Spot]) -> None:
        """Add the same kind of fault at many lines, each given as (line, column, value, message)."""
        found = list(faults)
        for line, column, value, message in found[:SHOWN]:
            self.place(file, message, line=line, column=column, value=value)
        self._count_rest(file, None, len(found), 0)

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
        if not len(rows):
            return
        shown, position = rows[:SHOWN], table.names.index(column)
        values = table.text(column).take(pa.array(shown)).to_pylist()
        for row, line, value in zip(shown, table.lines(shown), values, strict=True):
            said = message if isinstance(message, str) else message(int(row), value)
            if table.header_line is None:
                said += f" (row {line}; Parquet has no lines)"
            self.place(table.file, said, line=int(line), column=column, value=value, position=position)
        self._count_rest(table.file, column, len(rows), position)

    def _count_rest(self, file: str, column: str | None, found: int, position: int) -> None:
        if found > SHOWN:
            where = "in this column" if column else "like these"
            rest = Problem(f"... and {found - SHOWN:,} more {where}", file, column=column)
            self._found.append((file, math.inf, position, rest))

    def raise_if_any(self) -> None:
        """Tell all of it, file by file and line by line.

        Raises
        ------
        InputError
            If any fault was added.
        """
        if self._found:
            raise InputError(problem for *_, problem in sorted(self._found, key=lambda found: found[:3]))
