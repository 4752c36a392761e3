"""Opens the files and folders of a log, CSV or Parquet, and hashes their content.

A Parquet file is read column by column, and only those row groups that are asked for.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
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
class ParquetTable(FileTable):
    """A Parquet file."""

    file: str
    names: tuple[str, ...]
    raw: bytes
    metadata: parquet.FileMetaData
    rows: Int64Array | None = None
    header_line: None = None

    @property
    def n_in_file(self) -> int:
        """See `FileTable`."""
        return self.metadata.num_rows

    def column(self, name: str) -> pa.Array:
        """See `FileTable`; InputError for a column that is damaged or holds lists or the like."""
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
        # Columns are read in threads, and a ParquetFile is not thread-safe.
        source = parquet.ParquetFile(
            pa.BufferReader(self.raw), metadata=self.metadata, page_checksum_verification=True
        )
        if self.rows is None:
            return _check_column(source.read(columns=[name]).column(name))
        groups, rows = self._groups()
        return _check_column(source.read_row_groups(groups, columns=[name]).column(name)).take(pa.array(rows))

    def _groups(self) -> tuple[list[int], Int64Array]:
        """Row groups that hold the selected rows, and the indices of these rows in what is read."""
        assert self.rows is not None
        groups = range(self.metadata.num_row_groups)
        sizes = np.array([self.metadata.row_group(group).num_rows for group in groups], np.int64)
        ends = np.cumsum(sizes)
        group = np.searchsorted(ends, self.rows, side="right")
        needed, index = np.unique(group, return_inverse=True)
        before = np.concatenate([[0], np.cumsum(sizes[needed])[:-1]])
        return needed.tolist(), self.rows - (ends - sizes)[group] + before[index]

    def text(self, name: str) -> pa.Array:
        """See `FileTable`."""
        return to_text(self.column(name))

    def lines(self, rows: Int64Array) -> Int64Array:
        """See `FileTable`: rows, counted from 1."""
        return 1 + self.index_in_file(rows)


def open_parquet(raw: bytes, file: str, issues: IssueCollector) -> ParquetTable | None:
    """Open a Parquet file; parameters and result as for `parse_csv`."""
    try:
        source = parquet.ParquetFile(pa.BufferReader(raw))
    except _READ_ERRORS as error:
        issues.add(file, f"is no Parquet file that can be read ({error}); write it again, or save it as CSV")
        return None
    if not source.metadata.num_rows:
        issues.add(file, "has no rows; add one for each traverse")
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
        If no path is given; issues of a file are added to `issues`.
    """
    paths = [source] if isinstance(source, str | Path) else list(source)
    if not paths:
        raise InputError("no log was named; name a file or a folder")
    files = [_open_file(file, issues) for path in paths for file in _list_files(Path(path), issues)]
    return [file for file in files if file is not None]


def hash_sources(sources: Sequence[SourceFile]) -> str:
    """The hash of a single file; of several, one that does not depend on their names or order."""
    hashes = sorted(source.sha256 for source in sources)
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def _list_files(path: Path, issues: IssueCollector) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = [
        file
        for file in sorted(path.rglob("*"))
        if file.suffix.lower() in (".csv", ".parquet")
        and file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(path).parts)
    ]
    if not files:
        issues.add(str(path), "is a folder without logs; put .csv or .parquet files there, or name another")
    return files


def _open_file(path: Path, issues: IssueCollector) -> SourceFile | None:
    file = str(path)
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        issues.add(file, f"cannot be read ({reason}); name an existing log")
        return None
    parquet = path.suffix.lower() == ".parquet" or raw.startswith(b"PAR1")
    parse = open_parquet if parquet else parse_csv
    source = run_in_threads(
        {"table": lambda: parse(raw, file, issues), "sha256": lambda: hashlib.sha256(raw).hexdigest()}
    )
    return None if source["table"] is None else SourceFile(**source)
