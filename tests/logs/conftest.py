"""A small log as its columns of text, to be changed cell by cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs import Log, read_log

GOOD = """\
session,time,joint,direction,steps,q1_deg,q2_deg,q3_mm,theta_deg,psi_deg,from_deg,to_deg,from_mm,to_mm,check_every,status,temperature_C,step_period_ms,pressure_hPa,note
monday,2012-03-05T09:00:00,3,+,12540,0,-90,,0,0,,,,,,,21.5,10,990.25,first
monday,2012-03-05T09:05:00,3,-,13205,0,-90,,0,0,,,12,0,5,ok,21.75,10,990.5,
monday,2012-03-05T09:10:00,2,-,9871,10,,6,-30,45,0,-60,,,1,ok,22,10,991,
monday,2012-03-05T09:20:00,1,+,18000,,-90,0,90,0,,,,,4,interrupted,22.25,12.5,991,hit the table
tuesday,2012-03-06T08:00:00,2,+,9900,0,,12,0,0,-60,0,,,,excluded,,10,992,
tuesday,2012-03-06T08:10:00,3,+,6270,0,-90,,0,0,,,0,6,5,,20,10,,last
"""


@dataclass
class Sheet:
    """A header and rows of text; rows count from 0, lines of the file from 1."""

    header: list[str]
    rows: list[list[str]]

    def set(self, row: int, column: str, value: str) -> int:
        """Put a value in a cell and say in which line of the file it stands."""
        self.rows[row][self.header.index(column)] = value
        return row + 2

    def get(self, row: int, column: str) -> str:
        return self.rows[row][self.header.index(column)]

    def rename(self, column: str, name: str) -> None:
        self.header[self.header.index(column)] = name

    def drop(self, column: str) -> None:
        place = self.header.index(column)
        for cells in (self.header, *self.rows):
            del cells[place]

    def add(self, column: str, values: list[str]) -> None:
        self.header.append(column)
        for cells, value in zip(self.rows, values, strict=True):
            cells.append(value)

    def text(self) -> str:
        return "".join(",".join(cells) + "\n" for cells in (self.header, *self.rows))


@pytest.fixture
def sheet() -> Sheet:
    """Six good traverses of all joints in two sessions, with every kind of optional column."""
    header, *rows = (line.split(",") for line in GOOD.splitlines())
    return Sheet(header, rows)


@pytest.fixture
def read(tmp_path: Path) -> Callable[[Sheet | str | bytes], Log]:
    """Read a log from memory, through a file named day.csv."""

    def reader(content: Sheet | str | bytes) -> Log:
        text = content.text() if isinstance(content, Sheet) else content
        path = tmp_path / "day.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
        return read_log(path)

    return reader


@pytest.fixture
def problems(read: Callable[[Sheet | str | bytes], Log]) -> Callable[[Sheet | str | bytes], list[Problem]]:
    """All that is said about a log that must be refused."""

    def finder(content: Sheet | str | bytes) -> list[Problem]:
        with pytest.raises(InputError) as refused:
            read(content)
        found = list(refused.value.problems)
        assert all(problem.file is not None and problem.file.endswith("day.csv") for problem in found)
        return found

    return finder
