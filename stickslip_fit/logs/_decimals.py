"""Decimal commas: whether numbers in text have them, and numbers with points in their place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stickslip_fit.logs._table import FileTable, IssueCollector

_WITH_COMMA = r"^[ \t]*[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?[ \t]*$"
_WITH_POINT = r"^[ \t]*[+-]?[0-9]*\.[0-9]+([eE][+-]?[0-9]+)?[ \t]*$"


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

    def report_both(self, table: FileTable, issues: IssueCollector) -> None:
        """Add an issue that names one of each kind."""
        assert self.comma is not None
        assert self.point is not None
        comma, point = table.lines(np.array([self.comma.row, self.point.row])).tolist()
        message = (
            f"has a decimal point, and {self.comma.text!r} in "
            f"{table.describe_place(comma, self.comma.column)}, column {self.comma.column}, a decimal "
            "comma; write all numbers in one way, thousands without a mark"
        )
        issues.add(table.file, message, point, self.point.column, self.point.text)


def find_decimals(columns: Mapping[str, pa.Array]) -> Decimals:
    """How the numbers in columns of text have their decimals.

    Examples
    --------
    >>> find_decimals({"q1_deg": pa.array(["3", "", "-1,5"], pa.large_string())})
    Decimals(comma=FirstNumber(row=2, column='q1_deg', text='-1,5'), point=None)
    """
    texts = {name: cells for name, cells in columns.items() if pa.types.is_large_string(cells.type)}
    return Decimals(_find_first(texts, _WITH_COMMA), _find_first(texts, _WITH_POINT))


def with_points(cells: pa.Array) -> pa.Array:
    """Cells in which numbers with a decimal comma have a point; other text stays as it is."""
    if not pa.types.is_large_string(cells.type):
        return cells
    return pc.if_else(
        pc.match_substring_regex(cells, _WITH_COMMA), pc.replace_substring(cells, ",", "."), cells
    )


def _find_first(columns: Mapping[str, pa.Array], pattern: str) -> FirstNumber | None:
    found = []
    for name, cells in columns.items():
        row = pc.index(pc.match_substring_regex(cells, pattern), True).as_py()
        if row >= 0:
            found.append(FirstNumber(row, name, cells[row].as_py()))
    return min(found, key=lambda first: first.row, default=None)
