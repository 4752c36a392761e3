"""Parquet with the same columns is equally good: same Log, same faults, rows instead of lines."""

from datetime import date

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log

TEXT = ["session", "time", "direction", "status", "note"]
COUNTS = ["joint", "steps"]


def typed(sheet) -> pd.DataFrame:
    """The sheet as pandas would hold it."""
    frame = pd.DataFrame(sheet.rows, columns=sheet.header)
    numbers = frame.columns.difference(TEXT)
    frame[numbers] = frame[numbers].apply(pd.to_numeric)
    return frame.astype(dict.fromkeys(COUNTS, "int32")).assign(time=pd.to_datetime(frame["time"]))


@pytest.fixture
def write(tmp_path):
    def writer(frame: pd.DataFrame | pa.Table):
        path = tmp_path / "day.parquet"
        if isinstance(frame, pa.Table):
            parquet.write_table(frame, path)
        else:
            frame.to_parquet(path)
        return path

    return writer


def test_a_typed_table_gives_the_same_log_as_csv(sheet, read, write):
    pd.testing.assert_frame_equal(read_log(write(typed(sheet))).rows, read(sheet).rows)


def test_a_table_of_text_gives_the_same_log_as_csv(sheet, read, write):
    table = pa.table(dict(zip(sheet.header, map(list, zip(*sheet.rows, strict=True)), strict=True)))
    pd.testing.assert_frame_equal(read_log(write(table)).rows, read(sheet).rows)


@pytest.mark.parametrize(
    ("column", "kind"),
    [
        ("session", pa.dictionary(pa.int16(), pa.string())),
        ("direction", pa.string_view()),
        ("note", pa.large_string()),
        ("note", pa.binary()),
        ("joint", pa.uint8()),
        ("joint", pa.float32()),
        ("steps", pa.int64()),
        ("steps", pa.decimal128(12, 2)),
        ("q1_deg", pa.int16()),
        ("q2_deg", pa.dictionary(pa.int8(), pa.float64())),
        ("time", pa.timestamp("s")),
        ("time", pa.timestamp("us")),
        ("pressure_hPa", pa.float32()),
    ],
)
def test_columns_may_have_any_type_that_holds_their_values(sheet, read, write, column, kind):
    table = pa.Table.from_pandas(typed(sheet), preserve_index=False)
    place = table.schema.get_field_index(column)
    values = table.column(column).to_pylist()
    if pa.types.is_integer(kind):
        values = [None if value is None else int(value) for value in values]
    if pa.types.is_binary(kind):
        values = [value.encode() for value in values]
    array = (
        pa.array(values, kind.value_type).dictionary_encode()
        if pa.types.is_dictionary(kind)
        else pa.array(values, kind)
    )
    rows = read_log(write(table.set_column(place, column, array))).rows
    pd.testing.assert_frame_equal(rows, read(sheet).rows)


def test_times_with_a_zone_become_utc(sheet, write):
    frame = typed(sheet)
    frame["time"] = frame["time"].dt.tz_localize("Asia/Kolkata")
    rows = read_log(write(frame)).rows
    assert rows["time"].iloc[0] == pd.Timestamp("2012-03-05T03:30Z")


def test_nan_is_an_empty_cell_and_infinity_is_a_fault(sheet, read, write):
    table = pa.Table.from_pandas(typed(sheet), preserve_index=False)
    place = table.schema.get_field_index("temperature_C")
    warm = pa.array([21.5, 21.75, 22.0, 22.25, np.nan, 20.0])
    pd.testing.assert_frame_equal(
        read_log(write(table.set_column(place, "temperature_C", warm))).rows, read(sheet).rows
    )
    hot = pa.array([21.5, np.inf, 22.0, 22.25, np.nan, 20.0])
    with pytest.raises(InputError, match="line 2, column temperature_C, value 'inf'"):
        read_log(write(table.set_column(place, "temperature_C", hot)))


