"""Columns of text as numbers: empty cells, decimal commas, thousands separators.

A comma between three digits may be either mark. It is taken as a thousands separator only where a number of
the same column has both marks, or two thousands separators.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from numbers import Real
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

_NO_VALUE = ("", "na", "n/a", "#n/a", "nan", "<na>", "null", "none", "nat")  # in lower case, in any column
_NO_NUMBER = (*_NO_VALUE, "-", "--", "---", "?", "..", "...")  # the same in a column of numbers
_TRUTH = ("true", "false")
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eEdD][+-]?[0-9]+)?$|^[+-]?(inf|Inf|INF)$"
_INTEGER = r"^[+-]?[0-9]{1,18}$"
_DECIMAL_COMMA = r"^[+-]?[0-9]*,[0-9]+([eEdD][+-]?[0-9]+)?$"
_DECIMAL_POINT = r"^[+-]?[0-9]*\.[0-9]+([eEdD][+-]?[0-9]+)?$"
_CLEAR_MARKS = "'’\u00a0\u202f\u2009 "  # thousands separators that are no decimal mark


def _grouped(mark: str, decimal: str) -> str:
    return rf"^[+-]?[0-9]{{1,3}}([{mark}][0-9]{{3}})+([{decimal}][0-9]*)?$"


def _surely_grouped(mark: str, decimal: str) -> str:
    first = r"^[+-]?[0-9]{1,3}"
    return rf"{first}([{mark}][0-9]{{3}})+[{decimal}][0-9]*$|{first}([{mark}][0-9]{{3}}){{2,}}$"


def find_decimal_marks(columns: list[pa.Array]) -> tuple[str, str]:
    """The first number with a decimal comma and the first with a decimal point; "" where there is none.

    Examples
    --------
    >>> find_decimal_marks([pa.array(["3", "", "-1,5"], pa.large_string())])
    ('-1,5', '')
    >>> find_decimal_marks([pa.array(["1.234,5", "1.250"], pa.large_string())])
    ('1.234,5', '')
    """
    comma = point = ""
    for cells in columns:
        cells = pc.utf8_trim_whitespace(cells)
        grouped = _first(cells, _surely_grouped(".", ","))
        comma = comma or _first(cells, _DECIMAL_COMMA) or (grouped if "," in grouped else "")
        point = point or ("" if grouped else _first(cells, _DECIMAL_POINT))
    return comma, point


def _first(cells: pa.Array, pattern: str) -> str:
    place = pc.index(pc.match_substring_regex(cells, pattern), True).as_py()
    return "" if place < 0 else str(cells[place].as_py())


def read_column(cells: pa.Array, decimal_comma: bool = False) -> tuple[pd.Series[Any], bool]:
    """A column of text as numbers or truth values where all its cells are, and whether thousands had a mark.

    What stands for an empty cell is empty.

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
    points, grouped = _with_points(number, decimal_comma)
    if points is not None:
        kind = pa.int64() if _all_match(points, _INTEGER) else pa.float64()
        plain = pc.replace_substring_regex(points, r"^\+", "")
        plain = pc.replace_substring_regex(plain, "[dD]", "e")
        return pd.Series(plain.cast(kind).to_numpy(zero_copy_only=False)), grouped
    text = pc.if_else(_is_one_of(lower, _NO_VALUE), pa.scalar(None, pa.large_string()), text)
    if not text.null_count and pc.all(_is_one_of(lower, _TRUTH)).as_py():
        return pd.Series(pc.equal(lower, "true").to_numpy(zero_copy_only=False)), False
    return pd.Series(text.to_pandas()), False


def _with_points(cells: pa.Array, decimal_comma: bool) -> tuple[pa.Array | None, bool]:
    """Numbers with decimal points and no thousands separators, None where a cell is no number."""
    mark, decimal = (".", ",") if decimal_comma else (",", ".")
    clear = pc.match_substring_regex(cells, _grouped(_CLEAR_MARKS, decimal))
    marked = pc.match_substring_regex(cells, _grouped(mark, decimal))
    if not _first(cells, _surely_grouped(mark, decimal)):
        marked = pc.and_(marked, False)
    either = pc.fill_null(pc.or_(clear, marked), False)
    cells = pc.if_else(either, pc.replace_substring_regex(cells, f"[{mark}{_CLEAR_MARKS}]", ""), cells)
    if decimal_comma:
        has_comma = pc.match_substring_regex(cells, _DECIMAL_COMMA)
        cells = pc.if_else(pc.or_(has_comma, either), pc.replace_substring(cells, ",", "."), cells)
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
