"""CSV bytes into a table of cells, with the line of every record.

pyarrow parses the cells; records are scanned a second time only to say in which line a fault is. A
quoted cell may hold commas, line ends and doubled quotation marks; a quotation mark elsewhere is an
ordinary character. Lines end in LF, CR LF or CR. Bytes that are not UTF-8 are reported line by line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pyarrow import csv

from stickslip_fit._typing import Int64Array
from stickslip_fit.logs._table import IssueCollector, combine_chunks
from stickslip_fit.logs.schema import holds_numbers, is_known

_CELL_PATTERN = rb'(?>"(?:[^"]++|"")*+(?:"|\Z)[^,\r\n]*+|[^,"\r\n][^,\r\n]*+|)'
_END_PATTERN = rb"(?:\r\n|\r|\n|\Z)"
_RECORD_PATTERN = re.compile(_CELL_PATTERN + rb"(?:," + _CELL_PATTERN + rb")*+" + _END_PATTERN)
_ONE_CELL_PATTERN = re.compile(_CELL_PATTERN)
_UNCLOSED_PATTERN = re.compile(rb'"(?:[^"]++|"")*+\Z')


@dataclass(frozen=True)
class RaggedRecord:
    """A record with too many or too few cells."""

    line: int
    cells: int
    text: str


@dataclass(frozen=True)
class CsvRecords:
    r"""The records of `raw` from byte `start` on, which stands in line `first_line`.

    Examples
    --------
    >>> records = CsvRecords(b'1,"two\nlines"\n3\n4,5\n', start=0, first_line=1, width=2)
    >>> records.lines, records.ragged
    (array([1, 4]), [Ragged(line=3, cells=1, text='3')])
    """

    raw: bytes
    start: int
    first_line: int
    width: int

    @cached_property
    def quoted(self) -> bool:
        """Whether there is any quotation mark."""
        return b'"' in self.raw

    @property
    def lines(self) -> npt.NDArray[np.int64]:
        """Line where each record of the right width begins; empty lines are no records."""
        return self._scan[0]

    @property
    def ragged(self) -> list[RaggedRecord]:
        """Records of another width."""
        return self._scan[1]

    @property
    def unclosed(self) -> int | None:
        """Line of the record whose quotation mark is never closed."""
        return self._scan[2]

    @cached_property
    def _scan(self) -> tuple[npt.NDArray[np.int64], list[RaggedRecord], int | None]:
        fits = re.compile(
            _CELL_PATTERN + rb"(?:," + _CELL_PATTERN + rb"){%d}" % (self.width - 1) + _END_PATTERN
        )
        lines: list[int] = []
        ragged: list[RaggedRecord] = []
        unclosed = None
        position, line = self.start, self.first_line
        while position < len(self.raw):
            whole = fits.match(self.raw, position)
            end = (whole or next_record(self.raw, position)).end()
            record = self.raw[position:end]
            text = record.rstrip(b"\r\n")
            if whole and text:
                lines.append(line)
            elif text:
                ragged.append(RaggedRecord(line, len(split_cells(text)), text.decode("utf-8", "replace")))
            if end == len(self.raw) and any(
                _UNCLOSED_PATTERN.fullmatch(cell) for cell in split_cells(record)
            ):
                unclosed = line
            position, line = end, line + count_lines(record)
        return np.array(lines, dtype=np.int64), ragged, unclosed


def next_record(raw: bytes, position: int) -> re.Match[bytes]:
    """The record that begins at `position`, its line end included."""
    found = _RECORD_PATTERN.match(raw, position)
    assert found is not None, "the pattern matches anything, be it nothing"
    return found


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
        assert cell is not None, "the pattern matches anything, be it nothing"
        cells.append(cell[0])
        position = cell.end()
    return cells


def count_lines(raw: bytes) -> int:
    """Number of line ends."""
    return raw.count(b"\n") + raw.count(b"\r") - raw.count(b"\r\n")


def unquote(cell: bytes) -> str:
    """What a cell says."""
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
    """Say whether bytes may be text of one byte for each ASCII character, and tell if they aren't."""
    for mark, encoding in _OTHER_BYTE_ORDER_MARKS.items():
        if raw.startswith(mark):
            issues.place(file, f"is {encoding}; {_ENCODING_ADVICE}", line=1)
            return False
    position = raw.find(b"\0")
    if position >= 0:
        message = f"holds a zero byte, so it is damaged, or UTF-16, or no text at all; {_ENCODING_ADVICE}"
        issues.place(file, message, line=1 + count_lines(raw[:position]), value=r"\x00")
    return position < 0


