"""Good logs as text, to be changed cell by cell: one written down, and any number made up."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import strategies as st

from stickslip_fit.errors import InputError, InputIssue
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
def problems(read: Callable[[Sheet | str | bytes], Log]) -> Callable[[Sheet | str | bytes], list[InputIssue]]:
    """All that is said about a log that must be refused."""

    def finder(content: Sheet | str | bytes) -> list[InputIssue]:
        with pytest.raises(InputError) as refused:
            read(content)
        found = list(refused.value.problems)
        assert all(problem.file is not None and problem.file.endswith("day.csv") for problem in found)
        return found

    return finder


@dataclass
class Draft:
    """A log in people's units, as rows of column to text, and how it is put into a file."""

    rows: list[dict[str, str]]
    end: str = "\n"
    mark: bytes = b""
    blank: int = 0
    lines: list[int] = field(default_factory=list)

    def bytes(self) -> bytes:
        """The file; remembers the line where each row begins."""
        header = list(self.rows[0])
        text = self.end * self.blank + ",".join(header) + self.end
        self.lines = []
        for row in self.rows:
            self.lines.append(1 + count_ends(text))
            text += ",".join(map(quoted, row.values())) + self.end * (1 + self.blank)
        return self.mark + text.encode("utf-8")


def count_ends(text: str) -> int:
    return len(re.findall(r"\r\n|\r|\n", text))


def quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if re.search('[",\r\n]', cell) else cell


RANGES = {1: (-120, 120), 2: (-210, 30), 3: (0, 12)}


def grid(low: int, high: int):
    """Decimals with up to three places."""
    return st.integers(low * 1000, high * 1000).map(lambda thousandths: str(Decimal(thousandths) / 1000))


text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)


@st.composite
def good_drafts(draw) -> Draft:
    """Good logs of one to five traverses."""
    rows = []
    times = draw(st.lists(st.integers(0, 10**6), min_size=1, max_size=5, unique=True))
    for seconds in times:
        joint = draw(st.sampled_from([1, 2, 3]))
        every = draw(st.sampled_from(["", "1", "5", "8"]))
        direction = draw(st.sampled_from("+-"))
        row = {
            "session": draw(st.sampled_from(["a", "NA", "001"])),
            "time": (datetime(2012, 3, 5) + timedelta(seconds=seconds)).isoformat(),
            "joint": str(joint),
            "direction": direction,
            "steps": str(draw(st.integers(1, 5000)) * int(every or 5)),
        }
        for other in (1, 2, 3):
            cell = draw(grid(*RANGES[other])) if other != joint else ""
            row["q3_mm" if other == 3 else f"q{other}_deg"] = cell
        row |= {"theta_deg": draw(grid(-90, 90)), "psi_deg": draw(grid(-90, 90))}
        low, high = RANGES[joint]
        first = draw(st.sampled_from(["", str(low + 1)]))
        last = draw(st.sampled_from(["", str(high - 1)]))
        if direction == "-":
            first, last = last, first
        subset = "mm" if joint == 3 else "deg"
        row |= {f"{end}_{unit}": "" for unit in ("deg", "mm") for end in ("from", "to")}
        row |= {f"from_{subset}": first, f"to_{subset}": last, "check_every": every}
        row |= {
            "status": draw(st.sampled_from(["", "ok", "interrupted", "excluded"])),
            "temperature_C": draw(st.just("") | grid(-40, 60)),
            "step_period_ms": draw(st.just("") | grid(1, 50)),
            "payload_g": draw(st.just("") | grid(0, 5)),
            "pressure_hPa": draw(st.just("") | grid(900, 1100)),
            "note": draw(text),
        }
        rows.append(row)
    order = draw(st.permutations(list(rows[0])))
    return Draft(
        [{name: row[name] for name in order} for row in rows],
        end=draw(st.sampled_from(["\n", "\r\n", "\r"])),
        mark=draw(st.sampled_from([b"", b"\xef\xbb\xbf"])),
        blank=draw(st.integers(0, 1)),
    )


@pytest.fixture(scope="module")
def drafts() -> st.SearchStrategy[Draft]:
    """Good logs of one to five traverses, to draw from."""
    return good_drafts()
