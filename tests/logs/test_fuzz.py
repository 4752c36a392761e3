"""Anything may come in: out come a true Log or an InputError that names each fault, and nothing else."""

import codecs
import contextlib
import csv
import io
import math
import re
import time
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from pyarrow import parquet
from typer.testing import CliRunner

from stickslip_fit.cli._app import app
from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from stickslip_fit.logs.schema import holds_numbers
from stickslip_fit.units import SUFFIXES, to_si
from tests.logs.test_columns import REQUIRED

quick = settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
thorough = settings(quick, max_examples=12)

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


# Random angles may look like radians, which is said and changes nothing.
pytestmark = pytest.mark.filterwarnings("ignore:.* the values look like")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


Table = list[list[str]]


def read(folder, raw: bytes, name: str = "day.csv"):
    path = folder / name
    path.write_bytes(raw)
    return read_log(path)


@pytest.mark.slow
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


@pytest.mark.slow
@given(data=st.data(), random=st.randoms())
@quick
def test_the_order_of_rows_means_nothing(folder, drafts, data, random):
    draft = data.draw(drafts)
    expected = read(folder, draft.bytes()).rows
    random.shuffle(draft.rows)
    pd.testing.assert_frame_equal(read(folder, draft.bytes()).rows, expected)


@pytest.mark.slow
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
    "payload_g": ["heavy", "1g", "-1", "1e6"],
    "pressure_hPa": ["1e308"],
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
    column = data.draw(st.sampled_from(REQUIRED))
    name = data.draw(
        st.sampled_from(["", column.upper(), f" {column}", "column", column.partition("_")[0] + "_furlong"])
    )
    assume(name not in draft.rows[0])
    draft.rows = [{(name if key == column else key): cell for key, cell in row.items()} for row in draft.rows]
    with pytest.raises(InputError) as refused:
        read(folder, draft.bytes())
    told = {problem.column for problem in refused.value.problems}
    assert told & {column, name}


@pytest.mark.slow
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
    encoding = "cp1252" if any("Windows-1252" in note for note in log.notes) else "utf-8"
    with io.StringIO(raw.removeprefix(codecs.BOM_UTF8).decode(encoding), newline="") as stream:
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


@pytest.mark.slow
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
    if plain and (not stripped or 0 <= float(stripped) <= 1e5):
        rows = read(folder, draft.bytes()).rows
        value = rows.loc[rows["time"] == draft.rows[0]["time"], "payload"].iloc[0]
        assert value == float(stripped) / 1000 if stripped else math.isnan(value)
    else:
        with pytest.raises(InputError) as refused:
            read(folder, draft.bytes())
        assert [(told.line, told.value) for told in refused.value.problems] == [(draft.lines[0], cell)]


REFERENCE = Path(__file__).parents[2] / "data/reference/campaign.csv"
HEADER, *ROWS = list(csv.reader(REFERENCE.read_text("utf-8").splitlines()))
SMALL = [HEADER, *ROWS[::16], *ROWS[1::16]]
ODD_CELLS = [
    *(
        *("0", "-0", "1e308", "-1e308", "1e-320", "1e999", "nan", "inf", "NULL"),
        *("#N/A", "TRUE", "1,5", '""', '"'),
    ),
    *("'=1+1", "12540.5", "9" * 20, "2012-03-05", "2012-03-05T25:00", "-90.0000001", "9223372036854775808"),
    *("+", "-", "\u2212", "ok", "\U0001f600", "\x1b[31m", "\0", ""),
]


def change_cells(table: Table, rng: np.random.Generator) -> None:
    for _ in range(rng.integers(1, 4)):
        row = table[rng.integers(len(table))]
        row[rng.integers(len(row))] = str(rng.choice(ODD_CELLS))


def change_a_column(table: Table, rng: np.random.Generator) -> None:
    column = rng.integers(len(HEADER))
    cell = str(rng.choice(ODD_CELLS))
    for row in table[1:]:
        row[column] = cell


