"""A sheet of an Excel workbook (.xlsx) as columns of cells, with the place of every cell as Excel shows it.

A column of numbers becomes numbers, one of dates becomes times, and any other is text, as which numbers and
dates are written as a log has them.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import date, datetime, time
from typing import Any

import numpy as np
import pyarrow as pa

from stickslip_fit._format import join_words
from stickslip_fit._typing import Int64Array
from stickslip_fit.errors import InputError
from stickslip_fit.logs._numbers import find_decimals, with_points
from stickslip_fit.logs._table import MAX_COLUMNS, FileTable, IssueCollector, report_excess
from stickslip_fit.logs.schema import holds_numbers, is_known

_WORKBOOK = re.compile(rb"PK\x03\x04(?s:.{0,4000})(\[Content_Types\]|xl/)")
MAX_UNPACKED = 2**31  # bytes; a sheet of 1,048,576 rows has fewer


@dataclass(frozen=True)
class SheetTable(FileTable):
    """A sheet.

    `header_line` and `numbers`, shape (n,), are rows as Excel counts them, `letters` what it calls columns.
    """

    file: str
    sheet: str
    names: tuple[str, ...]
    letters: tuple[str, ...]
    header_line: int
    numbers: Int64Array
    cells: tuple[tuple[Any, ...], ...]
    rows: Int64Array | None = None
    decimal_comma: bool = False
    notes: tuple[str, ...] = ()

    @property
    def n_in_file(self) -> int:
        return len(self.numbers)

    def column(self, name: str) -> pa.Array:
        values = self._values(name)
        filled = [value for value in values if value is not None]
        if all(type(value) in (int, float) for value in filled):
            return pa.array(values, pa.float64())
        if all(isinstance(value, datetime) for value in filled):
            return pa.array(values, pa.timestamp("us"))
        texts = pa.array([_to_text(value, with_time=True) for value in values], pa.large_string())
        return with_points(texts) if self.decimal_comma else texts

    def text(self, name: str) -> pa.Array:
        """See `FileTable`: a date without a time of day is written without one."""
        return pa.array([_to_text(value, with_time=False) for value in self._values(name)], pa.large_string())

    def lines(self, rows: Int64Array) -> Int64Array:
        """See `FileTable`: rows as Excel counts them."""
        return self.numbers[self.index_in_file(rows)]

    def locate(self, row: int) -> str:
        return f"row {self.line(row)} of sheet {self.sheet!r} of {self.file}"

    def describe_place(self, line: int, column: str | None = None) -> str:
        if column not in self.names:
            return f"sheet {self.sheet!r}, row {line}"
        return f"sheet {self.sheet!r}, cell {self.letters[self.names.index(column)]}{line}"

    def _values(self, name: str) -> list[Any]:
        values = self.cells[self.names.index(name)]
        return list(values) if self.rows is None else [values[row] for row in self.rows]


def is_workbook(raw: bytes) -> bool:
    """Whether a file's content is that of an Excel workbook."""
    return _WORKBOOK.match(raw) is not None


def _to_text(value: Any, *, with_time: bool) -> str:
    """A cell as a log has it in text.

    Examples
    --------
    >>> [_to_text(cell, with_time=False) for cell in (None, 12540.0, datetime(2012, 3, 5), True)]
    ['', '12540', '2012-03-05', 'TRUE']
    """
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).upper()
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    if isinstance(value, datetime):
        return (value.date() if not (with_time or value.time() != time(0)) else value).isoformat()
    return value.isoformat() if isinstance(value, date | time) else str(value)


