"""Finds and opens the files of a log, CSV, Excel or Parquet, and hashes their content.

A Parquet file is read column by column, and only those row groups that are asked for. Of a folder everything
is read or named in a note or an issue, but for hidden entries, editors' backups (``day.csv~``, ``#day.csv#``)
and spreadsheets' lock files (``~$day.xlsx``).
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from stickslip_fit._format import join_words, pluralize
from stickslip_fit._input import check_path, explain_os_error, format_path, read_file
from stickslip_fit._typing import Int64Array
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs._csv import parse_csv
from stickslip_fit.logs._sheet import SheetTable, is_workbook, parse_sheet
from stickslip_fit.logs._table import (
    MAX_COLUMNS,
    MAX_ROWS,
    FileTable,
    IssueCollector,
    combine_chunks,
    report_excess,
    run_in_threads,
    to_text,
)
from stickslip_fit.logs.schema import holds_numbers

if TYPE_CHECKING:
    from pyarrow import parquet

# What pyarrow raises on a damaged file, which may have names or text that are no UTF-8.
_READ_ERRORS = (pa.ArrowException, OSError, UnicodeDecodeError)


@dataclass(frozen=True)
class ParquetTable(FileTable):
    """A Parquet file."""

    file: str
    names: tuple[str, ...]
    kinds: tuple[pa.DataType, ...]
    raw: bytes
    metadata: parquet.FileMetaData
    rows: Int64Array | None = None
    header_line: None = None

    @property
    def n_in_file(self) -> int:
        return self.metadata.num_rows

    @cached_property
    def type_faults(self) -> Mapping[str, str]:
        faults = zip(self.names, map(_explain_type, self.names, self.kinds), strict=True)
        return {name: message for name, message in faults if message}

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
        from pyarrow import parquet

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
        return to_text(self.column(name))

    def lines(self, rows: Int64Array) -> Int64Array:
        """See `FileTable`: rows, counted from 1."""
        return 1 + self.index_in_file(rows)


def open_parquet(raw: bytes, file: str, issues: IssueCollector) -> ParquetTable | None:
    """Open a Parquet file; parameters and result as for `parse_csv`."""
    from pyarrow import parquet

    try:
        source = parquet.ParquetFile(pa.BufferReader(raw))
    except _READ_ERRORS as error:
        issues.add(file, f"is no Parquet file that can be read ({error}); write it again, or save it as CSV")
        return None
    if not source.metadata.num_rows:
        issues.add(file, "has no rows; add one for each traverse")
        return None
    if report_excess(file, source.metadata.num_rows, MAX_ROWS, "rows", issues):
        return None
    if report_excess(file, source.metadata.num_columns, MAX_COLUMNS, "columns", issues):
        return None
    schema = source.schema_arrow
    return ParquetTable(file, tuple(schema.names), tuple(schema.types), raw, source.metadata)


_NUMBER_TYPES = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_null)
_TEXT_TYPES = (
    pa.types.is_string,
    pa.types.is_large_string,
    pa.types.is_string_view,
    pa.types.is_binary,
    pa.types.is_large_binary,
    pa.types.is_binary_view,
    pa.types.is_fixed_size_binary,
)
_MOMENT_TYPES = (pa.types.is_boolean, pa.types.is_timestamp, pa.types.is_date, pa.types.is_time)


def _explain_type(name: str, kind: pa.DataType) -> str | None:
    """What is wrong with the type of a column, if anything.

    Examples
    --------
    >>> _explain_type("steps", pa.duration("us")), _explain_type("steps", pa.decimal128(9))
    ('holds duration[us]; save it as numbers', None)
    """
    stored = kind.value_type if pa.types.is_dictionary(kind) else kind
    if any(is_type(stored) for is_type in (*_NUMBER_TYPES, *_TEXT_TYPES)):
        return None
    if holds_numbers(name):
        return f"holds {kind}; save it as numbers"
    if any(is_type(stored) for is_type in _MOMENT_TYPES):
        return None
    return f"holds {kind}; save it as numbers or text, or leave it out"


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
MAX_BYTES = 2**29  # of all files; as CSV some eight million traverses
MAX_NAMES = 10  # of files in a note
LOG_SUFFIXES = (".csv", ".parquet", ".xlsx")
_LEFT_OUT = re.compile(r"[.#]|~\$|.*~$")
# What a file begins with that is no log.
_FOREIGN_CONTENT = {
    rb"\x1f\x8b": "is packed with gzip; unpack it, and name the file inside",
    rb"BZh\d1AY&SY|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc\xaf|Rar!": "is packed; unpack it, name what is inside",
    rb"PK\x03\x04(?s:.{0,60})opendocument": "is an OpenDocument file; save its sheet as 'CSV UTF-8'",
    rb"PK\x03\x04": "is a zip archive; unpack it, and name the file or folder inside",
    rb"\xd0\xcf\x11\xe0": "is an Excel workbook, old or protected; save it as .xlsx without a password",
    rb"%PDF-": "is a PDF; give the table that it was printed from, as CSV",
    rb"(?i)(\xef\xbb\xbf)?\s*<(!doctype html|html)": "is a web page; download the file itself",
    rb"(\xef\xbb\xbf)?\s*<\?xml": "is XML; save the table in it as CSV",
    rb"\s*(\{\s*[\"}]|\[\s*[\[{\"\]])": "is JSON, such as a saved result; name the log itself",
    rb"ARROW1": "is an Arrow file; save it as Parquet or CSV",
    rb"\x89HDF": "is an HDF5 file; save the table in it as Parquet or CSV",
}


@dataclass(frozen=True)
class SourceFile:
    """A file that was read: its table and the hash of its bytes."""

    table: FileTable
    sha256: str


@dataclass(frozen=True)
class Listing:
    """The files of a log, each once, whatever links lead to it, and notes on what is not read."""

    files: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    first_path: dict[tuple[int, int], Path] = field(default_factory=dict)

    def add(self, path: Path, issues: IssueCollector) -> None:
        """Add a file, or the logs in a folder; InputError for a folder without."""
        if not os.path.isdir(path):
            self.files.extend(self._new([path], issues))
            return
        entries = list(self._walk(path, issues))
        logs = [entry for entry in entries if entry.suffix.lower() in LOG_SUFFIXES]
        others = [format_path(entry.relative_to(path)) for entry in entries if entry not in set(logs)]
        named = join_words(
            others[:MAX_NAMES] + [f"{len(others) - MAX_NAMES} more"] * (len(others) > MAX_NAMES)
        )
        if not logs:
            hint = f"; neither is {named}" if others else ""
            message = (
                f"is a folder without logs{hint}; put .csv, .xlsx or .parquet files there, or name another"
            )
            issues.add(format_path(path), message)
        elif others:
            self.notes.append(
                f"{format_path(path)}: {pluralize(len(others), 'other file')} not read: {named}"
            )
        self.files.extend(logs)

    def _walk(self, folder: Path, issues: IssueCollector) -> Iterator[Path]:
        """All files below a folder, in the order of their names."""
        try:
            names = sorted(os.listdir(folder))
        except OSError as error:
            message = f"cannot be read ({explain_os_error(error)}); make it readable, or name another"
            issues.add(format_path(folder), message)
            return
        paths = [folder / name for name in names if not _LEFT_OUT.match(name)]
        for path in self._new(paths, issues):
            if path.is_dir():
                yield from self._walk(path, issues)
            else:
                yield path

    def _new(self, paths: list[Path], issues: IssueCollector) -> Iterator[Path]:
        """Those paths that lead to a file or folder for the first time."""
        for path in paths:
            try:
                status = os.stat(path)
            except (OSError, ValueError) as error:
                link = (
                    f"it is a link to {os.readlink(path)!r}: mend or delete it"
                    if os.path.islink(path)
                    else ""
                )
                advice = link or "name an existing log"
                issues.add(format_path(path), f"cannot be read ({explain_os_error(error)}); {advice}")
                continue
            first = self.first_path.setdefault((status.st_dev, status.st_ino), path)
            if first is path:
                yield path
            else:
                self.notes.append(
                    f"{format_path(path)} is {format_path(first)} under another name: read once"
                )


@dataclass(frozen=True)
class Sources:
    """The files that were read, and notes on what was not."""

    files: list[SourceFile]
    notes: tuple[str, ...]


def open_sources(
    source: SourcePath | Iterable[SourcePath], issues: IssueCollector, sheet: str | None = None
) -> Sources:
    """Open files, and the ``*.csv``, ``*.xlsx`` and ``*.parquet`` in folders and their subfolders.

    `sheet` is the sheet of workbooks that is read, by default the first one.

    Raises
    ------
    InputError
        If no path is given, or a sheet and no workbook; issues of a file are added to `issues`.
    """
    if isinstance(source, pd.DataFrame):
        raise InputError("a path is wanted, not a DataFrame; save it with to_csv(path, index=False)")
    paths = list(source) if isinstance(source, Iterable) and not isinstance(source, str) else [source]
    for path in paths:
        check_path(path, "log")
    if not paths or "" in paths:
        raise InputError("no log was named; name a file or a folder")
    listing = Listing()
    for path in paths:
        listing.add(Path(path), issues)
    size = sum(map(os.path.getsize, listing.files))
    if len(listing.files) > 1 and size > MAX_BYTES:
        most = f"{MAX_BYTES / 2**20:,.0f} MiB"
        raise InputError(f"the files have {size / 2**20:,.0f} MiB together; name fewer, {most} at most")
    opened = [_open_file(file, issues, sheet) for file in listing.files]
    files = [file for file in opened if file is not None]
    workbooks = any(isinstance(file.table, SheetTable) for file in files)
    if sheet is not None and len(files) == len(opened) and not workbooks:
        message = "names a sheet, and no file is an Excel workbook; leave it out"
        raise InputError(InputIssue(message, value=sheet, argument="sheet"))
    return Sources(files, tuple(listing.notes))


def hash_sources(sources: Sequence[SourceFile]) -> str:
    """The hash of a single file; of several, one that does not depend on their names or order."""
    hashes = sorted(source.sha256 for source in sources)
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def find_foreign(raw: bytes) -> str | None:
    """What a file is that is no table, and what to do about it; None for one that may be a table."""
    found = (message for beginning, message in _FOREIGN_CONTENT.items() if re.match(beginning, raw))
    return next(found, None)


def _open_file(path: Path, issues: IssueCollector, sheet: str | None) -> SourceFile | None:
    file = format_path(path)
    try:
        raw = read_file(path, "log", MAX_BYTES)
    except InputError as error:
        issues.add_error(error)
        return None

    def parse() -> FileTable | None:
        if is_workbook(raw):
            return parse_sheet(raw, file, sheet, issues)
        if message := find_foreign(raw):
            issues.add(file, message)
            return None
        if path.suffix.lower() == ".parquet" or raw.startswith(b"PAR1"):
            return open_parquet(raw, file, issues)
        return parse_csv(raw, file, issues)

    tasks = {"table": parse, "sha256": lambda: hashlib.sha256(raw).hexdigest()}
    source = run_in_threads(tasks, size=len(raw) // 100)  # bytes of a row
    return None if source["table"] is None else SourceFile(**source)
