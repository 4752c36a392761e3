r"""Where the records of a CSV file begin and end: what a fast parser doesn't tell.

A cell may be quoted and then holds commas, line ends and doubled quotation marks. A quotation mark
anywhere but at a cell's beginning is an ordinary character. Lines end in \n, \r\n or \r.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

_CELL = rb'(?>"(?:[^"]++|"")*+(?:"|\Z)[^,\r\n]*+|[^,"\r\n][^,\r\n]*+|)'
_END = rb"(?:\r\n|\r|\n|\Z)"
_RECORD = re.compile(_CELL + rb"(?:," + _CELL + rb")*+" + _END)
_ONE_CELL = re.compile(_CELL)
_UNCLOSED = re.compile(rb'"(?:[^"]++|"")*+\Z')


@dataclass(frozen=True)
class Ragged:
    """A record with too many or too few cells."""

    line: int
    cells: int
    text: str


@dataclass(frozen=True)
class Records:
    r"""The records of `raw` from byte `start` on, which stands in line `first_line`.

    Examples
    --------
    >>> records = Records(b'1,"two\nlines"\n3\n4,5\n', start=0, first_line=1, width=2)
    >>> records.lines, records.ragged
    (array([1, 4]), [Ragged(line=3, cells=1, text='3')])
    """

    raw: bytes
    start: int
    first_line: int
    width: int

    @cached_property
    def quoted(self) -> bool:
        """Whether there is any quotation mark."""
        return b'"' in self.raw

    @property
    def lines(self) -> npt.NDArray[np.int64]:
        """Line where each record of the right width begins; empty lines are no records."""
        return self._scan[0]

    @property
    def ragged(self) -> list[Ragged]:
        """Records of another width."""
        return self._scan[1]

    @property
    def unclosed(self) -> int | None:
        """Line of the record whose quotation mark is never closed."""
        return self._scan[2]

    @cached_property
    def _scan(self) -> tuple[npt.NDArray[np.int64], list[Ragged], int | None]:
        fits = re.compile(_CELL + rb"(?:," + _CELL + rb"){%d}" % (self.width - 1) + _END)
        lines: list[int] = []
        ragged: list[Ragged] = []
        unclosed = None
        position, line = self.start, self.first_line
        while position < len(self.raw):
            whole = fits.match(self.raw, position)
            end = (whole or next_record(self.raw, position)).end()
            record = self.raw[position:end]
            text = record.rstrip(b"\r\n")
            if whole and text:
                lines.append(line)
            elif text:
                ragged.append(Ragged(line, len(split_cells(text)), text.decode("utf-8", "replace")))
            if end == len(self.raw) and any(_UNCLOSED.fullmatch(cell) for cell in split_cells(record)):
                unclosed = line
            position, line = end, line + count_lines(record)
        return np.array(lines, dtype=np.int64), ragged, unclosed


def next_record(raw: bytes, position: int) -> re.Match[bytes]:
    """The record that begins at `position`, its line end included."""
    found = _RECORD.match(raw, position)
    assert found is not None, "the pattern matches anything, be it nothing"
    return found


def split_cells(record: bytes) -> list[bytes]:
    """Cells of one record, quotation marks and all.

    Examples
    --------
    >>> split_cells(b'3,"a,b",')
    [b'3', b'"a,b"', b'']
    """
    cells, position = [], -1
    while position < 0 or record[position : position + 1] == b",":
        cell = _ONE_CELL.match(record, position + 1)
        assert cell is not None, "the pattern matches anything, be it nothing"
        cells.append(cell[0])
        position = cell.end()
    return cells


def count_lines(raw: bytes) -> int:
    """Number of line ends."""
    return raw.count(b"\n") + raw.count(b"\r") - raw.count(b"\r\n")


def unquote(cell: bytes) -> str:
    """What a cell says."""
    text = cell.decode("utf-8", "replace")
    if not text.startswith('"'):
        return text
    quoted, _, rest = text[1:].replace('""', "\0").partition('"')
    return quoted.replace("\0", '"') + rest.replace("\0", '""')
