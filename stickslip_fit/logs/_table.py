"""A file as columns of raw cells, the parsing of cells, and the collection of faults.

`FileTable` is what CSV and Parquet files have in common. The parsers turn a column into numbers, times
or choices and report nothing; `IssueCollector` keeps the faults until all can be raised together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from stickslip_fit._typing import Array, BoolArray, Int64Array
from stickslip_fit.errors import InputError, InputIssue


class FileTable(Protocol):
    """Rows of one file, CSV or Parquet.

    Attributes
    ----------
    file : str
        Name as given.
    names : tuple of str
        The header.
    header_line : int or None
        None for Parquet, which has no lines.
    count : int
        Number of rows.
    """

    @property
    def file(self) -> str: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def header_line(self) -> int | None: ...
    @property
    def count(self) -> int: ...

    def column(self, name: str) -> pa.Array:
        """Cells of a column: strings, numbers or timestamps; null where empty."""

    def text(self, name: str) -> pa.Array:
        """Cells of a column as they stand in the file; empty for null."""

    def lines(self, rows: Int64Array) -> Int64Array:
        """Lines of the file (Parquet: rows, counted from 1) of a few rows, counted from 0."""

    def place(self, row: int) -> str:
        """Where one row stands, in words."""

    def take(self, rows: Int64Array) -> FileTable:
        """Only these rows, which ascend."""


def combine_chunks(column: pa.ChunkedArray) -> pa.Array:
    """A column in one piece."""
    pieces: Any = column.combine_chunks()
    return pa.concat_arrays(pieces.chunks) if isinstance(pieces, pa.ChunkedArray) else pieces


MAX_SHOWN = 20
# Line, column, value and message of one fault.
IssueLocation = tuple[int | None, str | None, str | None, str]
IssueMessage = str | Callable[[int, str], str]


@dataclass(frozen=True)
class _CellIssues:
    """The same kind of fault in some cells of a column, not yet looked up in the file."""

    table: FileTable
    rows: npt.NDArray[np.int64]
    column: str
    message: IssueMessage


class IssueCollector:
    """Collects the faults of one reading.

    A column may hold the same fault a million times: the first 20 are shown, the rest counted.
    """

    def __init__(self) -> None:
        self._placed: list[tuple[str, float, int, InputIssue]] = []
        self._cells: list[_CellIssues] = []

    def __bool__(self) -> bool:
        return bool(self._placed or self._cells)

    def place(
        self,
        file: str,
        message: str,
        *,
        line: int | None = None,
        column: str | None = None,
        value: str | None = None,
    ) -> None:
        """Add one fault whose place is known."""
        self._placed.append((file, line or 0, 0, InputIssue(message, file, line, column, value)))

    def lines(self, file: str, issues: Iterable[IssueLocation]) -> None:
        """Add the same kind of fault at many lines, each given as (line, column, value, message)."""
        found = list(issues)
        for line, column, value, message in found[:MAX_SHOWN]:
            self.place(file, message, line=line, column=column, value=value)
        if len(found) > MAX_SHOWN:
            rest = InputIssue(f"... and {len(found) - MAX_SHOWN:,} more like these", file)
            self._placed.append((file, math.inf, 0, rest))

    def cells(
        self, table: FileTable, wrong: npt.NDArray[np.bool_], column: str, message: IssueMessage
    ) -> None:
        """Add the same kind of fault in many cells of a column.

        Parameters
        ----------
        table : Table
        wrong : array of bool, shape (table.count,)
        column : str
            As written in the file.
        message : str or function
            The function is handed the row, counted from 0, and the cell's text.
        """
        rows = np.flatnonzero(wrong)
        if len(rows):
            self._cells.append(_CellIssues(table, rows, column, message))

    def raise_if_any(self) -> None:
        """Tell all of it, file by file, line by line and column by column.

        Raises
        ------
        InputError
            If any fault was added.
        """
        # Lines and cells are looked up only now: a file without faults is never searched for them.
        found = self._placed + [placed for cells in self._cells for placed in _locate_issues(cells)]
        if found:
            raise InputError(problem for *_, problem in sorted(found, key=lambda placed: placed[:3]))


def _locate_issues(cells: _CellIssues) -> Iterator[tuple[str, float, int, InputIssue]]:
    table, column, shown = cells.table, cells.column, cells.rows[:MAX_SHOWN]
    position = table.names.index(column)
    values = table.text(column).take(pa.array(shown)).to_pylist()
    for row, line, value in zip(shown.tolist(), table.lines(shown).tolist(), values, strict=True):
        said = cells.message if isinstance(cells.message, str) else cells.message(row, value)
        if table.header_line is None:
            said += f" (row {line}; Parquet has no lines)"
        yield table.file, line, position, InputIssue(said, table.file, line, column, value)
    if len(cells.rows) > MAX_SHOWN:
        rest = InputIssue(
            f"... and {len(cells.rows) - MAX_SHOWN:,} more in this column", table.file, column=column
        )
        yield table.file, math.inf, position, rest


_NUMBER_PATTERN = r"^[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?$"
_TIME_PATTERN = r"^[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:[0-9]{2}(:[0-9]{2}([.][0-9]{1,9})?)?"
_ZONE_PATTERN = r"(Z|[+-][0-9]{2}(:?[0-9]{2})?)"
_SHORTEST_TIME = len("2012-03-05T09:41")
_NANOSECONDS = pa.timestamp("ns")
_UTC = pa.timestamp("ns", "UTC")


@dataclass(frozen=True)
class ParsedNumbers:
    """Numbers, not finite where the cell is empty or bad."""

    values: Array
    empty: BoolArray

    @property
    def bad(self) -> BoolArray:
        """Where a cell that is not empty holds no finite number."""
        return ~(np.isfinite(self.values) | self.empty)


@dataclass(frozen=True)
class ParsedTimes:
    """Nanoseconds since 1970, UTC where zoned; 0 where the cell is empty or bad."""

    values: Int64Array
    has_zone: BoolArray
    empty: BoolArray
    bad: BoolArray


def parse_numbers(cells: pa.Array) -> ParsedNumbers:
    """Read plain decimal numbers: ASCII digits, a point, an exponent, spaces around.

    Examples
    --------
    >>> parse_numbers(pa.array(["12540.0", " -1e-3 ", "", "1,5", "0x10"])).values
    array([ 1.254e+04, -1.000e-03,        nan,        nan,        nan])
    """
    if pa.types.is_timestamp(cells.type):
        cells = to_text(cells)
    if not _is_text(cells):
        return ParsedNumbers(_to_floats(cells.cast(pa.float64(), safe=False)), _to_mask(cells.is_null()))
    # Most columns repeat a few values; each is read once.
    encoded = cells.dictionary_encode()
    texts = pc.ascii_trim(encoded.dictionary, " \t")
    well_formed = pc.match_substring_regex(texts, _NUMBER_PATTERN)
    values = _to_floats(pc.if_else(well_formed, texts, None).cast(pa.float64()))
    blank = np.append(_to_mask(pc.equal(texts, "")), True)
    place = _to_indices(encoded.indices, len(texts))
    return ParsedNumbers(np.append(values, np.nan)[place], blank[place])


def parse_times(cells: pa.Array) -> ParsedTimes:
    """Read ISO 8601 dates with a time of day, with or without a zone.

    Examples
    --------
    >>> times = parse_times(pa.array(["1970-01-01T00:00:01", "1970-01-01 02:00+02:00", "1970-01-01"]))
    >>> times.values, times.has_zone, times.bad
    (array([1000000000,          0,          0]), array([False,  True, False]), array([False, False,  True]))
    """
    if not pa.types.is_timestamp(cells.type):
        return _parse_written_times(to_text(cells))
    read = _cast_valid(cells.cast(pa.timestamp(cells.type.unit)), _NANOSECONDS)
    return _build_times(read, np.full(len(cells), cells.type.tz is not None), _to_mask(cells.is_null()))


def _parse_written_times(texts: pa.Array) -> ParsedTimes:
    nowhere = np.zeros(len(texts), np.bool_)
    try:
        # What is read at one go and is this long has minutes and no zone.
        if len(texts) and pc.min(pc.binary_length(texts)).as_py() >= _SHORTEST_TIME:
            return _build_times(texts.cast(_NANOSECONDS), nowhere, nowhere)
    except pa.ArrowInvalid:
        pass
    texts = pc.ascii_trim(texts, " \t")
    local = pc.match_substring_regex(texts, _TIME_PATTERN + "$")
    universal = pc.match_substring_regex(texts, _TIME_PATTERN + _ZONE_PATTERN + "$")
    read = pc.coalesce(
        _cast_valid(pc.if_else(local, texts, None), _NANOSECONDS),
        _cast_valid(pc.if_else(universal, texts, None), _UTC).cast(_NANOSECONDS),
    )
    return _build_times(read, _to_mask(universal), _to_mask(pc.equal(texts, "")))


def _build_times(read: pa.Array, zoned: BoolArray, empty: BoolArray) -> ParsedTimes:
    unread = _to_mask(read.is_null())
    values = read.cast(pa.int64()).fill_null(0).to_numpy(zero_copy_only=False)
    return ParsedTimes(values, zoned & ~unread, empty, unread & ~empty)


def parse_choices(cells: pa.Array, choices: tuple[str, ...]) -> npt.NDArray[np.int8]:
    """Say which of `choices` stands in each cell (spaces around are accepted), -1 for none of them.

    Examples
    --------
    >>> parse_choices(pa.array(["+", " - ", "up"]), ("+", "-"))
    array([ 0,  1, -1], dtype=int8)
    """
    texts = to_text(cells)
    known = pa.array(choices, texts.type)
    found = pc.index_in(texts, known)
    if found.null_count:
        found = pc.index_in(pc.ascii_trim(texts, " \t"), known)
    return found.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int8)


def is_filled(cells: pa.Array) -> BoolArray:
    """Where a cell holds more than spaces."""
    if not _is_text(cells):
        return _to_mask(cells.is_valid())
    return _to_mask(pc.not_equal(pc.ascii_trim(to_text(cells), " \t"), ""))


def label_codes(codes: npt.NDArray[np.integer], labels: tuple[str, ...]) -> pd.Series:
    """Text from its place among `labels`; empty for -1."""
    return pa.array(["", *labels], pa.large_string()).take(pa.array(codes + 1)).to_pandas()


def to_text(cells: pa.Array) -> pa.Array:
    """Cells as text; empty for null."""
    return cells.cast(pa.large_string()).fill_null("")


def _to_indices(indices: pa.Array, of_null: int) -> Int64Array:
    return indices.fill_null(of_null).to_numpy(zero_copy_only=False)


def _is_text(cells: pa.Array) -> bool:
    return pa.types.is_large_string(cells.type) or pa.types.is_string(cells.type)


def _cast_valid(cells: pa.Array, kind: pa.DataType) -> pa.Array:
    """Cast what can be; 30 February can't, and becomes null. Halving finds the few among many."""
    try:
        return cells.cast(kind)
    except pa.ArrowInvalid:
        if len(cells) == 1:
            return pa.nulls(1, kind)
        half = len(cells) // 2
        return pa.concat_arrays([_cast_valid(cells[:half], kind), _cast_valid(cells[half:], kind)])


def _to_floats(cells: pa.Array) -> Array:
    return cells.fill_null(np.nan).to_numpy(zero_copy_only=False)


def _to_mask(cells: pa.Array) -> BoolArray:
    return cells.to_numpy(zero_copy_only=False)


def run_in_threads(tasks: dict[str, Callable[[], Any]]) -> dict[str, Any]:
    """Run all tasks, in threads, and return what each of them returns.

    Examples
    --------
    >>> run_in_threads({"two": lambda: 1 + 1, "four": lambda: 2 + 2})
    {'two': 2, 'four': 4}
    """
    with ThreadPoolExecutor() as pool:
        running = {name: pool.submit(task) for name, task in tasks.items()}
        return {name: task.result() for name, task in running.items()}