def drop_or_repeat_a_column(table: Table, rng: np.random.Generator) -> None:
    column, twice = rng.integers(len(HEADER)), rng.random() < 0.5
    for row in table:
        row[column : column + 1] = [row[column]] * 2 if twice else []


def swap_columns(table: Table, rng: np.random.Generator) -> None:
    one, other = rng.choice(len(HEADER), 2, replace=False)
    for row in table[int(rng.integers(2)) :]:
        row[one], row[other] = row[other], row[one]


def shuffle_and_cut_rows(table: Table, rng: np.random.Generator) -> None:
    table[1:] = [table[place] for place in rng.permutation(range(1, len(table)))[: rng.integers(len(table))]]


def scale_a_column(table: Table, rng: np.random.Generator) -> None:
    column, factor = rng.integers(len(HEADER)), 10.0 ** rng.integers(-12, 13)
    for row in table[1:]:
        with contextlib.suppress(ValueError):
            row[column] = f"{float(row[column]) * factor:g}"


def change_nothing(table: Table, rng: np.random.Generator) -> None:
    pass


TABLE_MUTATIONS = (
    *(change_cells, change_a_column, drop_or_repeat_a_column, swap_columns),
    *(shuffle_and_cut_rows, shuffle_and_cut_rows, scale_a_column, change_nothing, change_nothing),
)


def as_csv(table: Table, rng: np.random.Generator) -> bytes:
    """A table in a dialect of any kind, with or without damaged bytes."""
    with io.StringIO(newline="") as stream:
        end, mark = str(rng.choice(["\n", "\r\n", "\r"])), str(rng.choice([*"," * 12, ";", "\t"]))
        writer = csv.writer(stream, lineterminator=end, delimiter=mark, quoting=int(rng.choice([0, 0, 1])))
        writer.writerows(table)
        text = stream.getvalue()
    encoding = str(rng.choice(["utf-8", "utf-8-sig", "latin-1"] * 5 + ["utf-16", "utf-16-le"]))
    raw = bytearray(text.encode(encoding, "replace"))
    for _ in range(rng.choice([0, 0, 0, 0, 1, 4])):
        place, length = rng.integers(len(raw) + 1), rng.integers(0, 40)
        raw[place : place + length] = rng.choice(
            [b"", b'"', b",", b"\n", b"\r", b"\0\0", b"\xff", bytes(raw[:90])]
        )
    return bytes(raw[: int(rng.integers(len(raw)))] if rng.random() < 0.05 else raw)


ANY_TYPE = (
    *(pa.string(), pa.large_binary(), pa.bool_(), pa.uint64(), pa.int8(), pa.float16(), pa.decimal128(38, 6)),
    *(pa.duration("us"), pa.timestamp("ns", "UTC"), pa.date32(), pa.time64("us"), pa.list_(pa.float64())),
    *(pa.struct([("a", pa.float64())]), pa.dictionary(pa.int8(), pa.string()), pa.null(), pa.decimal256(60)),
)


def any_array(count: int, kind: pa.DataType, rng: np.random.Generator) -> pa.Array:
    """Cells of any type, some of them empty."""
    if pa.types.is_null(kind):
        return pa.nulls(count)
    if pa.types.is_dictionary(kind):
        return any_array(count, kind.value_type, rng).dictionary_encode()
    whole = rng.integers(0, 100, count).astype(object)
    whole[rng.random(count) < 0.1] = None
    if pa.types.is_uint64(kind):
        whole[0] = 2**64 - 1
    change = {
        pa.string(): str,
        pa.large_binary(): lambda value: bytes([value, 255 - value]),
        pa.bool_(): bool,
        pa.float16(): np.float16,
        pa.list_(pa.float64()): lambda value: [float(value)],
        pa.struct([("a", pa.float64())]): lambda value: {"a": float(value)},
    }.get(kind, int)
    return pa.array([None if value is None else change(value) for value in whole], kind)


