"""A Parquet file as a Table that reads only the columns and row groups it is asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import parquet

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs.faults import Faults
from stickslip_fit.logs.parse import text_of
from stickslip_fit.logs.table import Rows, one_array

# What pyarrow raises on a damaged file, which may have names or text that are no UTF-8.
_DAMAGE = (pa.ArrowException, OSError, UnicodeDecodeError)


@dataclass(frozen=True)
class ParquetTable:
    """A Parquet file; see `table.Table`."""

    file: str
    names: tuple[str, ...]
    raw: bytes
    metadata: parquet.FileMetaData
    rows: Rows | None = None

    @property
    def header_line(self) -> None:
        """None: a Parquet file has no lines."""
        return None

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.metadata.num_rows if self.rows is None else len(self.rows)

    def column(self, name: str) -> pa.Array:
        """Cells of a column: text, numbers or timestamps.

        Raises
        ------
        InputError
            If the column is damaged, or holds lists or the like.
        """
        try:
            cells = self._read(name)
        except _DAMAGE as error:
            message = f"cannot be read ({error}); save it as numbers or text, or leave it out"
            raise InputError(Problem(message, self.file, column=name)) from None
        if len(cells) != self.count:
            message = f"is damaged: it has {len(cells)} cells for {self.count} rows; write the file again"
            raise InputError(Problem(message, self.file, column=name))
        return cells

    def _read(self, name: str) -> pa.Array:
        # Columns are read side by side, and a ParquetFile can only do one thing at a time.
        source = parquet.ParquetFile(
            pa.BufferReader(self.raw), metadata=self.metadata, page_checksum_verification=True
        )
        if self.rows is None:
            return _valid(source.read(columns=[name]).column(name))
        groups, rows = self._groups()
        return _valid(source.read_row_groups(groups, columns=[name]).column(name)).take(pa.array(rows))

    def _groups(self) -> tuple[list[int], Rows]:
        """Row groups that hold the chosen rows, and where those stand in what is read."""
        assert self.rows is not None
        groups = range(self.metadata.num_row_groups)
        sizes = np.array([self.metadata.row_group(group).num_rows for group in groups], np.int64)
        ends = np.cumsum(sizes)
        group = np.searchsorted(ends, self.rows, side="right")
        needed, place = np.unique(group, return_inverse=True)
        before = np.concatenate([[0], np.cumsum(sizes[needed])[:-1]])
        return needed.tolist(), self.rows - (ends - sizes)[group] + before[place]

    def text(self, name: str) -> pa.Array:
        """Cells of a column as people see them."""
        return text_of(self.column(name))

    def lines(self, rows: Rows) -> Rows:
        """Rows of the file, counted from 1."""
        return 1 + (rows if self.rows is None else self.rows[rows])

    def place(self, row: int) -> str:
        """Where one row stands, in words."""
        return f"row {self.lines(np.array([row]))[0]} of {self.file}"

    def take(self, rows: Rows) -> ParquetTable:
        """Only these rows."""
        return replace(self, rows=rows)


def open_parquet(raw: bytes, file: str, faults: Faults) -> ParquetTable | None:
    """Open a Parquet file; parameters and result as for `csv_table.parse_csv`."""
    try:
        source = parquet.ParquetFile(pa.BufferReader(raw))
    except _DAMAGE as error:
        faults.place(
            file, f"is no Parquet file that can be read ({error}); write it again, or save it as CSV"
        )
        return None
    if not source.metadata.num_rows:
        faults.place(file, "has no rows; add one for each traverse")
        return None
    return ParquetTable(file, tuple(source.schema_arrow.names), raw, source.metadata)


def _valid(column: pa.ChunkedArray) -> pa.Array:
    column.validate(full=True)
    return as_cells(one_array(column))


def as_cells(column: pa.Array) -> pa.Array:
    """Cells as text, numbers or timestamps; NaN, which is how numpy writes an empty cell, is null."""
    kind = column.type
    if pa.types.is_dictionary(kind):
        return as_cells(column.dictionary_decode())
    if pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        numbers = column.cast(pa.float64())
        return pc.if_else(pc.is_nan(numbers), pa.scalar(None, pa.float64()), numbers)
    if pa.types.is_integer(kind) or pa.types.is_timestamp(kind):
        return column
    return column.cast(pa.large_string())
