"""The columns of one file as arrays in SI, with complaints about cells that hold no such thing."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from stickslip_fit.logs.columns import Layout
from stickslip_fit.logs.faults import Faults, Message
from stickslip_fit.logs.parse import (
    Bools,
    Floats,
    Ints,
    Times,
    filled,
    parse_choices,
    parse_numbers,
    parse_times,
)
from stickslip_fit.logs.table import Table
from stickslip_fit.units import to_si

# More than a drive steps in thirty years; sums over any log stay within 64 bits.
MOST_STEPS = 10**12


@dataclass(frozen=True)
class Cells:
    """One file's columns, by the format's names.

    A cell that is empty though needed, or no number where one belongs, is told to `faults` and comes
    back as NaN (counts: 0, choices: -1), so that what depends on it can be left unchecked. A column
    that is missing comes back as if all its cells were empty, without complaint: the header was told.
    """

    table: Table
    layout: Layout
    faults: Faults

    def has(self, field: str) -> bool:
        """Say whether the file has a column for this quantity."""
        return field in self.layout.known

    def filled(self, field: str) -> Bools:
        """Say where the quantity's cell is not empty."""
        if not self.has(field):
            return self._nowhere()
        return filled(self._column(field))

    def complain(self, field: str, wrong: Bools, message: Message) -> None:
        """Tell of cells of a quantity, unless the file lacks its column."""
        if self.has(field):
            self.faults.cells(self.table, wrong, self.layout.known[field].name, message)

    def numbers(self, field: str, *, needed: Bools | bool = False, ignored: Bools | bool = False) -> Floats:
        """Read finite numbers in SI, NaN where empty or ignored."""
        if not self.has(field):
            return np.full(self.table.count, np.nan)
        written = parse_numbers(self._column(field))
        with np.errstate(over="ignore"):
            values = to_si(written.values, self.layout.known[field].unit)
        usable = np.isfinite(values) & np.logical_not(ignored)
        missed = ~(usable | ignored)
        self.complain(field, missed & ~written.empty, _no_number)
        self.complain(field, missed & written.empty & needed, "is empty; write the number")
        np.copyto(values, np.nan, where=~usable)
        return values

    def counts(self, field: str, message: str, *, most: int = MOST_STEPS, needed: bool = False) -> Ints:
        """Read integers from 1 to `most`, 0 where empty or bad."""
        if not self.has(field):
            return np.zeros(self.table.count, np.int64)
        found = parse_numbers(self._column(field))
        fits = (found.values >= 1) & (found.values <= most) & (found.values == np.floor(found.values))
        self.complain(field, ~fits if needed else ~(fits | found.empty), message)
        return np.where(fits, found.values, 0.0).astype(np.int64)

    def choices(self, field: str, choices: tuple[str, ...], message: Message) -> npt.NDArray[np.int8]:
        """Find the place of each cell's text among `choices`, -1 where it is none of them."""
        if not self.has(field):
            return np.full(self.table.count, -1, np.int8)
        found = parse_choices(self._column(field), choices)
        self.complain(field, found < 0, message)
        return found

    def times(self, field: str) -> Times:
        """Read times, 0 where empty or bad."""
        if not self.has(field):
            zeros = np.zeros(self.table.count, np.int64)
            return Times(zeros, self._nowhere(), ~self._nowhere(), self._nowhere())
        found = parse_times(self._column(field))
        self.complain(field, found.empty, "is empty; write when the traverse began")
        self.complain(field, found.bad, "is no date with a time of day; write it like 2012-03-05T09:41:10")
        return found

    def texts(self, field: str) -> pa.Array:
        """Read cells as text, literally; empty where the column is missing."""
        if not self.has(field):
            return pa.repeat(pa.scalar("", pa.large_string()), self.table.count)
        return self.table.text(self.layout.known[field].name)

    def _column(self, field: str) -> pa.Array:
        return self.table.column(self.layout.known[field].name)

    def _nowhere(self) -> Bools:
        return np.zeros(self.table.count, np.bool_)


def by_file(files: list[Cells], rows: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Cut an array over the rows of all files into one for each."""
    return np.split(rows, np.cumsum([cells.table.count for cells in files])[:-1])


def place_of(files: list[Cells], row: int) -> str:
    """Say where a row of all files stands."""
    counts = [cells.table.count for cells in files]
    which = int(np.searchsorted(np.cumsum(counts), row, side="right"))
    return files[which].table.place(row - sum(counts[:which]))


def _no_number(row: int, value: str) -> str:
    text = value.strip()
    if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", text):
        return f"is no number; write a decimal point, not a comma: {text.replace(',', '.')}"
    if text.startswith("\N{MINUS SIGN}"):
        return f"is no number; write a plain minus sign: -{text[1:]}"
    if re.fullmatch(r"[+-]?(nan|inf|infinity|[0-9.]+e[+-]?[0-9]+)", text, re.IGNORECASE):
        return "is no finite number; write the number, or leave the cell empty where it may be"
    return "is no number; write digits and a decimal point, such as 12.5"