def as_parquet(table: Table, rng: np.random.Generator) -> bytes:
    """A table as text or numbers, one column of any type, with or without damaged bytes."""
    width = min(map(len, table))
    columns = [pa.array([row[place] for row in table[1:]], pa.string()) for place in range(width)]
    for place, name in enumerate(table[0][:width]):
        if holds_numbers(name) and rng.random() < 0.7:
            with contextlib.suppress(pa.ArrowInvalid):
                columns[place] = pc.if_else(pc.equal(columns[place], ""), None, columns[place]).cast(
                    pa.float64()
                )
    if rng.random() < 0.3:
        kind = ANY_TYPE[rng.integers(len(ANY_TYPE))]
        columns[rng.integers(width)] = any_array(len(table) - 1, kind, rng)
    with io.BytesIO() as sink:
        parquet.write_table(pa.Table.from_arrays(columns, table[0][:width]), sink)
        raw = bytearray(sink.getvalue())
    for _ in range(rng.choice([0, 0, 0, 1, 4])):
        raw[rng.integers(len(raw))] ^= int(rng.integers(1, 256))
    return bytes(raw)


def steps_in(raw: bytes, kind: str) -> list[float]:
    """The counts of a file, read with nothing of ours."""
    if kind == "parquet":
        return sorted(
            map(float, parquet.read_table(io.BytesIO(raw), columns=["steps"]).column(0).to_pylist())
        )
    text = decode_as_spreadsheets_do(raw)
    mark = max(",;\t", key=re.split(r"[\r\n]", text, maxsplit=1)[0].count)
    with io.StringIO(text, newline="") as stream:
        header, *records = [record for record in csv.reader(stream, delimiter=mark) if record]
    return sorted(float(record[header.index("steps")]) for record in records)


def decode_as_spreadsheets_do(raw: bytes) -> str:
    """UTF-8 with or without its mark, UTF-16 with it, else Windows-1252."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252")


def try_mutated_log(seed: int, folder: Path) -> bool:
    """Put one mutated log through `check` and, if it is read, `fit`; whether it was read."""
    rng = np.random.default_rng(seed)
    table = [list(row) for row in SMALL]
    TABLE_MUTATIONS[rng.integers(len(TABLE_MUTATIONS))](table, rng)
    kind = str(rng.choice(["csv", "parquet"]))
    raw = (as_csv if kind == "csv" else as_parquet)(table, rng)
    path = folder / f"day.{kind}"
    path.write_bytes(raw)
    for command in ("check", "fit"):
        began = time.process_time()  # not that of other programs
        result = CliRunner().invoke(app, [command, str(path)])
        assert time.process_time() - began < 10, (seed, command)
        if result.exception:
            assert isinstance(result.exception, InputError), (seed, command, result.exc_info)
            assert command == "fit" or str(path) in str(result.exception), (seed, result.exception)
            return command == "fit"
        if command == "check":
            assert sorted(read_log(path).rows["steps"]) == steps_in(raw, kind), seed
    return True


@pytest.mark.slow
def test_mutated_logs_are_refused_or_read_whole_and_fitted(folder):
    outcome = [try_mutated_log(seed, folder) for seed in range(8)]
    assert 0 < sum(outcome) < len(outcome)


# As many parameters as rows, different stretches, and a parameter on its bound that no row determines.
@pytest.mark.slow
@pytest.mark.parametrize("seed", [25, 258, 681, pytest.param(324, marks=pytest.mark.nightly)])
def test_logs_that_do_not_determine_everything_are_fitted_all_the_same(folder, seed):
    assert try_mutated_log(seed, folder)


@pytest.mark.nightly
@pytest.mark.parametrize("block", range(10))
def test_a_thousand_mutated_logs_are_refused_or_read_whole_and_fitted(folder, block):
    outcome = [try_mutated_log(seed, folder) for seed in range(100 * block, 100 * (block + 1))]
    assert 15 < sum(outcome) < 85