def replace_invalid_utf8(raw: bytes) -> bytes:
    """Put stand-ins in the place of bytes that are not UTF-8, so that reading can go on."""
    if raw.isascii():
        return raw
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("utf-8", "replace").encode("utf-8")
    return raw


def report_invalid_bytes(raw: bytes, names: tuple[str, ...], file: str, issues: IssueCollector) -> None:
    """Tell of the first byte of each line that is not UTF-8."""
    found = []
    lines = re.split(r"\r\n|\r|\n", raw.decode("utf-8", "surrogateescape"))
    for line, text in enumerate(lines, start=1):
        foreign = re.search("[\udc80-\udcff]", text)
        if foreign:
            before = split_cells(text[: foreign.end()].encode("utf-8", "surrogateescape"))
            column = names[len(before) - 1] if line > 1 and len(before) <= len(names) else None
            cell = text[text.rfind(",", 0, foreign.start()) + 1 :].partition(",")[0]
            value = cell.encode("utf-8", "surrogateescape").decode("latin-1")
            message = f"byte 0x{ord(foreign[0]) - 0xDC00:02X} is not UTF-8; {_ENCODING_ADVICE}"
            found.append((line, column, value, message))
    issues.lines(file, found)


_BLOCK_SIZE = 2 << 20
_MAX_BLOCK_SIZE = 2**31 - 1
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_NUMBER_PATTERN = re.compile(rb"[+-]?[0-9.]+([eE][+-]?[0-9]+)?")
_UNCLOSED_MESSAGE = "has a quotation mark that opens a cell and is never closed; close it, or write it twice"
_NOT_EMPTY_PATTERN = re.compile(rb"[^\r\n]")
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
class CsvTable:
    """A CSV file; see `table.Table`."""

    file: str
    names: tuple[str, ...]
    header_line: int
    cells: CsvCells
    rows: Int64Array | None = None

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.cells.read.num_rows if self.rows is None else len(self.rows)

    def column(self, name: str) -> pa.Array:
        """Cells of a column, as text or numbers."""
        return self._chosen(self.cells.read, name)

    def text(self, name: str) -> pa.Array:
        """Cells of a column as they stand in the file."""
        if pa.types.is_large_string(self.cells.read.column(self.names.index(name)).type):
            return self.column(name)
        return self._chosen(self.cells.text, name)

    def lines(self, rows: Int64Array) -> Int64Array:
        """Line where each row begins."""
        return self.cells.records.lines[self._in_file(rows)]

    def place(self, row: int) -> str:
        """Where one row stands, in words."""
        return f"line {self.lines(np.array([row]))[0]} of {self.file}"

    def take(self, rows: Int64Array) -> CsvTable:
        """Only these rows."""
        return replace(self, rows=rows)

    def _chosen(self, cells: pa.Table, name: str) -> pa.Array:
        column = combine_chunks(cells.column(self.names.index(name)))
        return column if self.rows is None else column.take(pa.array(self.rows))

    def _in_file(self, rows: Int64Array) -> Int64Array:
        return rows if self.rows is None else self.rows[rows]


