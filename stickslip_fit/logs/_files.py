"""Opens the files and folders of a log, CSV or Parquet, and hashes their content.

A Parquet file is read column by column, and only those row groups that are asked for.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import parquet

from stickslip_fit._typing import Int64Array
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs._csv import parse_csv
from stickslip_fit.logs._table import FileTable, IssueCollector, combine_chunks, run_in_threads, to_text

# What pyarrow raises on a damaged file, which may have names or text that are no UTF-8.
_READ_ERRORS = (pa.ArrowException, OSError, UnicodeDecodeError)


@dataclass(frozen=True)
class ParquetTable:
    """A Parquet file; see `table.Table`."""

    file: str
    names: tuple[str, ...]
    raw: bytes
    metadata: parquet.FileMetaData
    rows: Int64Array | None = None

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
        except _READ_ERRORS as error:
            message = f"cannot be read ({error}); save it as numbers or text, or leave it out"
            raise InputError(InputIssue(message, self.file, column=name)) from None
        if len(cells) != self.count:
            message = f"is damaged: it has {len(cells)} cells for {self.count} rows; write the file again"
            raise InputError(InputIssue(message, self.file, column=name))
        return cells

    def _read(self, name: str) -> pa.Array:
        # Columns are read side by side, and a ParquetFile can only do one thing at a time.
        source = parquet.ParquetFile(
            pa.BufferReader(self.raw), metadata=self.metadata, page_checksum_verification=True
        )
        if self.rows is None:
            return _check_column(source.read(columns=[name]).column(name))
        groups, rows = self._groups()
        return _check_column(source.read_row_groups(groups, columns=[name]).column(name)).take(pa.array(rows))

    def _groups(self) -> tuple[list[int], Int64Array]:
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
        return to_text(self.column(name))

    def lines(self, rows: Int64Array) -> Int64Array:
        """Rows of the file, counted from 1."""
        return 1 + (rows if self.rows is None else self.rows[rows])

    def place(self, row: int) -> str:
        """Where one row stands, in words."""
        return f"row {self.lines(np.array([row]))[0]} of {self.file}"

    def take(self, rows: Int64Array) -> ParquetTable:
        """Only these rows."""
        return replace(self, rows=rows)


def open_parquet(raw: bytes, file: str, issues: IssueCollector) -> ParquetTable | None:
    """Open a Parquet file; parameters and result as for `csv_table.parse_csv`."""
    try:
        source = parquet.ParquetFile(pa.BufferReader(raw))
    except _READ_ERRORS as error:
        issues.place(
            file, f"is no Parquet file that can be read ({error}); write it again, or save it as CSV"
        )
        return None
    if not source.metadata.num_rows:
        issues.place(file, "has no rows; add one for each traverse")
        return None
    return ParquetTable(file, tuple(source.schema_arrow.names), raw, source.metadata)


def _check_column(column: pa.ChunkedArray) -> pa.Array:
    column.validate(full=True)
    return to_cells(combine_chunks(column))


def to_cells(column: pa.Array) -> pa.Array:
    """Cells as text, numbers or timestamps; NaN, which is how numpy writes an empty cell, is null."""
    kind = column.type
    if pa.types.is_dictionary(kind):
        return to_cells(column.dictionary_decode())
    if pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        numbers = column.cast(pa.float64())
        return pc.if_else(pc.is_nan(numbers), pa.scalar(None, pa.float64()), numbers)
    if pa.types.is_integer(kind) or pa.types.is_timestamp(kind):
        return column
    return column.cast(pa.large_string())


SourcePath = str | Path


@dataclass(frozen=True)
class SourceFile:
    """A file that was read: its table and the hash of its bytes."""

    table: FileTable
    sha256: str


def open_sources(source: SourcePath | Iterable[SourcePath], issues: IssueCollector) -> list[SourceFile]:
    """Open files, and the ``*.csv`` and ``*.parquet`` in folders, hidden ones left out.

    Raises
    ------
    InputError
        If nothing was named; what is wrong with a file is told to `issues`.
    """
    named = [source] if isinstance(source, str | Path) else list(source)
    if not named:
        raise InputError("no log was named; name a file or a folder")
    opened = [_open_file(path, issues) for given in named for path in _list_files(Path(given), issues)]
    return [found for found in opened if found is not None]


def hash_sources(sources: Sequence[SourceFile]) -> str:
    """Take a single file's own hash; for several, one that doesn't depend on their names or order."""
    hashes = sorted(source.sha256 for source in sources)
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def _list_files(path: Path, issues: IssueCollector) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = [
        file
        for file in sorted(path.rglob("*"))
        if file.suffix.lower() in (".csv", ".parquet")
        and file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(path).parts)
    ]
    if not found:
        issues.place(str(path), "is a folder without logs; put .csv or .parquet files there, or name another")
    return found


def _open_file(path: Path, issues: IssueCollector) -> SourceFile | None:
    file = str(path)
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        issues.place(file, f"cannot be read ({reason}); name an existing log")
        return None
    parquet = path.suffix.lower() == ".parquet" or raw.startswith(b"PAR1")
    parse = open_parquet if parquet else parse_csv
    read = run_in_threads(
        {
            "table": lambda: parse(raw, file, issues),
            "sha256": lambda: hashlib.sha256(raw).hexdigest(),
        }
    )
    return None if read["table"] is None else SourceFile(**read)
