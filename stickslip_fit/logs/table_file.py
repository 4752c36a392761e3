"""read_table_file: a table of any columns from a CSV, Excel or Parquet file, as instruments write them.

Above the header a file may have comments and a preamble, and below it a row of units. The header is the line
above the first row of numbers; cells are separated by what gives most lines equally many of them.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
import pyarrow as pa

from stickslip_fit._format import join_words, pluralize
from stickslip_fit._input import format_path, read_file
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.logs._csv import CsvRecords, explain_ragged, read_cells
from stickslip_fit.logs._encoding import decode
from stickslip_fit.logs._files import find_foreign
from stickslip_fit.logs._numbers import find_decimals, read_column
from stickslip_fit.logs._sheet import is_workbook
from stickslip_fit.logs._table import IssueCollector
from stickslip_fit.units import TIME_SPELLINGS

MAX_BYTES = 2**29
SAMPLE = 2000  # lines from which the layout is judged
SEPARATORS = (";", "\t", "|", ",", " ")  # in doubt the first of them; " " stands for any blank space
LIKELY_SEPARATOR = 0.8  # of the lines that the one has which suits most of them
COMMENT = "#"
_SEPARATOR_LINE = re.compile(r"sep=([,;\t|])$", re.IGNORECASE)
_BLANK = re.compile(r"[ \t]+")
_LIKE_NUMBER = re.compile(r"[+-]?[.,]?\d[\d.,:/' \u00a0\u202f+\-eETZ]*([AaPp][Mm])?")
_NAMES = "degC|degF|deg|rad|Ohm|ohm|mol|cd|Hz|Pa|bar|eV|dBm|dB|sec|ppm|ppb|rpm|px|cts|counts|arb|a\\.u\\."
_TIMES = "|".join(name for names in TIME_SPELLINGS.values() for name in names)
_ONE_UNIT = rf"[fpnuµμmckMGT]?(?:{_NAMES}|{_TIMES}|[mgsAKNJWVCFΩSTHhlL°%])(?:\^?[-+]?\d|[²³⁻¹]+)?|°C|°F|1|-"
_UNIT = re.compile(rf"[\[(]?(?:{_ONE_UNIT})(?:[*/·. ](?:{_ONE_UNIT}))*[\])]?")


@dataclass(frozen=True)
class TableFile:
    """A table that was read.

    Attributes
    ----------
    frame : DataFrame
    note : str
        On how it was read; "" where nothing was guessed.
    sha256 : str
        Of the file.
    line_of : callable
        The line of the file, from 1, of a row of `frame`, from 0.
    lines_are : str
        What `line_of` counts, as people find it in the file, such as ``line``.
    """

    frame: pd.DataFrame
    note: str
    sha256: str
    line_of: Callable[[int], int]
    lines_are: str


@dataclass(frozen=True)
class _Layout:
    """Names of the columns, the first row of their cells, and what was left out before it."""

    names: list[str]
    first: int
    left_out: list[str]


def read_table_file(path: str | Path, sheet: str | None = None) -> TableFile:
    """A table of any columns.

    Parameters
    ----------
    path : str or Path
        Text in UTF-8, UTF-16 or Windows-1252, with any usual separator and decimal mark; Excel; Parquet.
    sheet : str, optional
        Of a workbook; the first one without it.

    Raises
    ------
    InputError
        If the file cannot be read, is no table, or has no such sheet.
    """
    raw, name = read_file(path, "table (CSV, Excel or Parquet)", MAX_BYTES), format_path(path)
    if not raw:
        raise InputError(InputIssue("is empty; name a table with a header and rows", name))
    if sheet is not None and not is_workbook(raw):
        raise InputError(InputIssue("is no Excel workbook, and has no sheets; leave the sheet out", name))
    kind = "Parquet file" if raw[:4] == b"PAR1" else "workbook" if is_workbook(raw) else "table"
    try:
        if kind == "Parquet file":
            frame, guessed = pd.read_parquet(io.BytesIO(raw)), list[str]()
            line_of, lines_are = (lambda row: row + 1), "row"
        elif kind == "workbook":
            frame, guessed, line_of, lines_are = _read_workbook(raw, sheet)
        else:
            frame, guessed, line_of = _read_text(raw, name)
            lines_are = "line"
    except InputError as error:
        raise InputError([replace(issue, file=issue.file or name) for issue in error.problems]) from None
    # pandas and pyarrow raise several kinds, all of them about the file.
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        advice = "" if kind == "table" else "; save it as CSV"
        raise InputError(InputIssue(f"is no {kind} that can be read ({reason}){advice}", name)) from None
    note = f"{Path(name).name} was read as follows: {'; '.join(guessed)}." if guessed else ""
    return TableFile(frame, note, hashlib.sha256(raw).hexdigest(), line_of, lines_are)


def _read_workbook(
    raw: bytes, sheet: str | None
) -> tuple[pd.DataFrame, list[str], Callable[[int], int], str]:
    with pd.ExcelFile(io.BytesIO(raw)) as workbook:
        names = [str(name) for name in workbook.sheet_names]
        if sheet is not None and sheet not in names:
            raise InputError(f"has no sheet {sheet!r}, but {_quote(names)}; name one of these")
        chosen = sheet or names[0]
        cells = pd.read_excel(workbook, sheet_name=chosen, header=None, dtype=object)
    others = [name for name in names if name != chosen]
    cells = cells.dropna(how="all")
    numbers, cells = cells.index.to_numpy() + 1, cells.reset_index(drop=True)
    shown = cells.head(SAMPLE).map(lambda cell: "" if pd.isna(cell) else str(cell))
    try:
        if cells.empty:
            raise InputError("is empty; name a table with a header and rows")
        layout = _find_layout([list(row) for row in shown.to_numpy()], [])
    except InputError as error:
        if not others:
            raise
        choice = f"or name {_quote(others)} as the sheet"
        raise InputError(f"sheet {chosen!r} {error.problems[0].message}, {choice}") from None
    body = cells.iloc[layout.first :].reset_index(drop=True)
    body = body.set_axis(layout.names, axis=1).infer_objects()
    read = [f"sheet {chosen!r}, and not {_quote(others)}"] if others and sheet is None else []
    return (
        *(_without_unnamed(body), [*read, *layout.left_out]),
        *(lambda row: int(numbers[layout.first + row]), f"sheet {chosen!r}, row"),
    )


def _quote(names: Sequence[str]) -> str:
    return join_words([repr(name) for name in names])


def _read_text(raw: bytes, file: str) -> tuple[pd.DataFrame, list[str], Callable[[int], int]]:
    if foreign := find_foreign(raw):
        raise InputError(InputIssue(foreign, file))
    issues = IssueCollector()
    text, notes = decode(raw, file, issues)
    issues.raise_if_any()
    assert text is not None
    guessed = ["its text is Windows-1252"] if any("Windows-1252" in note for note in notes) else []
    lines, comments = _split_lines(text.decode("utf-8", "replace"))
    if not lines:
        raise InputError("has comments only; name a table with a header and rows")
    named = _SEPARATOR_LINE.match(lines[0][1])
    lines = lines[1:] if named else lines
    separator = named[1] if named else _find_separator([line for _, line in lines[:SAMPLE]])
    if separator == " ":
        guessed.append("cells are separated by blank space")
    sample = list(_split(lines[:SAMPLE], separator))
    header = _split_one(comments[-1], separator) if comments else []
    layout = _find_layout([cells for _, cells in sample], header)
    guessed += layout.left_out
    begin = sample[layout.first][0] if layout.first < len(sample) else len(lines)
    records, cells = _read_cells(lines[begin:], separator, len(layout.names))
    columns = [column.combine_chunks() for column in cells.columns]

    def line_of(row: int) -> int:
        return lines[begin + records.scan.lines[row] - 1][0]

    decimals = find_decimals({} if separator == "," else dict(zip(layout.names, columns, strict=True)))
    decimals.check(file, line_of, lambda line, _: f"line {line}")
    read = [read_column(cells, decimal_comma=bool(decimals.comma)) for cells in columns]
    if thousands := [name for name, (_, marked) in zip(layout.names, read, strict=True) if marked]:
        guessed.append(f"numbers of {join_words(thousands)} have thousands separators")
    guessed += ["decimals have commas"] if decimals.comma else []
    frame = pd.concat([cells for cells, _ in read], axis=1).set_axis(layout.names, axis=1)
    return _without_unnamed(frame), guessed, line_of


def _without_unnamed(frame: pd.DataFrame) -> pd.DataFrame:
    """Without empty columns that have no name, as separators at the end of lines make them."""
    kept = [place for place, name in enumerate(frame) if name or frame.iloc[:, place].notna().any()]
    return frame.iloc[:, kept].set_axis(
        [str(frame.columns[place]) or f"column {place + 1}" for place in kept], axis=1
    )


def _split_lines(text: str) -> tuple[list[tuple[int, str]], list[str]]:
    """Lines with their numbers, from 1, without blank ones and comments; and the comments before them."""
    lines = [
        (number, line)
        for number, line in enumerate(re.split("\r\n|\r|\n", text), start=1)
        if line.strip() and line.strip(',;|"\t ')
    ]
    if 2 * sum(line.startswith(COMMENT) for _, line in lines[:SAMPLE]) > len(lines[:SAMPLE]):
        first = next((place for place, (_, line) in enumerate(lines) if line[0] != COMMENT), 0)
        if first < len(lines) // 2:  # names that begin so, in a first column
            return lines, []
    kept = [(number, line) for number, line in lines if not line.lstrip().startswith(COMMENT)]
    begin = kept[0][0] if kept else 0
    comments = [line.lstrip() for number, line in lines if number < begin]
    return kept, comments


def _split(lines: Sequence[tuple[int, str]], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Rows of cells without blank space around them, each with the place of its first line."""
    texts = [line for _, line in lines]
    if separator == " ":
        texts = [_BLANK.sub(" ", text.strip()) for text in texts]
    reader, place = csv.reader(texts, delimiter=separator, skipinitialspace=True), 0
    for cells in reader:
        yield place, [cell.strip() for cell in cells]
        place = reader.line_num


