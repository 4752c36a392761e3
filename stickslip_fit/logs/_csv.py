"""CSV bytes into a table of cells, with the line of every record.

pyarrow parses the cells; the csv module reads the records a second time only to locate an issue. A
quoted cell may hold separators, line ends and doubled quotation marks; a quotation mark elsewhere is an
ordinary character. Lines end in LF, CR LF or CR. Cells are separated by commas, or by what the header has
instead; then numbers may have decimal commas.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from stickslip_fit._format import pluralize
from stickslip_fit._typing import Int64Array
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.logs._encoding import count_lines, decode
from stickslip_fit.logs._numbers import find_decimals, with_points
from stickslip_fit.logs._table import (
    MAX_COLUMNS,
    MAX_ROWS,
    MAX_SHOWN,
    FileTable,
    IssueCollector,
    IssueLocation,
    combine_chunks,
    is_filled,
    is_shared,
    report_excess,
)
from stickslip_fit.logs.schema import holds_numbers, is_known

COMMA = ","
_NOT_EMPTY_PATTERN = re.compile(rb"[^\r\n]")
_LINE_PATTERN = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")


class Record(NamedTuple):
    """Cells of a record, the line in which it begins, its bytes without the line end, and where that ends."""

    cells: list[str]
    line: int
    raw: bytes
    end: int


def read_records(raw: bytes, start: int, line: int, separator: str) -> Iterator[Record]:
    r"""The records of `raw` from byte `start` on, which is in this line; empty lines are no records.

    Examples
    --------
    >>> [(one.line, one.cells) for one in read_records(b'1,"two\nlines"\n\n4,5\n', 0, 1, ",")]
    [(1, ['1', 'two\nlines']), (4, ['4', '5'])]
    """
    lines: list[re.Match[bytes]] = []

    def decode_lines() -> Iterator[str]:
        for found in _LINE_PATTERN.finditer(raw, start):
            lines.append(found)
            yield found[0].decode("utf-8", "replace")

    reader = csv.reader(decode_lines(), delimiter=separator)
    while True:
        # A quotation mark that is never closed makes one cell of all that follows. All readers share it.
        limit = csv.field_size_limit(len(raw) + 1)
        try:
            cells = next(reader, None)
        finally:
            csv.field_size_limit(limit)
        if cells is None:
            return
        if cells:
            first, end = lines[0].start(), lines[-1].end()
            yield Record(cells, line, raw[first:end].rstrip(b"\r\n"), end)
        line += len(lines)
        lines.clear()


class CsvScan(NamedTuple):
    """Lines of records of the right width, records of another width, and the line of an open quote."""

    lines: Int64Array
    ragged: list[Record]
    unclosed: int | None


@dataclass(frozen=True)
class CsvRecords:
    """The records of `raw` from byte `start` on, which is in `first_line`; all should have `width` cells."""

    raw: bytes
    start: int
    first_line: int
    width: int
    separator: str = COMMA

    @cached_property
    def quoted(self) -> bool:
        """Whether there is any quotation mark."""
        return b'"' in self.raw

    @cached_property
    def scan(self) -> CsvScan:
        """Every record visited once."""
        lines: list[int] = []
        ragged: list[Record] = []
        unclosed = None
        for record in read_records(self.raw + b"\nx", self.start, self.first_line, self.separator):
            if record.end == len(self.raw) + 2:
                if record.cells == ["x"]:
                    break
                unclosed = record.line  # what was added is in a quotation that began before it
                record = record._replace(raw=record.raw.removesuffix(b"\nx").rstrip(b"\r\n"))
            if len(record.cells) == self.width:
                lines.append(record.line)
            else:
                ragged.append(record)
        return CsvScan(np.array(lines, dtype=np.int64), ragged, unclosed)


_BLOCK_SIZE = 2 << 20
_MAX_BLOCK_SIZE = 2**31 - 1
_MAX_LINE = 2**24  # bytes
_MAX_RAGGED = 10_000
_NUMBER_PATTERN = re.compile(r"[+-]?[0-9.]+([eE][+-]?[0-9]+)?")
_NO_ROWS_MESSAGE = "has a header and no rows; add one line for each traverse"
_UNCLOSED_MESSAGE = "has a quotation mark that opens a cell and is never closed; close it, or write it twice"
SEPARATOR_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
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
        return self.cells.read.num_rows

    def column(self, name: str) -> pa.Array:
        cells = self._select_column(self.cells.read, name)
        return with_points(cells) if self.decimal_comma else cells

    def text(self, name: str) -> pa.Array:
        read = self.cells.read
        if pa.types.is_large_string(read.column(self.names.index(name)).type):
            return self._select_column(read, name)
        return self._select_column(self.cells.text, name)

    def lines(self, rows: Int64Array) -> Int64Array:
        return self.cells.records.scan.lines[self.index_in_file(rows)]

    def _select_column(self, cells: pa.Table, name: str) -> pa.Array:
        column = combine_chunks(cells.column(self.names.index(name)))
        return column if self.rows is None else column.take(pa.array(self.rows))


def parse_csv(raw: bytes, file: str, issues: IssueCollector) -> CsvTable | None:
    """Split a CSV file into cells; None where nothing can be read.

    Empty lines are skipped, and so are, with a note, rows of empty cells and columns without a name and a
    cell at the end. What cannot be read is added to `issues`; rows with too many or too few cells are left
    out. A byte order mark is accepted.
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
    separator = (
        named[1].decode() if named else _find_separator(text, first.start(), header_line, file, issues)
    )
    if separator is None:
        return None
    header = next(read_records(text, first.start(), header_line, separator))
    if report_excess(file, len(header.cells), MAX_COLUMNS, "columns", issues):
        return None
    names = tuple(header.cells)
    body_line = header_line + count_lines(text[first.start() : header.end])
    records = CsvRecords(text, header.end, body_line, len(names), separator)
    first_row = next(read_records(text, records.start, body_line, separator), None)
    if first_row is None:
        whole = CsvRecords(text, first.start(), header_line, len(names), separator)
        if records.quoted and whole.scan.unclosed:
            issues.add(file, _UNCLOSED_MESSAGE, line=header_line, value='"')
        else:
            issues.add(file, _NO_ROWS_MESSAGE)
        return None
    try:
        read, ragged = _read_columns(records, _numeric_columns(names, first_row.cells))
    except pa.ArrowInvalid:
        message = f"more than {_MAX_RAGGED:,} rows have another number of cells than the header; correct that"
        issues.add(file, message, line=header_line)
        return None
    if report_excess(file, read.num_rows, MAX_ROWS, "rows", issues):
        return None
    if ragged:
        _report_ragged(records, read.num_rows, file, issues)
    if _may_be_unclosed(records, read) and records.scan.unclosed is not None:
        issues.add(file, _UNCLOSED_MESSAGE, line=records.scan.unclosed, value='"')
    table = _without_empty(CsvTable(file, names, header_line, CsvCells(records, read), notes=notes))
    if read.num_rows and not table.count:
        issues.add(file, _NO_ROWS_MESSAGE)
        return None
    return table if separator == COMMA else _with_decimals(table, separator, issues)


