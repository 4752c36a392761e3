"""Anything may come in: out come a true Log or an InputError that names each fault, and nothing else."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from decimal import Decimal

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from stickslip_fit.logs.parse import parse_numbers, parse_times
from stickslip_fit.logs.records import Records
from stickslip_fit.units import SUFFIXES, to_si

quick = settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
thorough = settings(quick, max_examples=150)

RANGES = {1: (-120, 120), 2: (-210, 30), 3: (0, 12)}
UNITS = {
    "q1": ("deg", "rad"),
    "q2": ("deg", "rad"),
    "q3": ("mm", "m", "um", "nm"),
    "theta": ("deg", "rad"),
    "psi": ("deg", "rad"),
    "temperature": ("C", "K"),
    "step_period": ("ms", "s"),
    "payload": ("g", "kg"),
}
INSIDE = {"deg": "rad", "mm": "m", "C": "K", "ms": "s", "g": "kg"}
# What each unit is in the first one of its quantity, in exact decimals; rad and C are not multiples.
TIMES = {"m": "0.001", "um": "1000", "nm": "1000000", "s": "0.001", "kg": "0.001"}


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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


def read(folder, raw: bytes, name: str = "day.csv"):
    path = folder / name
    path.write_bytes(raw)
    return read_log(path)


def grid(low: int, high: int):
    """Decimals with up to three places."""
    return st.integers(low * 1000, high * 1000).map(lambda thousandths: str(Decimal(thousandths) / 1000))


text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)


@st.composite
def drafts(draw) -> Draft:
    """Good logs of one to eight traverses."""
    rows = []
    times = draw(st.lists(st.integers(0, 10**6), min_size=1, max_size=8, unique=True))
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
        mine = "mm" if joint == 3 else "deg"
        row |= {f"{end}_{unit}": "" for unit in ("deg", "mm") for end in ("from", "to")}
        row |= {f"from_{mine}": first, f"to_{mine}": last, "check_every": every}
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


@given(drafts())
@quick
def test_a_good_log_comes_out_as_it_was_written(folder, draft):
    rows = read(folder, draft.bytes()).rows
    expected = sorted(draft.rows, key=lambda row: (row["time"], row["joint"]))
    assert [str(steps) for steps in rows["steps"]] == [row["steps"] for row in expected]
    assert list(rows["session"]) == [row["session"] for row in expected]
    assert list(rows["note"]) == [row["note"] for row in expected]
    assert list(rows["status"]) == [row["status"] or "ok" for row in expected]
    for quantity, (unit, *_) in UNITS.items():
        cells = [row[f"{quantity}_{unit}"] for row in expected]
        values = [to_si(float(cell), SUFFIXES[unit]) if cell else math.nan for cell in cells]
        np.testing.assert_allclose(rows[quantity], values, rtol=1e-15)


@given(drafts(), st.randoms())
@quick
def test_the_order_of_rows_means_nothing(folder, draft, random):
    expected = read(folder, draft.bytes()).rows
    random.shuffle(draft.rows)
    pd.testing.assert_frame_equal(read(folder, draft.bytes()).rows, expected)


@given(drafts(), st.data())
@quick
def test_units_are_only_a_way_of_writing(folder, draft, data):
    expected = read(folder, draft.bytes()).rows
    for quantity, (usual, *others) in UNITS.items():
        unit = data.draw(st.sampled_from([usual, *others]))
        for place, row in enumerate(draft.rows):
            draft.rows[place] = {
                name.replace(f"{quantity}_{usual}", f"{quantity}_{unit}"): (
                    in_unit(cell, usual, unit) if name == f"{quantity}_{usual}" else cell
                )
                for name, cell in row.items()
            }
    rows = read(folder, draft.bytes()).rows
    pd.testing.assert_frame_equal(rows, expected, rtol=1e-12, atol=1e-12)


def in_unit(cell: str, usual: str, unit: str) -> str:
    """The same quantity in another unit, worked out apart from the program's own conversion."""
    if not cell or unit == usual:
        return cell
    if unit == "K":
        return str(Decimal(cell) + Decimal("273.15"))
    if unit == "rad":
        return repr(math.radians(float(cell)))
    return f"{Decimal(cell) * Decimal(TIMES[unit]):f}"