def _split_one(line: str, separator: str) -> list[str]:
    """A header that is a comment."""
    without = line.lstrip(COMMENT).strip()
    text = without if separator == " " or not without.startswith(separator) else line
    return next((cells for _, cells in _split([(0, text)], separator)), [])


def _find_separator(lines: list[str]) -> str:
    """What gives most lines equally many cells, of more than one.

    Of some that do so in nearly as many lines, such as blank space within times, the one whose columns have
    names.
    """
    counts: dict[str, int] = {}
    for separator in SEPARATORS:
        if not any(separator in line.strip() for line in lines):
            continue
        numbers = Counter(len(cells) for _, cells in _split(list(enumerate(lines)), separator))
        numbers.pop(1, None)
        counts[separator] = max(numbers.values(), default=0)
    most = max(counts.values(), default=0)
    if not most:
        return ","
    likely = [one for one, count in counts.items() if count >= LIKELY_SEPARATOR * most]
    return max(likely, key=lambda one: (_share_named(lines, one) if likely[1:] else 0.0, counts[one]))


def _share_named(lines: list[str], separator: str) -> float:
    """The share of columns that have a name, as a first one of row numbers need not; 0 without a header."""
    try:
        names = _find_layout([cells for _, cells in _split(list(enumerate(lines)), separator)], []).names
    except InputError:
        return 0.0
    return (len(_without_empty(names)) + (not names[0])) / len(names)