def _without_empty(table: CsvTable) -> CsvTable:
    """Without the empty cells that spreadsheets save below a table and to its right; a note says so."""
    columns, width = table.cells.read.columns, len(table.names)
    while width and not table.names[width - 1].strip() and not _holds_cells(columns[width - 1]):
        width -= 1
    empty = _find_empty_rows(columns)
    unnamed = len(table.names) - width
    counts = {"empty row": len(empty), "empty unnamed column": unnamed}
    told = [pluralize(count, thing) for thing, count in counts.items() if count]
    if not told:
        return table
    filled = np.setdiff1d(np.arange(table.n_in_file), empty) if len(empty) else None
    notes = (*table.notes, f"{table.file}: {' and '.join(told)} left out")
    return replace(table, names=table.names[:width], rows=filled, notes=notes)


def _holds_cells(column: pa.ChunkedArray) -> bool:
    return bool(is_filled(combine_chunks(column)).any())


def _find_empty_rows(columns: list[pa.ChunkedArray]) -> Int64Array:
    """Indices of the rows in which no cell holds more than spaces."""
    rows = np.arange(len(columns[0]))
    # A column of numbers knows whether it has an empty cell: most logs end here.
    for column in sorted(columns, key=lambda column: pa.types.is_large_string(column.type)):
        if not column.null_count and not pa.types.is_large_string(column.type):
            return rows[:0]
        rows = rows[~is_filled(combine_chunks(column).take(pa.array(rows)))]
    return rows


def _find_separator(text: bytes, start: int, line: int, file: str, issues: IssueCollector) -> str | None:
    """What separates the cells of the header, by the columns that are then known; None if two things may."""
    header = next(read_records(text, start, line, COMMA)).raw.decode("utf-8", "replace").splitlines()[0]
    known = {
        separator: sum(is_known(cell.strip()) for cell in next(csv.reader([header], delimiter=separator)))
        for separator in SEPARATOR_NAMES
        if separator in header
    }
    best = max(known, key=lambda separator: known[separator], default=COMMA)
    if not known.get(best):
        return COMMA
    rivals = [SEPARATOR_NAMES[separator] for separator in known if known[separator] == known[best]]
    if len(rivals) > 1:
        message = f"has {' and '.join(rivals)} between the names of columns; separate all of them by one"
        issues.add(file, message, line=line, value=header)
        return None
    return best


