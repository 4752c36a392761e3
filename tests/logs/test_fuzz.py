"""Anything may come in: out come a true Log or an InputError that names each fault, and nothing else."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
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
from stickslip_fit.units import SUFFIXES, to_si

quick = settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
thorough = settings(quick, max_examples=50)

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
# What each unit is in the first one of its quantity, in exact decimals; rad and C are not multiples.
TIMES = {"m": "0.001", "um": "1000", "nm": "1000000", "s": "0.001", "kg": "0.001"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


def read(folder, raw: bytes, name: str = "day.csv"):
    path = folder / name
    path.write_bytes(raw)
    return read_log(path)


@given(data=st.data())
@quick
def test_a_good_log_comes_out_as_it_was_written(folder, drafts, data):
    draft = data.draw(drafts)
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


@given(data=st.data(), random=st.randoms())
@quick
def test_the_order_of_rows_means_nothing(folder, drafts, data, random):
    draft = data.draw(drafts)
    expected = read(folder, draft.bytes()).rows
    random.shuffle(draft.rows)
    pd.testing.assert_frame_equal(read(folder, draft.bytes()).rows, expected)


@given(data=st.data())
@quick
def test_units_are_only_a_way_of_writing(folder, drafts, data):
    draft = data.draw(drafts)
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


@given(data=st.data(), column=st.sampled_from(sorted(BAD)))
@thorough
def test_a_planted_fault_is_told_with_its_line_column_and_value(folder, drafts, data, column):
    draft = data.draw(drafts)
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


@given(data=st.data())
@quick
def test_a_planted_fault_in_parquet_is_told_with_its_row(folder, drafts, data):
    draft = data.draw(drafts)
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


@given(data=st.data())
@quick
def test_a_dropped_renamed_or_doubled_column_is_told(folder, drafts, data):
    draft = data.draw(drafts)
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


@given(data=st.data())
@thorough
def test_mutilated_bytes_lose_no_row_in_silence(folder, drafts, data):
    draft = data.draw(drafts)
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


@given(data=st.data())
@quick
def test_mutilated_parquet_is_refused_or_read(folder, drafts, data):
    draft = data.draw(drafts)
    names = list(draft.rows[0])
    sink = io.BytesIO()
    parquet.write_table(pa.table({name: [row[name] for row in draft.rows] for name in names}), sink)
    raw = bytearray(sink.getvalue())
    place = data.draw(st.integers(0, len(raw) - 1))
    raw[place] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(InputError):
        read(folder, bytes(raw), "day.parquet")


@given(
    data=st.data(),
    encoding=st.sampled_from(["utf-16", "utf-16-le", "utf-32", "latin-1", "cp1252", "utf-7", "cp037"]),
)
@quick
def test_other_encodings_are_refused_or_harmless(folder, drafts, data, encoding):
    draft = data.draw(drafts)
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


@given(data=st.data(), cell=NUMBERLIKE)
@quick
def test_a_cell_is_read_the_same_whether_its_file_has_faults_or_not(folder, drafts, data, cell):
    draft = data.draw(drafts)
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
