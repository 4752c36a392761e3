"""A file as columns of cells, before anybody has said what they mean."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa

Rows = npt.NDArray[np.int64]


class Table(Protocol):
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
    def file(self) -> str: ...  # noqa: D102
    @property
    def names(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def header_line(self) -> int | None: ...  # noqa: D102
    @property
    def count(self) -> int: ...  # noqa: D102

    def column(self, name: str) -> pa.Array:
        """Cells of a column: strings, numbers or timestamps; null where empty."""

    def text(self, name: str) -> pa.Array:
        """Cells of a column as they stand in the file; empty for null."""

    def lines(self, rows: Rows) -> Rows:
        """Lines of the file (Parquet: rows, counted from 1) of a few rows, counted from 0."""

    def place(self, row: int) -> str:
        """Where one row stands, in words."""

    def take(self, rows: Rows) -> Table:
        """Only these rows, which ascend."""


def one_array(column: pa.ChunkedArray) -> pa.Array:
    """A column in one piece."""
    pieces: Any = column.combine_chunks()
    return pa.concat_arrays(pieces.chunks) if isinstance(pieces, pa.ChunkedArray) else pieces