BAD = {
    "session": ["", "  "],
    "time": ["", "noon", "2012-03-05", "2012-13-05T00:00", "5/3/2012 9:41", "2012-03-05T25:00"],
    "joint": ["", "0", "4", "1.5", "x", "-1"],
    "direction": ["", "x", "++", "\u2212", "1"],
    "steps": ["", "0", "-5", "x", "nan", "inf", "7.5", "1e99", "5,0", "0x5", "1_0"],
    "theta_deg": ["", "x", "nan", "-inf", "1,5", "1e999", "\u22121", "3\u00b0", "0x1p3"],
    "psi_deg": ["", "--1", "NaN", "1 2", "\u0661"],
    "check_every": ["0", "-1", "x", "1.5"],
    "status": ["OK", "done", "0"],
    "temperature_C": ["-274", "hot", "nan", "21,5"],
    "step_period_ms": ["0", "-1", "fast"],
    "payload_g": ["heavy", "1g"],
}


@given(drafts(), st.sampled_from(sorted(BAD)), st.data())
@thorough
def test_a_planted_fault_is_told_with_its_line_column_and_value(folder, draft, column, data):
    place = data.draw(st.integers(0, len(draft.rows) - 1))
    value = data.draw(st.sampled_from(BAD[column]))
    draft.rows[place][column] = value
    raw = draft.bytes()
    with pytest.raises(InputError) as refused:
        read(folder, raw)
    line = draft.lines[place]
    told = [(problem.line, problem.column, problem.value) for problem in refused.value.problems]
    assert told == [(line, column, value)]
    assert f"line {line}, column {column}, value {value!r}" in str(refused.value)


@given(drafts(), st.data())
@quick
def test_a_position_outside_the_range_is_told(folder, draft, data):
    place = data.draw(st.integers(0, len(draft.rows) - 1))
    other = data.draw(
        st.sampled_from([joint for joint in (1, 2, 3) if str(joint) != draft.rows[place]["joint"]])
    )
    low, high = RANGES[other]
    value = data.draw(st.sampled_from([f"{low - 1e-6:.6f}", f"{high + 1e-6:.6f}", "1e300", "-1e300"]))
    column = "q3_mm" if other == 3 else f"q{other}_deg"
    draft.rows[place][column] = value
    with pytest.raises(InputError) as refused:
        read(folder, draft.bytes())
    (told,) = refused.value.problems
    assert (told.line, told.column, told.value) == (draft.lines[place], column, value)


@given(drafts(), st.data())
@quick
def test_a_planted_fault_in_parquet_is_told_with_its_row(folder, draft, data):
    column = data.draw(st.sampled_from(sorted(BAD)))
    place = data.draw(st.integers(0, len(draft.rows) - 1))
    value = data.draw(st.sampled_from(BAD[column]))
    draft.rows[place][column] = value
    path = folder / "day.parquet"
    names = list(draft.rows[0])
    parquet.write_table(pa.table({name: [row[name] for row in draft.rows] for name in names}), path)
    with pytest.raises(InputError) as refused:
        read_log(path)
    (told,) = refused.value.problems
    assert (told.line, told.column, told.value) == (place + 1, column, value)


@given(drafts(), st.data())
@quick
def test_a_dropped_renamed_or_doubled_column_is_told(folder, draft, data):
    needed = [
        "session",
        "time",
        "joint",
        "direction",
        "steps",
        "q1_deg",
        "q2_deg",
        "q3_mm",
        "theta_deg",
        "psi_deg",
    ]
    column = data.draw(st.sampled_from(needed))
    name = data.draw(
        st.sampled_from(["", column.upper(), f" {column}", "column", column.partition("_")[0] + "_furlong"])
    )
    assume(name not in draft.rows[0])
    draft.rows = [{(name if key == column else key): cell for key, cell in row.items()} for row in draft.rows]
    with pytest.raises(InputError) as refused:
        read(folder, draft.bytes())
    told = {problem.column for problem in refused.value.problems}
    assert told & {column, name}


@given(drafts(), st.data())
@thorough
def test_mutilated_bytes_lose_no_row_in_silence(folder, draft, data):
    raw = bytearray(draft.bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(raw)))
        length = data.draw(st.integers(0, 4))
        raw[place : place + length] = data.draw(
            st.binary(max_size=4) | st.sampled_from([b'"', b",", b"\n", b"\r"])
        )
    try:
        log = read(folder, bytes(raw))
    except InputError:
        return
    with io.StringIO(raw.decode("utf-8-sig"), newline="") as stream:
        records = [record for record in csv.reader(stream) if record]
    assert len(log) == len(records) - 1
    assert len(log.rows.columns) >= 24


@given(st.binary(max_size=200), st.sampled_from(["day.csv", "day.parquet", "day"]))
@thorough
def test_random_bytes_are_refused(folder, raw, name):
    with pytest.raises(InputError) as refused:
        read(folder, raw, name)
    assert all(name in str(problem) for problem in refused.value.problems)


