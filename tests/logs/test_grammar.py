"""How a cell becomes a number or a time, and a line a record, against Python's and pyarrow's own readers."""

import math
import re
from datetime import datetime, timedelta

import pyarrow as pa
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from stickslip_fit.logs._csv import CsvRecords, read_cells, read_records
from stickslip_fit.logs._table import parse_numbers, parse_times

quick = settings(max_examples=30, deadline=None)
thorough = settings(quick, max_examples=150)

NUMBERLIKE = st.text("0123456789+-.eE, _xnaif\t", max_size=9)


@pytest.mark.slow
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


@pytest.mark.slow
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
        cells, found.values, found.has_zone, found.empty, found.bad, strict=True
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
    assert found.has_zone.tolist() == [bool(zone), False]


@given(st.text('ab,"\n\r', min_size=1, max_size=40), st.integers(1, 4))
@thorough
def test_records_and_their_lines_are_those_of_pyarrow_and_of_the_file(content, width):
    def split_lines(text):
        return re.split("\r\n|\r|\n", text)

    raw = content.encode()
    records, found = CsvRecords(raw, 0, 1, width), list(read_records(raw, 0, 1, ","))
    assume(found)
    cells, ragged = read_cells(records, [], 1 << 20)
    complete = [record for record in found if len(record.cells) == width]
    assert [record.cells for record in complete] == [list(row.values()) for row in cells.to_pylist()]
    assert [record.line for record in complete] == records.scan.lines.tolist()
    assert [split_lines(content)[record.line - 1] for record in found] == [
        split_lines(record.raw.decode())[0] for record in found
    ]
    assert len(records.scan.ragged) == ragged
