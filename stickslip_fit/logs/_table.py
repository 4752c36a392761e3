"""A file as columns of raw cells, the parsing of cells, and the collection of issues.

The parsers turn a column into numbers, times or choices and report nothing; `IssueCollector` collects the
issues until all can be raised together.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from stickslip_fit._typing import Array, BoolArray, Int64Array
from stickslip_fit.errors import InputError, InputIssue, shorten


class FileTable(ABC):
    """Rows of one file, CSV, Excel or Parquet: all of them, or those at the ascending indices `rows`.

    `header_line` is None for Parquet, which has no lines. A cell is a string, a number or a timestamp.
    """

    file: str
    names: tuple[str, ...]
    header_line: int | None
    rows: Int64Array | None

    @property
    def notes(self) -> tuple[str, ...]:
        """On how the file was read."""
        return ()

    @property
    def type_faults(self) -> Mapping[str, str]:
        """What is wrong with whole columns, by name: Parquet has types that are neither number nor text."""
        return {}

    @property
    @abstractmethod
    def n_in_file(self) -> int:
        """Number of rows of the whole file."""

    @abstractmethod
    def column(self, name: str) -> pa.Array:
        """Cells of a column; null where empty."""

    @abstractmethod
    def text(self, name: str) -> pa.Array:
        """Cells of a column as they stand in the file; empty for null."""

    @abstractmethod
    def lines(self, rows: Int64Array) -> Int64Array:
        """Lines of the file (Parquet: rows, counted from 1) of rows counted from 0."""

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.n_in_file if self.rows is None else len(self.rows)

    def line(self, row: int) -> int:
        """See `lines`."""
        return int(self.lines(np.array([row]))[0])

    def locate(self, row: int) -> str:
        """Where a row stands, in words."""
        return f"{self.describe_place(self.line(row))} of {self.file}"

    def describe_place(self, line: int, column: str | None = None) -> str:
        """A line, or the cell of a column in it, as people find it in the file."""
        return f"{'row' if self.header_line is None else 'line'} {line}"

    def select(self, rows: Int64Array) -> FileTable:
        """Only these of the rows, in ascending order."""
        return replace(self, rows=self.index_in_file(rows))  # type: ignore[type-var]

    def index_in_file(self, rows: Int64Array) -> Int64Array:
        """Indices in the whole file."""
        return rows if self.rows is None else self.rows[rows]


MAX_ROWS = 5_000_000  # a traverse of one minute each, day and night for nine years
MAX_COLUMNS = 2_000
LEAST_ROWS_FOR_THREADS = 20_000


def report_excess(file: str, count: int, maximum: int, things: str, issues: IssueCollector) -> bool:
    """Whether a file has more of something than is read, which becomes an issue."""
    if count > maximum:
        issues.add(file, f"has {count:,} {things}, and no more than {maximum:,} are read; split it")
    return count > maximum


def combine_chunks(column: pa.ChunkedArray) -> pa.Array:
    """A column in one piece."""
    pieces: Any = column.combine_chunks()
    return pa.concat_arrays(pieces.chunks) if isinstance(pieces, pa.ChunkedArray) else pieces


MAX_SHOWN = 20
MIN_SHARED, MIN_SHARE = 6, 0.1  # of the rows: faults of one kind from which they are told once


def is_shared(faulty: int, rows: int) -> bool:
    """Whether so many rows have one fault that it is told once, with their number and the first of them."""
    return faulty >= max(MIN_SHARED, MIN_SHARE * rows)


# Line, column, value and message of one issue.
IssueLocation = tuple[int | None, str | None, str | None, str]
IssueMessage = str | Callable[[int, str], str]


@dataclass(frozen=True)
class _CellIssues:
    """An issue in some cells of a column, not yet looked up in the file."""

    table: FileTable
    rows: Int64Array
    column: str
    message: IssueMessage


class IssueCollector:
    """Collects issues; a fault that much of a column shares is one issue, of others 20 are shown."""

    def __init__(self) -> None:
        self._located: list[tuple[str, float, int, InputIssue]] = []
        self._cells: list[_CellIssues] = []
        self._sheets: dict[str, FileTable] = {}

    def __bool__(self) -> bool:
        return bool(self._located or self._cells)

    def add(
        self,
        file: str,
        message: str,
        line: int | None = None,
        column: str | None = None,
        value: str | None = None,
    ) -> None:
        """Add one issue."""
        self._located.append((file, line or 0, 0, InputIssue(message, file, line, column, value)))

    def add_sheet(self, table: FileTable) -> None:
        """Say the places of this file's issues as its sheet has them, not by lines."""
        self._sheets[table.file] = table

    def add_error(self, error: InputError) -> None:
        """Add the issues of an error."""
        for issue in error.problems:
            self._located.append((issue.file or "", issue.line or 0, 0, issue))

    def add_lines(self, file: str, issues: Iterable[IssueLocation], more: int = 0) -> None:
        """Add issues of one kind, each given as (line, column, value, message), and `more` only counted."""
        located = list(issues)
        for line, column, value, message in located[:MAX_SHOWN]:
            self.add(file, message, line, column, value)
        more += len(located[MAX_SHOWN:])
        if more:
            rest = InputIssue(f"... and {more:,} more like these", file)
            self._located.append((file, math.inf, 0, rest))

    def add_cells(self, table: FileTable, wrong: BoolArray, column: str, message: IssueMessage) -> None:
        """Add issues of one kind in a column, where `wrong`, shape (table.count,), is true.

        `message` may be a function of the row, counted from 0, and the cell's text.
        """
        rows = np.flatnonzero(wrong)
        if len(rows):
            self._cells.append(_CellIssues(table, rows, column, message))

    def raise_if_any(self) -> None:
        """Raise InputError with all issues, if any, in the order of files, lines and columns."""
        # Lines and cells are looked up only now: a file without issues is never searched for them.
        located = self._located + [issue for cells in self._cells for issue in _locate_issues(cells)]
        if located:
            raise InputError(
                self._in_sheet(issue) for *_, issue in sorted(located, key=lambda entry: entry[:3])
            )

    def _in_sheet(self, issue: InputIssue) -> InputIssue:
        sheet = self._sheets.get(issue.file or "")
        if sheet is None or issue.line is None:
            return issue
        return replace(issue, place=sheet.describe_place(issue.line, issue.column))


