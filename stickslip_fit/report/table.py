"""A table as the page holds it: text only, ready to be escaped."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby


@dataclass(frozen=True)
class Column:
    """A column's head.

    Attributes
    ----------
    head : str
    unit : str
        Stands below the head; empty where cells have none or carry their own.
    group : str
        Columns next to each other with the same group share a head above theirs.
    text : bool
        Whether cells are words (to the left) or numbers (to the right).
    """

    head: str
    unit: str = ""
    group: str = ""
    text: bool = False


@dataclass(frozen=True)
class Table:
    """A captioned table.

    Attributes
    ----------
    caption : str
    columns : tuple of Column
    rows : tuple of tuple of str
    stubs : int
        How many leading cells of a row name it.
    note : str
        Stands below: what a mark in a cell means, what was left out.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    stubs: int = 1
    note: str = ""

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Upper heads with how many columns each spans; empty where no column has one."""
        spans = [(group, len(list(columns))) for group, columns in groupby(self.columns, lambda c: c.group)]
        return spans if any(group for group, _ in spans) else []