def parse_csv(raw: bytes, file: str, issues: IssueCollector) -> CsvTable | None:
    """Cut a CSV file into cells.

    Entirely empty lines are skipped, wherever they stand; nothing else is. A byte order mark and all
    three line ends are accepted.

    Parameters
    ----------
    raw : bytes
    file : str
        Name of the file, as given.
    issues : Faults
        Told of what cannot be read; rows with too many or too few cells are told of and left out.

    Returns
    -------
    CsvTable or None
        None where there is nothing to look at.
    """
    if not check_encoding(raw, file, issues):
        return None
    text = replace_invalid_utf8(raw)
    start = len(_BYTE_ORDER_MARK) if text.startswith(_BYTE_ORDER_MARK) else 0
    first = _NOT_EMPTY_PATTERN.search(text, start)
    if first is None:
        issues.place(file, "is empty; it needs a header and one line for each traverse")
        return None
    header = next_record(text, first.start())
    header_line = 1 + count_lines(text[start : header.start()])
    names = tuple(unquote(cell) for cell in split_cells(header[0]))
    if text is not raw:
        report_invalid_bytes(raw, names, file, issues)
    if _report_other_separator(header[0], names, file, header_line, issues):
        return None
    records = CsvRecords(text, header.end(), header_line + count_lines(header[0]), len(names))
    first_row = _NOT_EMPTY_PATTERN.search(text, records.start)
    if first_row is None:
        if CsvRecords(text, header.start(), header_line, len(names)).unclosed:
            issues.place(file, _UNCLOSED_MESSAGE, line=header_line, value='"')
        else:
            issues.place(file, "has a header and no rows; add one line for each traverse")
        return None
    first_cells = split_cells(next_record(text, first_row.start())[0])
    read, any_ragged = _read_columns(records, _numeric_columns(names, first_cells))
    if any_ragged:
        issues.lines(
            file, ((r.line, None, r.text, _width_message(r.cells, len(names))) for r in records.ragged)
        )
    if _may_be_unclosed(records, read) and records.unclosed is not None:
        issues.place(file, _UNCLOSED_MESSAGE, line=records.unclosed, value='"')
    return CsvTable(file, names, header_line, CsvCells(records, read))


def _report_other_separator(
    header: bytes, names: tuple[str, ...], file: str, line: int, issues: IssueCollector
) -> bool:
    text = header.decode("utf-8").rstrip("\r\n")
    for separator, called in _SEPARATORS.items():
        parts = [part.strip().strip('"') for part in text.split(separator)]
        if sum(map(is_known, parts)) > sum(map(is_known, names)):
            message = f"cells are separated by {called}; save the file with commas, and numbers with points"
            issues.place(file, message, line=line, value=text)
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
    """Cut into columns, `numeric` ones as numbers if they can be; and say if ragged rows were left out."""
    try:
        return _parse_block(records, numeric, _BLOCK_SIZE)
    except pa.ArrowInvalid:
        # A cell that is no number, or a record longer than a block.
        return _parse_block(records, [], min(len(records.raw), _MAX_BLOCK_SIZE))


def _parse_block(records: CsvRecords, numeric: list[int], block: int) -> tuple[pa.Table, bool]:
    ragged: list[csv.InvalidRow] = []

    def skip(row: csv.InvalidRow) -> str:
        ragged.append(row)
        return "skip"

    names = [str(position) for position in range(records.width)]
    kinds = dict.fromkeys(names, pa.large_string()) | {str(position): pa.float64() for position in numeric}
    cells = csv.read_csv(
        pa.BufferReader(pa.py_buffer(records.raw).slice(records.start)),
        read_options=csv.ReadOptions(
            column_names=names,
            block_size=block,
            # Threads would bring nothing, and may be alive when a faulty log ends the program.
            use_threads=len(records.raw) > block,
        ),
        parse_options=csv.ParseOptions(newlines_in_values=records.quoted, invalid_row_handler=skip),
        convert_options=csv.ConvertOptions(
            column_types=kinds, null_values=[""], strings_can_be_null=False, check_utf8=False
        ),
    )
    return cells, bool(ragged)


def _may_be_unclosed(records: CsvRecords, cells: pa.Table) -> bool:
    """Whether a look at every record is worth its time: an open cell swallows all lines that follow."""
    if not records.quoted or not cells.num_rows:
        return records.quoted
    last = str(cells.column(records.width - 1)[-1])
    return "\n" in last or "\r" in last or not records.raw.endswith((b"\n", b"\r"))


def _width_message(found: int, expected: int) -> str:
    if found < expected:
        return f"has {found} cells where the header has {expected}; fill in what is missing, or add commas"
    return (
        f"has {found} cells where the header has {expected}; "
        "write decimals with a point, and quote text that holds a comma"
    )