@given(drafts(), st.data())
@quick
def test_mutilated_parquet_is_refused_or_read(folder, draft, data):
    names = list(draft.rows[0])
    sink = io.BytesIO()
    parquet.write_table(pa.table({name: [row[name] for row in draft.rows] for name in names}), sink)
    raw = bytearray(sink.getvalue())
    place = data.draw(st.integers(0, len(raw) - 1))
    raw[place] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(InputError):
        read(folder, bytes(raw), "day.parquet")


@given(st.sampled_from(["utf-16", "utf-16-le", "utf-32", "latin-1", "cp1252", "utf-7", "cp037"]), drafts())
@quick
def test_other_encodings_are_refused_or_harmless(folder, encoding, draft):
    plain = draft.bytes().decode("utf-8-sig")
    try:
        raw = plain.encode(encoding)
    except UnicodeEncodeError:
        return
    try:
        log = read(folder, raw)
    except InputError:
        return
    # What is the same bytes as UTF-8 must be the same log; UTF-7 is, but for its notes.
    pd.testing.assert_frame_equal(
        log.rows.drop(columns="note"), read(folder, plain.encode()).rows.drop(columns="note")
    )


NUMBERLIKE = st.text("0123456789+-.eE, _xnaif\t", max_size=9)


@given(st.lists(NUMBERLIKE | st.floats().map(repr) | st.integers().map(str), min_size=1, max_size=20))
@thorough
def test_numbers_are_plain_decimals_and_nothing_else(cells):
    found = parse_numbers(pa.array(cells))
    for cell, value, empty, bad in zip(cells, found.values, found.empty, found.bad, strict=True):
        stripped = cell.strip(" \t")
        plain = re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", stripped)
        assert empty == (stripped == "")
        assert bad == (not empty and not (plain and math.isfinite(float(stripped))))
        assert bad or empty or value == float(stripped)


@given(drafts(), NUMBERLIKE)
@quick
def test_a_cell_is_read_the_same_whether_its_file_has_faults_or_not(folder, draft, cell):
    draft.rows[0]["payload_g"] = cell
    stripped = cell.strip(" \t")
    plain = re.fullmatch(r"([+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)?", stripped)
    if plain and (not stripped or math.isfinite(float(stripped))):
        rows = read(folder, draft.bytes()).rows
        value = rows.loc[rows["time"] == draft.rows[0]["time"], "payload"].iloc[0]
        assert value == float(stripped) / 1000 if stripped else math.isnan(value)
    else:
        with pytest.raises(InputError) as refused:
            read(folder, draft.bytes())
        assert [(told.line, told.value) for told in refused.value.problems] == [(draft.lines[0], cell)]


@given(
    st.lists(
        st.text("0123456789-T: .Z+", max_size=22) | st.datetimes().map(datetime.isoformat),
        min_size=1,
        max_size=8,
    )
)
@thorough
def test_times_are_what_python_reads_and_never_a_date_alone(cells):
    found = parse_times(pa.array(cells))
    for cell, value, zoned, empty, bad in zip(
        cells, found.values, found.zoned, found.empty, found.bad, strict=True
    ):
        if bad or empty:
            continue
        when = datetime.fromisoformat(re.sub(r"(\.\d{6})\d+", r"\1", cell.strip(" ")))
        assert zoned == (when.tzinfo is not None)
        utc = when - (when.utcoffset() or timedelta()) if zoned else when
        assert value // 1000 == (utc.replace(tzinfo=None) - datetime(1970, 1, 1)) // timedelta(microseconds=1)
        assert len(cell.strip()) >= len("2012-03-05T09:41")


@given(
    st.datetimes(min_value=datetime(1680, 1, 1), max_value=datetime(2260, 1, 1)),
    st.sampled_from(["", "Z", "-03:30"]),
)
@quick
def test_every_iso_time_is_read(when, zone):
    found = parse_times(pa.array([when.isoformat() + zone, "2012-03-05 09:41"]))
    assert not found.bad.any()
    assert found.zoned.tolist() == [bool(zone), False]


@given(st.text('ab,"\n\r', max_size=40), st.integers(1, 4))
@thorough
def test_records_are_those_of_the_csv_module(content, width):
    records = Records(content.encode(), start=0, first_line=1, width=width)
    expected, ragged = [], []
    stream = io.StringIO(content, newline="")
    reader = csv.reader(stream)
    line = 1
    for record in reader:
        if len(record) == width:
            expected.append(line)
        elif record:
            ragged.append((line, len(record)))
        line = reader.line_num + 1
    assert records.lines.tolist() == expected
    assert [(each.line, each.cells) for each in records.ragged] == ragged
