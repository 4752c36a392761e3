"""Columns of text as numbers: empty cells, decimal commas, thousands separators.

A comma between three digits may be either mark. It is taken as a thousands separator only where a number of
the same column has both marks, or two thousands separators.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from stickslip_fit.errors import InputError, InputIssue

# In lower case; among texts "none" may be one of them, such as the treatment of a control group.
_NO_VALUE = ("", "na", "n/a", "#n/a", "nan", "<na>", "null", "nat")
_NO_NUMBER = (*_NO_VALUE, "none", "-", "--", "---", "?", "..", "...")  # the same in a column of numbers
_TRUTH = ("true", "false")
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eEdD][+-]?[0-9]+)?$|^[+-]?(inf|Inf|INF)$"
_INTEGER = r"^[+-]?[0-9]{1,18}$"
_DECIMAL_COMMA = r"^[+-]?[0-9]*,[0-9]+([eEdD][+-]?[0-9]+)?$"
_DECIMAL_POINT = r"^[+-]?[0-9]*\.[0-9]+([eEdD][+-]?[0-9]+)?$"
DescribePlace = Callable[[int, str], str]
"""A line, counted from 1, and a column to where that is, in words."""

_CLEAR_MARKS = "'’\u00a0\u202f\u2009 "  # thousands separators that are no decimal mark


def _grouped(mark: str, decimal: str) -> str:
    return rf"^[+-]?[0-9]{{1,3}}([{mark}][0-9]{{3}})+([{decimal}][0-9]*)?$"


def _surely_grouped(mark: str, decimal: str) -> str:
    first = r"^[+-]?[0-9]{1,3}"
    return rf"{first}([{mark}][0-9]{{3}})+[{decimal}][0-9]*$|{first}([{mark}][0-9]{{3}}){{2,}}$"


@dataclass(frozen=True)
class FirstNumber:
    """The first number of a kind: its row, counted from 0, column and text."""

    row: int
    column: str
    text: str


@dataclass(frozen=True)
class Decimals:
    """The first number with a decimal comma and the first with a point; None where there is none."""

    comma: FirstNumber | None
    point: FirstNumber | None

    def check(self, file: str, line_of: Callable[[int], int], describe_place: DescribePlace) -> None:
        """Raise InputError where there is one of each kind."""
        if self.comma is None or self.point is None:
            return
        place = describe_place(line_of(self.comma.row), self.comma.column)
        message = (
            f"has a decimal point, and {self.comma.text!r} in {place}, column {self.comma.column}, a decimal "
            "comma; write all numbers in one way, thousands without a mark"
        )
        line = line_of(self.point.row)
        raise InputError(InputIssue(message, file, line, self.point.column, self.point.text))


def find_decimals(columns: Mapping[str, pa.Array]) -> Decimals:
    """How the numbers in columns of text have their decimals.

    Examples
    --------
    >>> find_decimals({"q1_deg": pa.array(["3", "", "-1,5"], pa.large_string())})
    Decimals(comma=FirstNumber(row=2, column='q1_deg', text='-1,5'), point=None)
    >>> find_decimals({"F": pa.array(["1.234,5", "1.250"], pa.large_string())}).point
    """
    comma, point = list[FirstNumber](), list[FirstNumber]()
    for name, cells in columns.items():
        if not pa.types.is_large_string(cells.type):
            continue
        cells = pc.utf8_trim_whitespace(cells)
        grouped = _find_first(name, cells, _surely_grouped(".", ","))
        comma += _find_first(name, cells, _DECIMAL_COMMA) or [one for one in grouped if "," in one.text]
        point += [] if grouped else _find_first(name, cells, _DECIMAL_POINT)
    first = (min(found, key=lambda one: one.row, default=None) for found in (comma, point))
    return Decimals(*first)


def _find_first(name: str, cells: pa.Array, pattern: str) -> list[FirstNumber]:
    row = pc.index(pc.match_substring_regex(cells, pattern), True).as_py()
    return [] if row < 0 else [FirstNumber(row, name, cells[row].as_py())]


def with_points(cells: pa.Array) -> pa.Array:
    """Cells in which numbers with a decimal comma have a point; other text stays as it is."""
    if not pa.types.is_large_string(cells.type):
        return cells
    has_comma = pc.match_substring_regex(pc.utf8_trim_whitespace(cells), _DECIMAL_COMMA)
    return pc.if_else(has_comma, pc.replace_substring(cells, ",", "."), cells)


def read_column(cells: pa.Array, decimal_comma: bool = False) -> tuple[pd.Series[Any], bool]:
    """A column of text as numbers or truth values where all its cells are, and whether thousands had a mark.

    What stands for an empty cell is empty. Where most cells have a decimal comma, these have a point, so that
    what is no number is the others.

    Examples
    --------
    >>> read_column(pa.array(["1,250.5", "-", "3"], pa.large_string()))[0].tolist()
    [1250.5, nan, 3.0]
    """
    text = pc.utf8_trim_whitespace(cells)
    lower = pc.utf8_lower(text)
    number = pc.if_else(_is_one_of(lower, _NO_NUMBER), pa.scalar(None, pa.large_string()), text)
    for kind in (pa.int64(), pa.float64()):
        with suppress(pa.ArrowInvalid):  # as most columns are, at a tenth of the time
            return pd.Series(number.cast(kind).to_numpy(zero_copy_only=False)), False
    points, grouped = _without_marks(number, decimal_comma)
    if points is not None:
        kind = pa.int64() if _all_match(points, _INTEGER) else pa.float64()
        plain = pc.replace_substring_regex(points, r"^\+", "")
        plain = pc.replace_substring_regex(plain, "[dD]", "e")
        return pd.Series(plain.cast(kind).to_numpy(zero_copy_only=False)), grouped
    text = pc.if_else(_is_one_of(lower, _NO_VALUE), pa.scalar(None, pa.large_string()), text)
    if not text.null_count and pc.all(_is_one_of(lower, _TRUTH)).as_py():
        return pd.Series(pc.equal(lower, "true").to_numpy(zero_copy_only=False)), False
    has_comma = pc.match_substring_regex(text, _DECIMAL_COMMA)
    if decimal_comma and (pc.sum(has_comma).as_py() or 0) > (len(text) - text.null_count) / 2:
        text = with_points(text)
    return pd.Series(text.to_pandas()), False


def _without_marks(cells: pa.Array, decimal_comma: bool) -> tuple[pa.Array | None, bool]:
    """Numbers with decimal points and no thousands separators, None where a cell is no number."""
    mark, decimal = (".", ",") if decimal_comma else (",", ".")
    clear = pc.match_substring_regex(cells, _grouped(_CLEAR_MARKS, decimal))
    marked = pc.match_substring_regex(cells, _grouped(mark, decimal))
    if not _find_first("", cells, _surely_grouped(mark, decimal)):
        marked = pc.and_(marked, False)
    either = pc.fill_null(pc.or_(clear, marked), False)
    cells = pc.if_else(either, pc.replace_substring_regex(cells, f"[{mark}{_CLEAR_MARKS}]", ""), cells)
    if decimal_comma:
        cells = with_points(pc.if_else(either, pc.replace_substring(cells, ",", "."), cells))
    return (cells if _all_match(cells, _NUMBER) else None), bool(pc.any(either).as_py())


def _is_one_of(cells: pa.Array, values: tuple[str, ...]) -> pa.Array:
    return pc.fill_null(pc.is_in(cells, pa.array(values, cells.type)), True)


def _all_match(cells: pa.Array, pattern: str) -> bool:
    return bool(pc.all(pc.match_substring_regex(cells, pattern)).as_py() is not False)


def is_empty_number(cell: object) -> bool:
    """Whether a cell of a column of numbers is empty, in whatever words.

    Examples
    --------
    >>> [is_empty_number(cell) for cell in ("NA", " - ", None, float("nan"), "over", 0.0)]
    [True, True, True, True, False, False]
    """
    if isinstance(cell, str):
        return cell.strip().lower() in _NO_NUMBER
    return bool(pd.isna(cell)) if pd.api.types.is_scalar(cell) else False


def with_numbers(frame: pd.DataFrame, needed: Collection[str] = ()) -> pd.DataFrame:
    """A table in which columns of numbers and texts are numbers, where all texts are numbers or empty.

    A column of texts alone stays as it is, since its owner may have made it so, unless it is `needed`.
    """
    columns: dict[Any, pd.Series[Any]] = {}
    for name, cells in frame.items():
        if not (cells.dtype == object or isinstance(cells.dtype, pd.StringDtype)):
            continue
        values = cells.tolist()
        if name not in needed and not any(map(_is_number, values)):
            continue
        if all(isinstance(cell, str) or is_empty_number(cell) or _is_number(cell) for cell in values):
            texts = [None if is_empty_number(cell) else str(cell) for cell in values]
            read = read_column(pa.array(texts, pa.large_string()))[0]
            if read.dtype.kind in "if":
                columns[name] = read.set_axis(frame.index)
    return frame.assign(**columns) if columns else frame


def _is_number(cell: object) -> bool:
    return isinstance(cell, Real) and not isinstance(cell, bool) and not pd.isna(cell)