def parse_sheet(raw: bytes, file: str, sheet: str | None, issues: IssueCollector) -> SheetTable | None:
    """Read the sheet of this name, or the first one; None where nothing can be read.

    Empty rows and columns are skipped. What cannot be read is added to `issues`.
    """
    from openpyxl.utils import get_column_letter

    opened = _open_sheet(raw, file, sheet, issues)
    if opened is None:
        return None
    name, others, rows = opened
    records = [(number, cells) for number, cells in enumerate(rows, start=1) if not _is_empty(cells)]
    if not records:
        issues.add(file, f"sheet {name!r} is empty; it needs a header and one row for each traverse")
        return None
    (header_line, header), *body = records
    width = max(len(cells) for _, cells in records)
    if report_excess(file, width, MAX_COLUMNS, "columns", issues):
        return None
    if not body:
        issues.add(file, f"sheet {name!r} has a header and no rows; add one row for each traverse")
        return None
    columns = list(zip(*(_pad(cells, width) for _, cells in records), strict=True))
    filled = [place for place, cells in enumerate(columns) if not _is_empty(cells)]
    if others and not any(is_known(_to_text(cell, with_time=False)) for cell in header):
        choice = join_words(list(map(repr, others)), "or")
        issues.add(file, f"sheet {name!r} has no column of a log; name another one, {choice}, with --sheet")
        return None
    note = f"{file}: sheet {name!r} was read, and not {join_words(list(map(repr, others)))}"
    table = SheetTable(
        file,
        name,
        tuple(_to_text(_pad(header, width)[place], with_time=False) for place in filled),
        tuple(get_column_letter(place + 1) for place in filled),
        header_line,
        np.array([number for number, _ in body], np.int64),
        tuple(columns[place][1:] for place in filled),
        notes=(note,) if others else (),
    )
    issues.add_sheet(table)
    return _with_decimals(table, issues)


def _open_sheet(
    raw: bytes, file: str, sheet: str | None, issues: IssueCollector
) -> tuple[str, list[str], Iterator[tuple[Any, ...]]] | None:
    """The sheet's name, those of the others, and its rows of values."""
    import openpyxl

    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            unpacked = sum(part.file_size for part in archive.infolist())
        if unpacked > MAX_UNPACKED:
            issues.add(file, f"has {unpacked / 2**20:,.0f} MiB unpacked; save its sheet as 'CSV UTF-8'")
            return None
        workbook = openpyxl.load_workbook(io.BytesIO(raw), read_only=True, data_only=True)
        sheets = {one.title: one for one in workbook.worksheets}
        name = sheet or next(iter(sheets), "")
        if name not in sheets:
            message = f"has no sheet {name!r}, but {join_words(list(map(repr, sheets)))}; name one of these"
            issues.add(file, message)
            return None
        # What the file says of its own size may be wrong.
        sheets[name].reset_dimensions()
        rows = list(sheets[name].iter_rows(values_only=True))
    # zipfile, the XML parser and openpyxl raise many kinds, all of them about the file.
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        issues.add(file, f"is no Excel workbook that can be read ({reason}); save its sheet as 'CSV UTF-8'")
        return None
    return name, [other for other in sheets if other != name], iter(rows)


def _with_decimals(table: SheetTable, issues: IssueCollector) -> SheetTable | None:
    """A table with the note that its numbers in text have decimal commas, if so; None where they differ."""
    written = {
        name: pa.array([cell if isinstance(cell, str) else "" for cell in cells], pa.large_string())
        for name, cells in zip(table.names, table.cells, strict=True)
        if holds_numbers(name)
    }
    decimals = find_decimals(written)
    if decimals.comma is None:
        return table
    try:
        decimals.check(table.file, table.line, table.describe_place)
    except InputError as error:
        issues.add_error(error)
        return None
    note = f"{table.file}: numbers in text have decimal commas, and were read so"
    return replace(table, decimal_comma=True, notes=(*table.notes, note))


def _is_empty(cells: tuple[Any, ...]) -> bool:
    return all(cell is None or (isinstance(cell, str) and not cell.strip()) for cell in cells)


def _pad(cells: tuple[Any, ...], width: int) -> tuple[Any, ...]:
    return cells + (None,) * (width - len(cells))
