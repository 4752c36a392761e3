"""CSV bytes into a table of cells, with the line of every record.

pyarrow parses the cells; records are scanned a second time only to locate an issue. A
quoted cell may hold commas, line ends and doubled quotation marks; a quotation mark elsewhere is an
ordinary character. Lines end in LF, CR LF or CR. Bytes that are not UTF-8 are reported line by line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv

from stickslip_fit._typing import Int64Array
from stickslip_fit.logs._table import (
    MAX_COLUMNS,
    MAX_ROWS,
    MAX_SHOWN,
    FileTable,
    IssueCollector,
    combine_chunks,
    report_excess,
)
from stickslip_fit.logs.schema import holds_numbers, is_known

_CELL_PATTERN = rb'(?>"(?:[^"]++|"")*+(?:"|\Z)[^,\r\n]*+|[^,"\r\n][^,\r\n]*+|)'
_END_PATTERN = rb"(?:\r\n|\r|\n|\Z)"
_RECORD_PATTERN = re.compile(_CELL_PATTERN + rb"(?:," + _CELL_PATTERN + rb")*+" + _END_PATTERN)
_ONE_CELL_PATTERN = re.compile(_CELL_PATTERN)
_NOT_EMPTY_PATTERN = re.compile(rb"[^\r\n]")
_UNCLOSED_PATTERN = re.compile(rb'"(?:[^"]++|"")*+\Z')


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

    @cached_property
    def quoted(self) -> bool:
        """Whether there is any quotation mark."""
        return b'"' in self.raw

    @cached_property
    def scan(self) -> CsvScan:
        """Every record visited once."""
        pattern = _CELL_PATTERN + rb"(?:," + _CELL_PATTERN + rb"){%d}" % (self.width - 1) + _END_PATTERN
        full_width = re.compile(pattern)
        lines: list[int] = []
        ragged: list[RaggedRecord] = []
        unclosed = None
        position, line = self.start, self.first_line
        while found := _NOT_EMPTY_PATTERN.search(self.raw, position):
            line += count_lines(self.raw[position : found.start()])
            position = found.start()
            match = full_width.match(self.raw, position)
            end = (match or next_record(self.raw, position)).end()
            record = self.raw[position:end]
            text = record.rstrip(b"\r\n")
            if match:
                lines.append(line)
            else:
                ragged.append(RaggedRecord(line, text))
            if end == len(self.raw) and any(map(_UNCLOSED_PATTERN.fullmatch, split_cells(record))):
                unclosed = line
            position, line = end, line + count_lines(record)
        return CsvScan(np.array(lines, dtype=np.int64), ragged, unclosed)


def next_record(raw: bytes, position: int) -> re.Match[bytes]:
    """The record that begins at `position`, its line end included."""
    record = _RECORD_PATTERN.match(raw, position)
    assert record is not None, "the pattern also matches nothing"
    return record


def split_cells(record: bytes) -> list[bytes]:
    """Cells of one record, quotation marks and all.

    Examples
    --------
    >>> split_cells(b'3,"a,b",')
    [b'3', b'"a,b"', b'']
    """
    cells, position = [], -1
    while position < 0 or record[position : position + 1] == b",":
        cell = _ONE_CELL_PATTERN.match(record, position + 1)
        assert cell is not None, "the pattern also matches nothing"
        cells.append(cell[0])
        position = cell.end()
    return cells


def count_lines(raw: bytes) -> int:
    """Number of line ends."""
    return raw.count(b"\n") + raw.count(b"\r") - raw.count(b"\r\n")


def unquote(cell: bytes) -> str:
    """The text of a cell."""
    text = cell.decode("utf-8", "replace")
    if not text.startswith('"'):
        return text
    quoted, _, rest = text[1:].replace('""', "\0").partition('"')
    return quoted.replace("\0", '"') + rest.replace("\0", '""')


_OTHER_BYTE_ORDER_MARKS = {
    b"\xff\xfe\x00\x00": "UTF-32",
    b"\x00\x00\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}
_ENCODING_ADVICE = "save the file as UTF-8 (in a spreadsheet: 'CSV UTF-8')"


def check_encoding(raw: bytes, file: str, issues: IssueCollector) -> bool:
    """Whether bytes may be text of one byte for each ASCII character; adds an issue if not."""
    for mark, encoding in _OTHER_BYTE_ORDER_MARKS.items():
        if raw.startswith(mark):
            issues.add(file, f"is {encoding}; {_ENCODING_ADVICE}", line=1)
            return False
    position = raw.find(b"\0")
    if position >= 0:
        message = f"holds a zero byte, so it is damaged, or UTF-16, or no text at all; {_ENCODING_ADVICE}"
        issues.add(file, message, line=1 + count_lines(raw[:position]), value=r"\x00")
    return position < 0


def replace_invalid_utf8(raw: bytes) -> bytes:
    """Replace bytes that are not UTF-8, so that reading can go on."""
    if raw.isascii():
        return raw
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("utf-8", "replace").encode("utf-8")
    return raw


def report_invalid_bytes(raw: bytes, names: tuple[str, ...], file: str, issues: IssueCollector) -> None:
    """Add an issue for the first byte of each line that is not UTF-8."""
    located = []
    lines = re.split(r"\r\n|\r|\n", raw.decode("utf-8", "surrogateescape"))
    for line, text in enumerate(lines, start=1):
        foreign = re.search("[\udc80-\udcff]", text)
        if foreign:
            before = split_cells(text[: foreign.end()].encode("utf-8", "surrogateescape"))
            column = names[len(before) - 1] if line > 1 and len(before) <= len(names) else None
            cell = text[text.rfind(",", 0, foreign.start()) + 1 :].partition(",")[0]
            value = cell.encode("utf-8", "surrogateescape").decode("latin-1")
            message = f"byte 0x{ord(foreign[0]) - 0xDC00:02X} is not UTF-8; {_ENCODING_ADVICE}"
            located.append((line, column, value, message))
    issues.add_lines(file, located)


_BLOCK_SIZE = 2 << 20
_MAX_BLOCK_SIZE = 2**31 - 1
_MAX_LINE = 2**24  # bytes
_MAX_RAGGED = 10_000
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_NUMBER_PATTERN = re.compile(rb"[+-]?[0-9.]+([eE][+-]?[0-9]+)?")
_UNCLOSED_MESSAGE = "has a quotation mark that opens a cell and is never closed; close it, or write it twice"
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}


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
    """A CSV file."""

    file: str
    names: tuple[str, ...]
    header_line: int
    cells: CsvCells
    rows: Int64Array | None = None

    @property
    def n_in_file(self) -> int:
        """See `FileTable`."""
        return self.cells.read.num_rows

    def column(self, name: str) -> pa.Array:
        """See `FileTable`."""
        return self._select_column(self.cells.read, name)

    def text(self, name: str) -> pa.Array:
        """See `FileTable`."""
        if pa.types.is_large_string(self.cells.read.column(self.names.index(name)).type):
            return self.column(name)
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
    if not check_encoding(raw, file, issues):
        return None
    text = replace_invalid_utf8(raw)
    start = len(_BYTE_ORDER_MARK) if text.startswith(_BYTE_ORDER_MARK) else 0
    first = _NOT_EMPTY_PATTERN.search(text, start)
    if first is None:
        issues.add(file, "is empty; it needs a header and one line for each traverse")
        return None
    if _report_long_line(text, file, issues):
        return None
    header = next_record(text, first.start())
    header_line = 1 + count_lines(text[start : header.start()])
    columns = len(split_cells(header[0])) if b'"' in header[0] else 1 + header[0].count(b",")
    if report_excess(file, columns, MAX_COLUMNS, "columns", issues):
        return None
    names = tuple(unquote(cell) for cell in split_cells(header[0]))
    if text is not raw:
        report_invalid_bytes(raw, names, file, issues)
    if _report_other_separator(header[0], names, file, header_line, issues):
        return None
    records = CsvRecords(text, header.end(), header_line + count_lines(header[0]), len(names))
    first_row = _NOT_EMPTY_PATTERN.search(text, records.start)
    if first_row is None:
        if records.quoted and CsvRecords(text, header.start(), header_line, len(names)).scan.unclosed:
            issues.add(file, _UNCLOSED_MESSAGE, line=header_line, value='"')
        else:
            issues.add(file, "has a header and no rows; add one line for each traverse")
        return None
    first_cells = split_cells(next_record(text, first_row.start())[0])
    try:
        read, any_ragged = _read_columns(records, _numeric_columns(names, first_cells))
    except pa.ArrowInvalid:
        message = f"more than {_MAX_RAGGED:,} rows have another number of cells than the header; correct that"
        issues.add(file, message, line=header_line)
        return None
    if report_excess(file, read.num_rows, MAX_ROWS, "rows", issues):
        return None
    if any_ragged:
        _report_ragged(records.scan.ragged, len(names), file, issues)
    if _may_be_unclosed(records, read) and records.scan.unclosed is not None:
        issues.add(file, _UNCLOSED_MESSAGE, line=records.scan.unclosed, value='"')
    return CsvTable(file, names, header_line, CsvCells(records, read))


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


def _report_other_separator(
    header: bytes, names: tuple[str, ...], file: str, line: int, issues: IssueCollector
) -> bool:
    text = header.decode("utf-8").rstrip("\r\n")
    for separator, name in _SEPARATORS.items():
        parts = [part.strip().strip('"') for part in text.split(separator)]
        if sum(map(is_known, parts)) > sum(map(is_known, names)):
            message = f"cells are separated by {name}; save the file with commas, and numbers with points"
            issues.add(file, message, line=line, value=text)
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
        parse_options=csv.ParseOptions(newlines_in_values=records.quoted, invalid_row_handler=skip),
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


def _report_ragged(ragged: list[RaggedRecord], width: int, file: str, issues: IssueCollector) -> None:
    located = []
    for record in ragged[:MAX_SHOWN]:
        count = len(split_cells(record.text)) if b'"' in record.text else 1 + record.text.count(b",")
        advice = "write decimals with a point, and quote text that holds a comma"
        if count < width:
            advice = "fill in what is missing, or add commas"
        message = f"has {count} cells where the header has {width}; {advice}"
        located.append((record.line, None, record.text.decode("utf-8", "replace"), message))
    issues.add_lines(file, located, more=len(ragged) - len(located))