def _locate_issues(cells: _CellIssues) -> Iterator[tuple[str, float, int, InputIssue]]:
    table, column, shared = cells.table, cells.column, is_shared(len(cells.rows), cells.table.count)
    shown = cells.rows[: 1 if shared else MAX_SHOWN]
    position = table.names.index(column)
    values = table.text(column).take(pa.array(shown)).to_pylist()
    for row, line, value in zip(shown.tolist(), table.lines(shown).tolist(), values, strict=True):
        message = cells.message if isinstance(cells.message, str) else cells.message(row, value)
        if shared:
            count = f"{len(cells.rows):,} of {table.count:,} values"
            where = table.describe_place(line, column)
            told = f"{count} are faulty, the first one in {where}: {shorten(value)!r} {message}"
            yield table.file, line, position, InputIssue(told, table.file, column=column)
            continue
        if table.header_line is None:
            message += f" (row {line}; Parquet has no lines)"
        yield table.file, line, position, InputIssue(message, table.file, line, column, value)
    if not shared and len(cells.rows) > MAX_SHOWN:
        rest = f"... and {len(cells.rows) - MAX_SHOWN:,} more in this column"
        yield table.file, math.inf, position, InputIssue(rest, table.file, column=column)


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
    """Nanoseconds since 1970, UTC where `has_zone`; 0 where the cell is empty or bad."""

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
    index = encoded.indices.fill_null(len(texts)).to_numpy(zero_copy_only=False)
    return ParsedNumbers(np.append(values, np.nan)[index], blank[index])


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
    none = np.zeros(len(texts), np.bool_)
    try:
        # Text of this length that can be cast as a whole has minutes and no zone.
        if len(texts) and pc.min(pc.binary_length(texts)).as_py() >= _SHORTEST_TIME:
            return _build_times(texts.cast(_NANOSECONDS), none, none)
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


def _build_times(times: pa.Array, has_zone: BoolArray, empty: BoolArray) -> ParsedTimes:
    unread = _to_mask(times.is_null())
    values = times.cast(pa.int64()).fill_null(0).to_numpy(zero_copy_only=False)
    return ParsedTimes(values, has_zone & ~unread, empty, unread & ~empty)


def parse_choices(cells: pa.Array, choices: tuple[str, ...]) -> npt.NDArray[np.int8]:
    """Say which of `choices` stands in each cell (spaces around are accepted), -1 for none of them.

    Examples
    --------
    >>> parse_choices(pa.array(["+", " - ", "up"]), ("+", "-"))
    array([ 0,  1, -1], dtype=int8)
    """
    texts = to_text(cells)
    allowed = pa.array(choices, texts.type)
    index = pc.index_in(texts, allowed)
    if index.null_count:
        index = pc.index_in(pc.ascii_trim(texts, " \t"), allowed)
    return index.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int8)


def is_filled(cells: pa.Array) -> BoolArray:
    """Where a cell holds more than spaces."""
    if not _is_text(cells):
        return _to_mask(cells.is_valid())
    return _to_mask(pc.not_equal(pc.ascii_trim(to_text(cells), " \t"), ""))


def label_codes(codes: npt.NDArray[np.integer], labels: tuple[str, ...]) -> pd.Series:
    """Text from its index among `labels`; empty for -1."""
    return pa.array(["", *labels], pa.large_string()).take(pa.array(codes + 1)).to_pandas()


def to_text(cells: pa.Array) -> pa.Array:
    """Cells as text; empty for null."""
    return cells.cast(pa.large_string()).fill_null("")


def _is_text(cells: pa.Array) -> bool:
    return pa.types.is_large_string(cells.type) or pa.types.is_string(cells.type)


def _cast_valid(cells: pa.Array, kind: pa.DataType) -> pa.Array:
    """Cast, with null for what cannot be, such as 30 February; bisection finds the few among many."""
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


def run_in_threads(tasks: Mapping[str, Callable[[], Any]], size: int) -> dict[str, Any]:
    """Run all tasks and return what each of them returns.

    In threads where the tasks work on enough rows, `size`, that these take longer than threads to begin.

    Examples
    --------
    >>> run_in_threads({"two": lambda: 1 + 1, "four": lambda: 2 + 2}, size=100_000)
    {'two': 2, 'four': 4}
    """
    if size < LEAST_ROWS_FOR_THREADS:
        return {name: task() for name, task in tasks.items()}
    with ThreadPoolExecutor() as pool:
        running = {name: pool.submit(task) for name, task in tasks.items()}
        return {name: task.result() for name, task in running.items()}
