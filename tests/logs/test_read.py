"""What a good log becomes: SI, defaults, one Log from one file or many."""

import dataclasses
import hashlib
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from stickslip_fit.machine import load_machine

CAMPAIGNS = Path(__file__).parents[3] / "shared" / "data" / "campaigns"
DEGREE = math.pi / 180


def test_a_log_is_in_si_and_in_order_of_time(sheet, read):
    sheet.rows.reverse()
    rows = read(sheet).rows
    assert list(rows.index) == list(range(6))
    assert list(rows["session"]) == ["monday"] * 4 + ["tuesday"] * 2
    assert list(rows["time"].dt.strftime("%d %H:%M")) == [
        *("05 09:00", "05 09:05", "05 09:10", "05 09:20"),
        *("06 08:00", "06 08:10"),
    ]
    assert list(rows["joint"]) == [3, 3, 2, 1, 2, 3]
    assert list(rows["direction"]) == ["+", "-", "-", "+", "+", "+"]
    assert list(rows["steps"]) == [12540, 13205, 9871, 18000, 9900, 6270]
    nan = np.nan
    expected = {
        "q1": [0, 0, 10 * DEGREE, nan, 0, 0],
        "q2": [-90 * DEGREE, -90 * DEGREE, nan, -90 * DEGREE, nan, -90 * DEGREE],
        "q3": [nan, nan, 0.006, 0, 0.012, nan],
        "theta": [0, 0, -30 * DEGREE, 90 * DEGREE, 0, 0],
        "psi": [0, 0, 45 * DEGREE, 0, 0, 0],
        "temperature": [294.65, 294.9, 295.15, 295.4, nan, 293.15],
        "humidity": [nan] * 6,
        "supply": [nan] * 6,
        "step_period": [0.01, 0.01, 0.01, 0.0125, 0.01, 0.01],
        "payload": [nan] * 6,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(rows[name], values, rtol=1e-15, err_msg=name)
    assert list(rows["status"]) == ["ok", "ok", "ok", "interrupted", "excluded", "ok"]
    assert list(rows["check_every"]) == [5, 5, 1, 4, 5, 5]
    assert list(rows["note"]) == ["first", "", "", "hit the table", "", "last"]


def test_an_empty_end_is_the_end_of_the_joint_s_range_in_the_traverse_s_direction(sheet, read):
    sheet.set(2, "to_deg", "")
    sheet.set(5, "from_mm", "")
    rows = read(sheet).rows
    degrees = rows["joint"] != 3
    ends = np.where(degrees, rows["start"] / DEGREE, rows["start"] * 1e3)
    np.testing.assert_allclose(ends, [0, 12, 0, -120, -60, 0], atol=1e-12)
    ends = np.where(degrees, rows["stop"] / DEGREE, rows["stop"] * 1e3)
    np.testing.assert_allclose(ends, [12, 0, -210, 120, 0, 6], atol=1e-12)


def test_ranges_are_those_of_the_machine(sheet, read, tmp_path):
    read(sheet)
    nominal = load_machine()
    machine = dataclasses.replace(nominal, ranges={**nominal.ranges, 3: (0.0, 0.0121)})
    log = read_log(tmp_path / "day.csv", machine=machine)
    assert log.rows["stop"].iloc[0] == 0.0121
    assert log.machine is machine
    narrow = dataclasses.replace(nominal, ranges={**nominal.ranges, 2: (-1.0, 0.5)})
    with pytest.raises(InputError, match=r"q2_deg, value '-90'.*-57.2958 to 28.6479 deg"):
        read_log(tmp_path / "day.csv", machine=narrow)


def test_columns_that_are_not_given_are_there_all_the_same(sheet, read):
    for column in sheet.header[10:]:
        sheet.drop(column)
    for row in range(6):
        sheet.set(row, "steps", "12540")
    rows = read(sheet).rows
    assert (rows["check_every"] == 5).all()
    assert (rows["status"] == "ok").all()
    assert (rows["note"] == "").all()
    assert rows[["temperature", "humidity", "supply", "step_period", "payload"]].isna().all(axis=None)


def test_numbers_may_be_written_in_any_plain_way(sheet, read):
    expected = read(sheet).rows
    for row, column, value in (
        (0, "steps", "12540.0"),
        (1, "steps", "1.3205e4"),
        (2, "joint", "2.0"),
        (2, "psi_deg", "+45."),
        (2, "theta_deg", "-.3E+2"),
        (3, "step_period_ms", "0012.50"),
    ):
        sheet.set(row, column, value)
    pd.testing.assert_frame_equal(read(sheet).rows, expected)


@pytest.mark.parametrize(
    ("written", "utc"),
    [
        ("2012-03-05T09:41", "2012-03-05T09:41"),
        ("2012-03-05 09:41:10", "2012-03-05T09:41:10"),
        ("2012-03-05T09:41:10.5", "2012-03-05T09:41:10.5"),
        ("2012-03-05T09:41:10.123456789", "2012-03-05T09:41:10.123456789"),
        ("2012-03-05T09:41Z", "2012-03-05T09:41"),
        ("2012-03-05T09:41:10+01:00", "2012-03-05T08:41:10"),
        ("2012-03-05 00:41:10-0530", "2012-03-05T06:11:10"),
        ("2012-03-05T23:41:10+14", "2012-03-05T09:41:10"),
    ],
)
def test_times_with_a_zone_become_utc(sheet, read, written, utc):
    sheet.rows = sheet.rows[:1]
    sheet.set(0, "time", written)
    (time,) = read(sheet).rows["time"]
    assert time == pd.Timestamp(utc, tz="UTC" if any(mark in written[16:] for mark in "Z+-") else None)


def test_sessions_run_past_midnight_and_labels_are_no_dates(sheet, read):
    sheet.set(3, "time", "2012-03-07T00:10:00")
    log = read(sheet)
    assert log.sessions == ("monday", "tuesday")
    assert log.rows["session"].iloc[-1] == "monday"
    assert log.rows["session_seconds"].iloc[-1] == 39 * 3600 + 600


def test_labels_that_differ_only_in_spaces_or_capitals_are_noted(sheet, read):
    sheet.set(5, "session", "Tuesday ")
    log = read(sheet)
    assert log.sessions == ("monday", "tuesday", "Tuesday ")
    assert any("'Tuesday ', 'tuesday'" in note for note in log.notes)


@pytest.mark.parametrize(
    ("minutes", "joints", "noted"),
    [
        ((0, 10, 20, 30, -40, -30), "232323", True),
        ((0, 10, 20, 30, 40, 50), "232323", False),
        ((0, 20, 40, 10, 30, 50), "222333", False),  # joint after joint, times between each other
        ((50, 40, 30, 20, 10, 0), "232323", False),  # the last traverse first
    ],
)
def test_a_clock_that_was_set_back_is_noted(tmp_path, minutes, joints, noted):
    begin = pd.Timestamp("2012-03-05T09:00")
    rows = {"session": "monday", "time": [begin + pd.Timedelta(minutes=one) for one in minutes]}
    rows |= {"joint": list(joints), "direction": "+", "steps": 40_000, "q1_deg": 0, "q2_deg": 0, "q3_mm": 0}
    pd.DataFrame(rows | {"theta_deg": 0, "psi_deg": 0}).to_csv(tmp_path / "day.csv", index=False)
    notes = [note for note in read_log(tmp_path / "day.csv").notes if "clock" in note]
    assert len(notes) == noted
    assert all(
        "from its traverse 4 to the next in the file the time falls by 70.0 min" in one for one in notes
    )


def test_the_hash_of_a_single_file_is_its_own(sheet, read, tmp_path):
    log = read(sheet)
    digest = hashlib.sha256((tmp_path / "day.csv").read_bytes()).hexdigest()
    assert log.sha256 == digest
    assert log.sources == ((str(tmp_path / "day.csv"), digest),)


def halves(sheet, folder: Path) -> list[Path]:
    """The sheet's sessions in two files, the second in other units and another order of columns."""
    monday, tuesday = folder / "2012" / "monday.csv", folder / "2012" / "later" / "tuesday.CSV"
    tuesday.parent.mkdir(parents=True)
    frame = pd.DataFrame(sheet.rows, columns=sheet.header)
    frame[:4].to_csv(monday, index=False)
    other = frame[4:].assign(theta_rad="0", q3_um=["12000", ""], extra=["x", "y"])
    other = other.drop(columns=["theta_deg", "q3_mm", "pressure_hPa"])
    other[sorted(other.columns)].to_csv(tuesday, index=False)
    return [monday, tuesday]


def test_a_campaign_may_be_several_files_or_a_folder(sheet, read, tmp_path):
    whole = read(sheet).rows
    files = halves(sheet, tmp_path / "years")
    (tmp_path / "years" / ".hidden.csv").write_text("not a log")
    (tmp_path / "years" / "README.md").write_text("not a log")
    several, reversed_, folder = read_log(files), read_log(files[::-1]), read_log(tmp_path / "years")
    expected = whole.assign(
        **{"covariate:pressure_hPa": whole["covariate:pressure_hPa"].where(whole.index < 4)}
    )
    pd.testing.assert_frame_equal(several.rows.drop(columns="text:extra"), expected, rtol=1e-15)
    assert list(several.rows["text:extra"]) == ["", "", "", "", "x", "y"]
    pd.testing.assert_frame_equal(reversed_.rows[several.rows.columns], several.rows)
    pd.testing.assert_frame_equal(folder.rows[several.rows.columns], several.rows)
    assert several.sha256 == reversed_.sha256 == folder.sha256
    assert several.sha256 not in dict(several.sources).values()
    assert sorted(name for name, _ in folder.sources) == sorted(map(str, files))


def test_faults_of_all_files_are_told_together_each_with_its_file(sheet, tmp_path):
    sheet.set(0, "steps", "x")
    sheet.set(5, "theta_deg", "y")
    files = halves(sheet, tmp_path)
    files[1].write_text(files[1].read_text().replace(",0,0", ",0,up"))
    with pytest.raises(InputError) as refused:
        read_log([*files, tmp_path / "missing.csv"])
    told = {(problem.file, problem.line) for problem in refused.value.problems}
    assert told == {
        (str(files[0]), 2),
        (str(files[1]), 2),
        (str(files[1]), 3),
        (str(tmp_path / "missing.csv"), None),
    }


def test_doubles_and_zones_are_found_across_files(sheet, tmp_path):
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    first.write_text(sheet.text())
    lines = sheet.text().splitlines(keepends=True)
    second.write_text("".join([lines[0], lines[3], lines[6].replace("08:10:00", "08:20:00Z")]))
    with pytest.raises(InputError) as refused:
        read_log([first, second])
    double, zone = refused.value.problems
    assert (double.file, double.line, double.column) == (str(second), 2, "time")
    assert f"line 4 of {first}" in double.message
    assert (zone.file, zone.line, zone.value) == (str(second), 3, "2012-03-06T08:20:00Z")
    assert f"line 2 of {first}" in zone.message


@pytest.mark.parametrize("odd", ["missing.csv", "missing", "a\0b.csv"])
def test_a_file_that_cannot_be_read_is_named(tmp_path, odd):
    with pytest.raises(InputError, match="cannot be read"):
        read_log(tmp_path / odd)


def test_a_folder_without_logs_and_no_names_at_all_are_told(tmp_path):
    with pytest.raises(InputError, match="folder without logs"):
        read_log(tmp_path)
    with pytest.raises(InputError, match="name a file"):
        read_log([])


@pytest.mark.parametrize(
    ("letter", "count"), [("a", 654), ("b", 654), ("c", 76), ("d", 2496), ("e", 654), ("f", 654)]
)
def test_real_campaigns_are_read_without_a_word(letter, count):
    path = CAMPAIGNS / f"campaign-{letter}.csv"
    if not path.exists():
        pytest.skip("the campaigns that come beside this checkout are not there")
    log = read_log(path)
    assert len(log) == count
    assert log.notes == ()
    plain = pd.read_csv(path).sort_values(["time", "joint"])
    np.testing.assert_array_equal(log.rows["steps"], plain["steps"])
    np.testing.assert_allclose(log.rows["psi"], plain["psi_deg"] * DEGREE)
