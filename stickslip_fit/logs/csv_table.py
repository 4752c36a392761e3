"""CSV bytes into a Table, or into what is wrong with them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pyarrow as pa
from pyarrow import csv

from stickslip_fit.logs.columns import holds_numbers, is_known
from stickslip_fit.logs.encoding import as_utf8, complain_about_bytes, is_text
from stickslip_fit.logs.faults import Faults
from stickslip_fit.logs.records import Records, count_lines, next_record, split_cells, unquote
from stickslip_fit.logs.table import Rows, one_array

_BLOCK = 2 << 20
_LARGEST_BLOCK = 2**31 - 1
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_LIKE_NUMBER = re.compile(rb"[+-]?[0-9.]+([eE][+-]?[0-9]+)?")
_UNCLOSED = "has a quotation mark that opens a cell and is never closed; close it, or write it twice"
_NOT_EMPTY = re.compile(rb"[^\r\n]")
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}


@dataclass(frozen=True)
class CsvCells:
    """The cells below a header: as numbers where the format has numbers and all are, else as text."""

    records: Records
    read: pa.Table

    @cached_property
    def text(self) -> pa.Table:
        """All cells as they stand in the file, for people."""
        return _cut(self.records, numeric=[])[0]


@dataclass(frozen=True)
class CsvTable:
    """A CSV file; see `table.Table`."""

    file: str
    names: tuple[str, ...]
    header_line: int
    cells: CsvCells
    rows: Rows | None = None

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

    def lines(self, rows: Rows) -> Rows:
        """Line where each row begins."""
        return self.cells.records.lines[self._in_file(rows)]

    def place(self, row: int) -> str:
        """Where one row stands, in words."""
        return f"line {self.lines(np.array([row]))[0]} of {self.file}"

    def take(self, rows: Rows) -> CsvTable:
        """Only these rows."""
        return replace(self, rows=rows)

    def _chosen(self, cells: pa.Table, name: str) -> pa.Array:
        column = one_array(cells.column(self.names.index(name)))
        return column if self.rows is None else column.take(pa.array(self.rows))

    def _in_file(self, rows: Rows) -> Rows:
        return rows if self.rows is None else self.rows[rows]


def parse_csv(raw: bytes, file: str, faults: Faults) -> CsvTable | None:
    """Cut a CSV file into cells.

    Entirely empty lines are skipped, wherever they stand; nothing else is. A byte order mark and all
    three line ends are accepted.

    Parameters
    ----------
    raw : bytes
    file : str
        Name of the file, as given.
    faults : Faults
        Told of what cannot be read; rows with too many or too few cells are told of and left out.

    Returns
    -------
    CsvTable or None
        None where there is nothing to look at.
    """
    if not is_text(raw, file, faults):
        return None
    text = as_utf8(raw)
    start = len(_BYTE_ORDER_MARK) if text.startswith(_BYTE_ORDER_MARK) else 0
    first = _NOT_EMPTY.search(text, start)
    if first is None:
        faults.place(file, "is empty; it needs a header and one line for each traverse")
        return None
    header = next_record(text, first.start())
    header_line = 1 + count_lines(text[start : header.start()])
    names = tuple(unquote(cell) for cell in split_cells(header[0]))
    if text is not raw:
        complain_about_bytes(raw, names, file, faults)
    if _other_separator(header[0], names, file, header_line, faults):
        return None
    records = Records(text, header.end(), header_line + count_lines(header[0]), len(names))
    first_row = _NOT_EMPTY.search(text, records.start)
    if first_row is None:
        if Records(text, header.start(), header_line, len(names)).unclosed:
            faults.place(file, _UNCLOSED, line=header_line, value='"')
        else:
            faults.place(file, "has a header and no rows; add one line for each traverse")
        return None
    first_cells = split_cells(next_record(text, first_row.start())[0])
    read, any_ragged = _cut(records, _numeric(names, first_cells))
    if any_ragged:
        faults.lines(file, ((r.line, None, r.text, _width(r.cells, len(names))) for r in records.ragged))
    if _may_be_unclosed(records, read) and records.unclosed is not None:
        faults.place(file, _UNCLOSED, line=records.unclosed, value='"')
    return CsvTable(file, names, header_line, CsvCells(records, read))


def _other_separator(header: bytes, names: tuple[str, ...], file: str, line: int, faults: Faults) -> bool:
    text = header.decode("utf-8").rstrip("\r\n")
    for separator, called in _SEPARATORS.items():
        parts = [part.strip().strip('"') for part in text.split(separator)]
        if sum(map(is_known, parts)) > sum(map(is_known, names)):
            message = f"cells are separated by {called}; save the file with commas, and numbers with points"
            faults.place(file, message, line=line, value=text)
            return True
    return False


def _numeric(names: tuple[str, ...], first_cells: list[bytes]) -> list[int]:
    """Columns that hold numbers by the format, or else by their first cell."""
    return [
        position
        for position, (name, cell) in enumerate(zip(names, first_cells, strict=False))
        if holds_numbers(name) or (not is_known(name) and _LIKE_NUMBER.fullmatch(cell))
    ]


def _cut(records: Records, numeric: list[int]) -> tuple[pa.Table, bool]:
    """Cut into columns, `numeric` ones as numbers if they can be; and say if ragged rows were left out."""
    try:
        return _parse(records, numeric, _BLOCK)
    except pa.ArrowInvalid:
        # A cell that is no number, or a record longer than a block.
        return _parse(records, [], min(len(records.raw), _LARGEST_BLOCK))


def _parse(records: Records, numeric: list[int], block: int) -> tuple[pa.Table, bool]:
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


def _may_be_unclosed(records: Records, cells: pa.Table) -> bool:
    """Whether a look at every record is worth its time: an open cell swallows all lines that follow."""
    if not records.quoted or not cells.num_rows:
        return records.quoted
    last = str(cells.column(records.width - 1)[-1])
    return "\n" in last or "\r" in last or not records.raw.endswith((b"\n", b"\r"))


def _width(found: int, expected: int) -> str:
    if found < expected:
        return f"has {found} cells where the header has {expected}; fill in what is missing, or add commas"
    return (
        f"has {found} cells where the header has {expected}; "
        "write decimals with a point, and quote text that holds a comma"
    )