def _with_decimals(table: CsvTable, separator: str, issues: IssueCollector) -> CsvTable | None:
    """A table without commas between its cells, with the note that says so; None where decimals differ."""
    columns = {name: table.text(name) for name in dict.fromkeys(table.names) if _may_hold_numbers(name)}
    decimals = find_decimals(columns) if not _all_numbers(table, columns) else find_decimals({})
    try:
        decimals.check(table.file, table.line, table.describe_place)
    except InputError as error:
        issues.add_error(error)
        return None
    commas = ", and decimals by commas" if decimals.comma else ""
    note = f"{table.file}: cells are separated by {SEPARATOR_NAMES[separator]}{commas}; it was read so"
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


def _numeric_columns(names: tuple[str, ...], first_cells: list[str]) -> list[int]:
    """Columns that hold numbers by the format, or else by their first cell."""
    return [
        position
        for position, (name, cell) in enumerate(zip(names, first_cells, strict=False))
        if holds_numbers(name) or (not is_known(name) and _NUMBER_PATTERN.fullmatch(cell))
    ]


def _read_columns(records: CsvRecords, numeric: list[int]) -> tuple[pa.Table, int]:
    """Columns, `numeric` ones as numbers where possible, and how many ragged rows were left out."""
    try:
        return read_cells(records, numeric, _BLOCK_SIZE)
    except pa.ArrowInvalid:
        # A cell that is no number, or a record longer than a block.
        return read_cells(records, [], min(len(records.raw), _MAX_BLOCK_SIZE))


def read_cells(records: CsvRecords, numeric: list[int], block: int) -> tuple[pa.Table, int]:
    """As text, or as numbers in the columns that are `numeric`, and how many ragged rows were left out.

    Raises
    ------
    pyarrow.ArrowInvalid
        If a cell of these columns is no number, a record is longer than a block, or too many are ragged.
    """
    ragged = 0

    def skip(row: arrow_csv.InvalidRow) -> str:
        nonlocal ragged
        ragged += 1
        return "skip" if ragged <= _MAX_RAGGED else "error"

    names = [str(position) for position in range(records.width)]
    kinds = dict.fromkeys(names, pa.large_string()) | {str(position): pa.float64() for position in numeric}
    cells = arrow_csv.read_csv(
        pa.BufferReader(pa.py_buffer(records.raw).slice(records.start)),
        read_options=arrow_csv.ReadOptions(
            column_names=names,
            block_size=block,
            # Threads gain nothing on one block, and may outlive the program on a faulty log.
            use_threads=len(records.raw) > block,
        ),
        parse_options=arrow_csv.ParseOptions(
            delimiter=records.separator, newlines_in_values=records.quoted, invalid_row_handler=skip
        ),
        convert_options=arrow_csv.ConvertOptions(
            column_types=kinds, null_values=[""], strings_can_be_null=False, check_utf8=False
        ),
    )
    return cells, ragged


def _may_be_unclosed(records: CsvRecords, cells: pa.Table) -> bool:
    """Whether every record must be scanned: an unclosed cell contains all lines that follow."""
    if not records.quoted or not cells.num_rows:
        return records.quoted
    last = str(cells.column(records.width - 1)[-1])
    return "\n" in last or "\r" in last or not records.raw.endswith((b"\n", b"\r"))


def explain_ragged(record: Record, width: int, separator: str) -> str:
    """What is wrong with a record of too many or too few cells, and what to do about it."""
    if len(record.cells) < width:
        advice = f"fill in what is missing, or add {SEPARATOR_NAMES[separator]}"
    else:
        advice = f"quote text that holds a {SEPARATOR_NAMES[separator][:-1]}"
        if separator == COMMA:
            advice = "write decimals with a point, or separate cells by semicolons, and " + advice
    return f"has {pluralize(len(record.cells), 'cell')} where the header has {width}; {advice}"


def _report_ragged(records: CsvRecords, good: int, file: str, issues: IssueCollector) -> None:
    ragged = records.scan.ragged
    located: list[IssueLocation] = [
        (
            record.line,
            None,
            record.raw.decode("utf-8", "replace"),
            explain_ragged(record, records.width, records.separator),
        )
        for record in ragged[:MAX_SHOWN]
    ]
    if is_shared(len(ragged), good + len(ragged)):
        line, _, value, message = located[0]
        counted = f"{len(ragged):,} of {good + len(ragged):,} rows are faulty, the first one in line {line}"
        issues.add(file, f"{counted}: {shorten(value or '')!r} {message}")
        return
    issues.add_lines(file, located, more=len(ragged) - len(located))