@pytest.mark.parametrize(
    ("row", "column", "value", "shown"),
    [
        (2, "joint", 7, "7"),
        (0, "steps", -5, "-5"),
        (1, "theta_deg", np.nan, ""),
        (3, "q2_deg", 31.0, "31"),
        (1, "direction", "down", "down"),
        (0, "from_mm", 12.0, "12"),
        (5, "time", pd.NaT, ""),
        (4, "status", "lost", "lost"),
    ],
)
def test_a_fault_is_told_with_its_row_column_and_value(sheet, write, row, column, value, shown):
    frame = typed(sheet)
    frame.loc[row, column] = value
    with pytest.raises(InputError) as refused:
        read_log(write(frame))
    (told,) = refused.value.problems
    assert (told.line, told.column, told.value) == (row + 1, column, shown)
    assert f"row {row + 1}" in told.message


def test_a_date_is_no_time(sheet, write):
    frame = typed(sheet)
    frame["time"] = [date(2012, 3, day) for day in range(1, 7)]
    with pytest.raises(InputError, match="time of day") as refused:
        read_log(write(frame))
    (told,) = refused.value.problems
    assert "6 of 6 values are faulty, the first one in row 1: '2012-03-01' is no date with" in told.message


def test_columns_of_the_lab_s_own_keep_their_kind(sheet, write):
    frame = typed(sheet).assign(counter=range(6), good=[True, False] * 3, seen=pd.Timestamp("2012-03-05"))
    rows = read_log(write(frame)).rows
    np.testing.assert_array_equal(rows["covariate:counter"], range(6))
    assert list(rows["text:good"]) == ["true", "false"] * 3
    assert rows["text:seen"].str.startswith("2012-03-05").all()


def test_the_row_labels_that_pandas_leaves_behind_are_no_covariate(sheet, write):
    log = read_log(write(typed(sheet).iloc[[5, 0, 2]]))
    assert len(log) == 3
    assert not any("index_level" in name for name in log.rows)
    assert "row labels" in log.notes[0]


def test_a_column_of_lists_is_told(sheet, write):
    frame = typed(sheet)
    frame["trace"] = [[1.0, 2.0]] * 6
    with pytest.raises(InputError, match="column trace: holds list"):
        read_log(write(frame))


@pytest.mark.parametrize("cut", [0, 3, 4, 100, -5])
def test_a_broken_file_is_told(sheet, write, cut):
    path = write(typed(sheet))
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InputError, match="no Parquet file that can be read"):
        read_log(path)


def test_damage_inside_a_column_is_told(sheet, write):
    path = write(pd.concat([typed(sheet)], ignore_index=True))
    start = parquet.read_metadata(path).row_group(0).column(0).file_offset
    offset = parquet.read_metadata(path).row_group(0).column(0).dictionary_page_offset or start
    raw = bytearray(path.read_bytes())
    raw[offset : offset + 12] = b"\xff" * 12
    path.write_bytes(raw)
    with pytest.raises(InputError, match="cannot be read"):
        read_log(path)


def test_a_table_without_rows_is_told(sheet, write):
    with pytest.raises(InputError, match="no rows"):
        read_log(write(typed(sheet)[:0]))


def test_a_parquet_file_is_known_by_its_content(sheet, read, write, tmp_path):
    path = write(typed(sheet)).rename(tmp_path / "day.log")
    pd.testing.assert_frame_equal(read_log(path).rows, read(sheet).rows)


@pytest.mark.slow
def test_columns_read_side_by_side_do_not_get_in_each_other_s_way(sheet, write):
    frame = typed(sheet)
    many = pd.concat([frame.assign(time=frame["time"] + pd.Timedelta(days=7 * week)) for week in range(1000)])
    path = write(many.reset_index(drop=True))
    first = read_log(path).rows
    for _ in range(3):
        pd.testing.assert_frame_equal(read_log(path).rows, first)