def _find_layout(rows: list[list[str]], commented: list[str]) -> _Layout:
    """Where the cells of a table begin, and the names of its columns; `commented` may be a header."""
    often, late = Counter(map(len, rows)), Counter(map(len, rows[len(rows) // 2 :]))
    width = max(often, key=lambda width: (often[width], late[width]))
    first = _find_first_row(rows, width)
    names = rows[first - 1] if first else []
    units, left_out = _ends_in_units(rows[:first], rows[first:], width), list[str]()
    if not units and not _is_header(names, rows[first:], width):
        if len(_trim(commented)) == width:
            names, before = commented, first
        else:
            raise InputError(
                "has no header: there are no names above its numbers; write the names of its columns there"
            )
    else:
        names = rows[first - 2] if units else names
        before = first - 2 if units else first - 1
    if before:
        left_out.append(f"{pluralize(before, 'line')} above the header left out")
    if units:
        pairs = zip(names, rows[first - 1], strict=False)
        named = ", ".join(f"{name} in {unit.strip('[]()')}" for name, unit in pairs if unit)
        left_out.append(f"the row of units below the header left out ({named})")
    return _Layout(_fit_names(names, rows[first:], width), first, left_out)


def _find_first_row(rows: list[list[str]], width: int) -> int:
    """The first row of cells: the first with numbers wherever most rows have them, below names.

    Where there is none, one with numbers in half of these places; the second row where there are no numbers.
    """
    numeric = _find_numeric([row for row in rows[len(rows) // 2 :] if len(row) == width], width)
    if not numeric:
        return next((place for place, row in enumerate(rows) if len(row) == width), 0) + 1
    like = [[_LIKE_NUMBER.fullmatch(row[k]) is not None for k in numeric if k < len(row)] for row in rows]
    full = (
        place
        for place, row in enumerate(rows)
        if any(like[place]) and all(one or not row[k] for one, k in zip(like[place], numeric, strict=False))
    )
    first = next(full, 0)
    if first and _is_header(rows[first - 1], rows[first:], width):
        return first
    half = (
        place for place, row in enumerate(rows) if len(row) >= width and 2 * sum(like[place]) >= len(numeric)
    )
    first = next(half, 0)
    # Names of a header may be numbers, such as years, but not all of them.
    return first + (first == 0 and not all(like[0]) and _is_header(rows[0], [], width, years=True))


def _find_numeric(body: list[list[str]], width: int) -> list[int]:
    """Columns of which most cells that are not empty look like numbers."""
    numeric = []
    for place in range(width):
        filled = [row[place] for row in body if row[place]]
        if filled and 2 * sum(_LIKE_NUMBER.fullmatch(cell) is not None for cell in filled) >= len(filled):
            numeric.append(place)
    return numeric


def _is_header(names: list[str], body: list[list[str]], width: int, years: bool = False) -> bool:
    """Whether a row has a name for most columns: those with cells, but for one."""
    named = [name for name in names if name and (years or not _LIKE_NUMBER.fullmatch(name))]
    filled = sum(any(row[place] for row in body if len(row) > place) for place in range(width))
    return len(named) == len(_without_empty(names)) and len(named) >= max(1, min(filled or width, width) - 1)


def _ends_in_units(above: list[list[str]], body: list[list[str]], width: int) -> bool:
    """Whether the lines above the numbers end in a header and a row of units, not of every column."""
    return len(above) > 1 and _are_units(above[-1]) and _is_header(above[-2], body, width)


def _without_empty(names: list[str]) -> list[str]:
    return [name for name in names if name]


def _are_units(cells: list[str]) -> bool:
    filled = _without_empty(cells)
    return bool(filled) and all(_UNIT.fullmatch(cell) for cell in filled)


def _trim(cells: list[str]) -> list[str]:
    """Without empty cells at the end."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _fit_names(names: list[str], body: list[list[str]], width: int) -> list[str]:
    """As many names as columns, "" for one without."""
    names = _trim(names)
    if len(names) > width:
        raise InputError(
            f"has {len(names)} names in its header, and {width} cells in most rows; "
            "give each column a name and each row as many cells"
        )
    numbered = len(names) == width - 1 > 1 and any(row[-1] for row in body if len(row) == width)
    return ["", *names] if numbered else names + [""] * (width - len(names))


def _read_cells(lines: list[tuple[int, str]], separator: str, width: int) -> tuple[CsvRecords, pa.Table]:
    """The cells of each column as text.

    Raises
    ------
    InputError
        For rows with more or fewer cells.
    """
    if not lines:
        raise InputError("has a header and no rows; add one row for each measurement")
    if separator == " ":
        lines = [(number, _BLANK.sub("\t", line.strip())) for number, line in lines]
        separator = "\t"
    body = "\n".join(line for _, line in lines).encode()
    records = CsvRecords(body, 0, 1, width, separator)
    cells, ragged = read_cells(records, [], max(len(body), 1 << 20))
    if ragged:
        raise InputError(
            InputIssue(
                explain_ragged(record, width, separator),
                line=lines[record.line - 1][0],
                value=shorten(record.raw.decode()),
            )
            for record in records.scan.ragged[:3]
        )
    return records, cells
