"""CSV bytes into a table of cells, with the line of every record.

pyarrow parses the cells; records are scanned a second time only to locate an issue. A
quoted cell may hold separators, line ends and doubled quotation marks; a quotation mark elsewhere is an
ordinary character. Lines end in LF, CR LF or CR. Cells are separated by commas, or by what the header has
instead; then numbers may have decimal commas.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv

from stickslip_fit._typing import Int64Array
from stickslip_fit.errors import shorten
from stickslip_fit.logs._decimals import find_decimals, with_points
from stickslip_fit.logs._encoding import count_lines, decode
from stickslip_fit.logs._table import (
    MAX_COLUMNS,
    MAX_ROWS,
    MAX_SHOWN,
    FileTable,
    IssueCollector,
    combine_chunks,
    is_shared,
    report_excess,
)
from stickslip_fit.logs.schema import holds_numbers, is_known

_END_PATTERN = rb"(?:\r\n|\r|\n|\Z)"
COMMA = b","
_NOT_EMPTY_PATTERN = re.compile(rb"[^\r\n]")
_UNCLOSED_PATTERN = re.compile(rb'"(?:[^"]++|"")*+\Z')


def _cell_pattern(separator: bytes) -> bytes:
    other = rb"[^" + re.escape(separator) + rb"\r\n]*+"
    return rb'(?>"(?:[^"]++|"")*+(?:"|\Z)' + other + rb"|(?!\")" + other + rb")"


@cache
def _one_cell(separator: bytes) -> re.Pattern[bytes]:
    return re.compile(_cell_pattern(separator))


@cache
def _record(separator: bytes, repeat: bytes = b"*+") -> re.Pattern[bytes]:
    cell = _cell_pattern(separator)
    return re.compile(cell + rb"(?:" + re.escape(separator) + cell + rb")" + repeat + _END_PATTERN)


@dataclass(frozen=True)
class RaggedRecord:
    """A record with too many or too few cells."""

    line: int
    text: bytes


class CsvScan(NamedTuple):
    """Lines of records of the right width, records of another width, and the line of an open quote."""

    lines: Int64Array
    ragged: list[RaggedRecord]
    unclosed: int | None


@dataclass(frozen=True)
class CsvRecords:
    r"""The records of `raw` from byte `start` on, which is in line `first_line`; empty lines are no records.

    Examples
    --------
    >>> records = CsvRecords(b'1,"two\nlines"\n3\n4,5\n', start=0, first_line=1, width=2)
    >>> records.scan.lines, records.scan.ragged
    (array([1, 4]), [RaggedRecord(line=3, text=b'3')])
    """

    raw: bytes
    start: int
    first_line: int
    width: int
    separator: bytes = COMMA

    @cached_property
    def quoted(self) -> bool:
        """Whether there is any quotation mark."""
        return b'"' in self.raw

    @cached_property
    def scan(self) -> CsvScan:
        """Every record visited once."""
        full_width = _record(self.separator, b"{%d}" % (self.width - 1))
        lines: list[int] = []
        ragged: list[RaggedRecord] = []
        unclosed = None
        position, line = self.start, self.first_line
        while found := _NOT_EMPTY_PATTERN.search(self.raw, position):
            line += count_lines(self.raw[position : found.start()])
            position = found.start()
            match = full_width.match(self.raw, position)
            end = (match or next_record(self.raw, position, self.separator)).end()
            record = self.raw[position:end]
            text = record.rstrip(b"\r\n")
            if match:
                lines.append(line)
            else:
                ragged.append(RaggedRecord(line, text))
            if end == len(self.raw) and any(
                map(_UNCLOSED_PATTERN.fullmatch, split_cells(record, self.separator))
            ):
                unclosed = line
            position, line = end, line + count_lines(record)
        return CsvScan(np.array(lines, dtype=np.int64), ragged, unclosed)


def next_record(raw: bytes, position: int, separator: bytes = COMMA) -> re.Match[bytes]:
    """The record that begins at `position`, its line end included."""
    record = _record(separator).match(raw, position)
    assert record is not None, "the pattern also matches nothing"
    return record


def split_cells(record: bytes, separator: bytes = COMMA) -> list[bytes]:
    """Cells of one record, quotation marks and all.

    Examples
    --------
    >>> split_cells(b'3,"a,b",')
    [b'3', b'"a,b"', b'']
    """
    cells, position = [], -1
    while position < 0 or record[position : position + 1] == separator:
        cell = _one_cell(separator).match(record, position + 1)
        assert cell is not None, "the pattern also matches nothing"
        cells.append(cell[0])
        position = cell.end()
    return cells


def unquote(cell: bytes) -> str:
    """The text of a cell."""
    text = cell.decode("utf-8", "replace")
    if not text.startswith('"'):
        return text
    quoted, _, rest = text[1:].replace('""', "\0").partition('"')
    return quoted.replace("\0", '"') + rest.replace("\0", '""')


_BLOCK_SIZE = 2 << 20
_MAX_BLOCK_SIZE = 2**31 - 1
_MAX_LINE = 2**24  # bytes
_MAX_RAGGED = 10_000
_NUMBER_PATTERN = re.compile(rb"[+-]?[0-9.]+([eE][+-]?[0-9]+)?")
_UNCLOSED_MESSAGE = "has a quotation mark that opens a cell and is never closed; close it, or write it twice"
_SEPARATORS = {b",": "commas", b";": "semicolons", b"\t": "tabs", b"|": "bars"}
_POSITION_COLUMN = re.compile(r"q[0-9]+_")  # of any machine
# What Excel writes above the header, to tell itself the separator.
_SEPARATOR_LINE = re.compile(rb"sep=([,;\t|])(?:\r\n|\r|\n)", re.IGNORECASE)


@dataclass(frozen=True)
class CsvCells:
    """The cells below a header: as numbers where the format has numbers and all are, else as text."""

    records: CsvRecords
    read: pa.Table

    @cached_property
    def text(self) -> pa.Table:
        """All cells as they stand in the file, for people."""
        return _read_columns(self.records, numeric=[])[0]


@dataclass(frozen=True)
class CsvTable(FileTable):
    """A CSV file; numbers in its text may have a decimal comma where `decimal_comma` says so."""

    file: str
    names: tuple[str, ...]
    header_line: int
    cells: CsvCells
    rows: Int64Array | None = None
    decimal_comma: bool = False
    notes: tuple[str, ...] = ()

    @property
    def n_in_file(self) -> int:
        """See `FileTable`."""
        return self.cells.read.num_rows

    def column(self, name: str) -> pa.Array:
        """See `FileTable`."""
        cells = self._select_column(self.cells.read, name)
        return with_points(cells) if self.decimal_comma else cells

    def text(self, name: str) -> pa.Array:
        """See `FileTable`."""
        read = self.cells.read
        if pa.types.is_large_string(read.column(self.names.index(name)).type):
            return self._select_column(read, name)
        return self._select_column(self.cells.text, name)

    def lines(self, rows: Int64Array) -> Int64Array:
        """See `FileTable`."""
        return self.cells.records.scan.lines[self.index_in_file(rows)]

    def _select_column(self, cells: pa.Table, name: str) -> pa.Array:
        column = combine_chunks(cells.column(self.names.index(name)))
        return column if self.rows is None else column.take(pa.array(self.rows))


def parse_csv(raw: bytes, file: str, issues: IssueCollector) -> CsvTable | None:
    """Split a CSV file into cells; None where nothing can be read.

    Empty lines are skipped. What cannot be read is added to `issues`; rows with too many or too few cells
    are left out. A byte order mark is accepted.
    """
    text, notes = decode(raw, file, issues)
    if text is None:
        return None
    named = _SEPARATOR_LINE.match(text)
    first = _NOT_EMPTY_PATTERN.search(text, named.end() if named else 0)
    if first is None:
        issues.add(file, "is empty; it needs a header and one line for each traverse")
        return None
    if _report_long_line(text, file, issues):
        return None
    header_line = 1 + count_lines(text[: first.start()])
    separator = named[1] if named else _find_separator(text, first.start(), header_line, file, issues)
    if separator is None:
        return None
    header = next_record(text, first.start(), separator)
    columns = len(split_cells(header[0], separator)) if b'"' in header[0] else 1 + header[0].count(separator)
    if report_excess(file, columns, MAX_COLUMNS, "columns", issues):
        return None
    names = tuple(unquote(cell) for cell in split_cells(header[0], separator))
    records = CsvRecords(text, header.end(), header_line + count_lines(header[0]), len(names), separator)
    first_row = _NOT_EMPTY_PATTERN.search(text, records.start)
    if first_row is None:
        whole = CsvRecords(text, header.start(), header_line, len(names), separator)
        if records.quoted and whole.scan.unclosed:
            issues.add(file, _UNCLOSED_MESSAGE, line=header_line, value='"')
        else:
            issues.add(file, "has a header and no rows; add one line for each traverse")
        return None
    first_cells = split_cells(next_record(text, first_row.start(), separator)[0], separator)
    try:
        read, any_ragged = _read_columns(records, _numeric_columns(names, first_cells))
    except pa.ArrowInvalid:
        message = f"more than {_MAX_RAGGED:,} rows have another number of cells than the header; correct that"
        issues.add(file, message, line=header_line)
        return None
    if report_excess(file, read.num_rows, MAX_ROWS, "rows", issues):
        return None
    if any_ragged:
        _report_ragged(records, read.num_rows, file, issues)
    if _may_be_unclosed(records, read) and records.scan.unclosed is not None:
        issues.add(file, _UNCLOSED_MESSAGE, line=records.scan.unclosed, value='"')
    table = CsvTable(file, names, header_line, CsvCells(records, read), notes=notes)
    return table if separator == COMMA else _with_decimals(table, separator, issues)


def _find_separator(text: bytes, start: int, line: int, file: str, issues: IssueCollector) -> bytes | None:
    """What separates the cells of the header, by the columns that are then known; None if two things may."""
    header = text[start : next_record(text, start).end()].splitlines()[0]
    known = {
        separator: sum(is_known(unquote(part.strip())) for part in header.split(separator))
        for separator in _SEPARATORS
        if separator in header
    }
    best = max(known, key=lambda separator: known[separator], default=COMMA)
    if not known.get(best):
        return COMMA
    rivals = [_SEPARATORS[separator] for separator in known if known[separator] == known[best]]
    if len(rivals) > 1:
        message = f"has {' and '.join(rivals)} between the names of columns; separate all of them by one"
        issues.add(file, message, line=line, value=header.decode())
        return None
    return best


def _with_decimals(table: CsvTable, separator: bytes, issues: IssueCollector) -> CsvTable | None:
    """A table without commas between its cells, with the note that says so; None where decimals differ."""
    columns = {name: table.text(name) for name in dict.fromkeys(table.names) if _may_hold_numbers(name)}
    decimals = find_decimals(columns) if not _all_numbers(table, columns) else find_decimals({})
    if decimals.comma and decimals.point:
        decimals.report_both(table, issues)
        return None
    commas = ", and decimals by commas" if decimals.comma else ""
    note = f"{table.file}: cells are separated by {_SEPARATORS[separator]}{commas}; it was read so"
    return replace(table, decimal_comma=bool(decimals.comma), notes=(*table.notes, note))


def _all_numbers(table: CsvTable, columns: Iterable[str]) -> bool:
    """Whether all these columns were read as numbers, whose decimals then have points."""
    kinds = [table.cells.read.column(table.names.index(name)).type for name in columns]
    return not any(map(pa.types.is_large_string, kinds))


def _may_hold_numbers(name: str) -> bool:
    return holds_numbers(name) or _POSITION_COLUMN.match(name) is not None


def _report_long_line(text: bytes, file: str, issues: IssueCollector) -> bool:
    """Whether a line is longer than any that is read."""
    end = 0
    while end + _MAX_LINE < len(text):
        start = end
        end = 1 + max(text.rfind(mark, start, start + _MAX_LINE) for mark in (b"\n", b"\r"))
        if not end:
            message = f"has more than {_MAX_LINE >> 20} MiB, so the file is damaged, or no table"
            issues.add(file, message, line=1 + count_lines(text[:start]))
            return True
    return False


def _numeric_columns(names: tuple[str, ...], first_cells: list[bytes]) -> list[int]:
    """Columns that hold numbers by the format, or else by their first cell."""
    return [
        position
        for position, (name, cell) in enumerate(zip(names, first_cells, strict=False))
        if holds_numbers(name) or (not is_known(name) and _NUMBER_PATTERN.fullmatch(cell))
    ]


def _read_columns(records: CsvRecords, numeric: list[int]) -> tuple[pa.Table, bool]:
    """Columns, `numeric` ones as numbers where possible, and whether ragged rows were left out."""
    try:
        return _parse_block(records, numeric, _BLOCK_SIZE)
    except pa.ArrowInvalid:
        # A cell that is no number, or a record longer than a block.
        return _parse_block(records, [], min(len(records.raw), _MAX_BLOCK_SIZE))


def _parse_block(records: CsvRecords, numeric: list[int], block: int) -> tuple[pa.Table, bool]:
    ragged: list[csv.InvalidRow] = []

    def skip(row: csv.InvalidRow) -> str:
        ragged.append(row)
        return "skip" if len(ragged) <= _MAX_RAGGED else "error"

    names = [str(position) for position in range(records.width)]
    kinds = dict.fromkeys(names, pa.large_string()) | {str(position): pa.float64() for position in numeric}
    cells = csv.read_csv(
        pa.BufferReader(pa.py_buffer(records.raw).slice(records.start)),
        read_options=csv.ReadOptions(
            column_names=names,
            block_size=block,
            # Threads gain nothing on one block, and may outlive the program on a faulty log.
            use_threads=len(records.raw) > block,
        ),
        parse_options=csv.ParseOptions(
            delimiter=records.separator.decode(),
            newlines_in_values=records.quoted,
            invalid_row_handler=skip,
        ),
        convert_options=csv.ConvertOptions(
            column_types=kinds, null_values=[""], strings_can_be_null=False, check_utf8=False
        ),
    )
    return cells, bool(ragged)


def _may_be_unclosed(records: CsvRecords, cells: pa.Table) -> bool:
    """Whether every record must be scanned: an unclosed cell contains all lines that follow."""
    if not records.quoted or not cells.num_rows:
        return records.quoted
    last = str(cells.column(records.width - 1)[-1])
    return "\n" in last or "\r" in last or not records.raw.endswith((b"\n", b"\r"))


def _report_ragged(records: CsvRecords, good: int, file: str, issues: IssueCollector) -> None:
    ragged, separator = records.scan.ragged, records.separator
    mark = {b"\t": "tab"}.get(separator, _SEPARATORS[separator][:-1])
    located = []
    for record in ragged[:MAX_SHOWN]:
        quoted = b'"' in record.text
        count = len(split_cells(record.text, separator)) if quoted else 1 + record.text.count(separator)
        advice = f"quote text that holds a {mark}"
        if separator == COMMA:
            advice = "write decimals with a point, or separate cells by semicolons, and " + advice
        if count < records.width:
            advice = f"fill in what is missing, or add {_SEPARATORS[separator]}"
        message = f"has {count} cells where the header has {records.width}; {advice}"
        located.append((record.line, None, record.text.decode("utf-8", "replace"), message))
    if is_shared(len(ragged), good + len(ragged)):
        line, _, value, message = located[0]
        counted = f"{len(ragged):,} of {good + len(ragged):,} rows are faulty, the first one in line {line}"
        issues.add(file, f"{counted}: {shorten(value)!r} {message}")
        return
    issues.add_lines(file, located, more=len(ragged) - len(located))
