"""A log that is written and read again is the same log, to the last bit."""

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log, write_log
from stickslip_fit.units import from_si, to_si

CAMPAIGNS = Path(__file__).parents[3] / "shared" / "data" / "campaigns"


def assert_round_trip(log, path):
    log.to_csv(path)
    again = read_log(path)
    pd.testing.assert_frame_equal(again.rows, log.rows, check_exact=True)
    return path.read_text(encoding="utf-8")


def test_every_kind_of_column_survives(sheet, read, tmp_path):
    sheet.add("payload_g", ["1", "2.5", "", "", "0", "-0"])
    sheet.add("humidity_pct", ["33.3", "44.1", "57.3", "", "99.9", "0.7"])
    sheet.add("supply_V", ["79.897", "", "", "80", "81", "82"])
    sheet.add("operator", ['"ann, \u00b5"', '"a ""b"""', "", "x\ty", "1", " "])
    text = assert_round_trip(read(sheet), tmp_path / "again.csv")
    assert "33.3" in text
    assert "12.500000" not in text


@pytest.mark.parametrize("note", ["a\nb", "a\rb", "a\r\nb", "\r", '"', '""', " a", ",", "\n", "'"])
def test_awkward_text_survives(sheet, read, tmp_path, note):
    quoted = '"' + note.replace('"', '""') + '"'
    sheet.set(2, "note", quoted)
    sheet.set(3, "session", quoted if note.strip() else "x")
    log = read(sheet)
    assert log.rows["note"].iloc[2] == note
    assert_round_trip(log, tmp_path / "again.csv")


def test_what_says_nothing_is_left_out_and_ends_are_written(sheet, read, tmp_path):
    for column in ("check_every", "status", "temperature_C", "step_period_ms", "note", "pressure_hPa"):
        sheet.drop(column)
    sheet.set(2, "steps", "9870")
    text = assert_round_trip(read(sheet), tmp_path / "again.csv")
    header, first = text.splitlines()[:2]
    assert header == (
        "session,time,joint,direction,steps,q1_deg,q2_deg,q3_mm,theta_deg,psi_deg,from_deg,to_deg,from_mm,to_mm"
    )
    assert first == "monday,2012-03-05T09:00:00,3,+,12540,0,-90,,0,0,,,0,12"


@pytest.mark.parametrize(
    "time", ["2012-03-05T09:00:00.25", "2012-03-05T09:00:00.123456789", "1999-12-31T23:59:59"]
)
@pytest.mark.parametrize("zone", ["", "Z", "+05:45"])
def test_times_survive_to_the_nanosecond(sheet, read, tmp_path, time, zone):
    for row in range(6):
        sheet.set(row, "time", sheet.get(row, "time") + zone)
    sheet.set(0, "time", time + zone)
    text = assert_round_trip(read(sheet), tmp_path / "again.csv")
    assert text.count("Z,") == (6 if zone else 0)


def test_values_without_an_exact_equal_in_the_usual_unit_are_written_in_si(sheet, read, tmp_path):
    metres = np.random.default_rng(0).uniform(0, 0.012, 1000)
    millimetres = from_si(metres, "mm")
    tried = [millimetres, np.nextafter(millimetres, 0), np.nextafter(millimetres, 1e3)]
    metres = metres[np.all([to_si(each, "mm") != metres for each in tried], axis=0)][:6]
    assert len(metres) == 6
    sheet.rename("q3_mm", "q3_m")
    for row, value in enumerate(metres):
        sheet.set(row, "joint", "2")
        sheet.set(row, "q3_m", repr(float(value)))
        sheet.set(row, "q1_deg", "0")
        for column in ("from_mm", "to_mm", "from_deg", "to_deg"):
            sheet.set(row, column, "")
    text = assert_round_trip(read(sheet), tmp_path / "again.csv")
    assert ",q3_m," in text
    assert ",q2_deg," in text


def test_degrees_of_many_digits_stay_degrees(sheet, read, tmp_path):
    degrees = np.random.default_rng(0).uniform(-180, 180, 500)
    missed = degrees[to_si(from_si(to_si(degrees, "deg"), "deg"), "deg") != to_si(degrees, "deg")]
    for row, value in enumerate(missed[:6]):
        sheet.set(row, "psi_deg", repr(float(value)))
    assert ",psi_deg," in assert_round_trip(read(sheet), tmp_path / "again.csv")


@pytest.mark.parametrize("seed", range(5))
def test_random_values_in_si_survive(sheet, read, tmp_path, seed):
    rng = np.random.default_rng(seed)
    for column, name, low, high in (
        ("q1_deg", "q1_rad", -2, 2),
        ("q2_deg", "q2_rad", -3, 0.5),
        ("q3_mm", "q3_m", 0, 0.012),
        ("theta_deg", "theta_rad", -3, 3),
        ("psi_deg", "psi_rad", -3, 3),
        ("temperature_C", "temperature_K", 280, 310),
        ("step_period_ms", "step_period_s", 1e-3, 1e-1),
        ("pressure_hPa", "payload_kg", 0, 1e-2),
    ):
        sheet.rename(column, name)
        for row in range(6):
            sheet.set(row, name, repr(float(rng.uniform(low, high))))
    sheet.add("humidity_pct", [repr(float(value)) for value in rng.uniform(10, 90, 6)])
    assert_round_trip(read(sheet), tmp_path / "again.csv")


@pytest.mark.parametrize("letter", "abcdef")
def test_real_campaigns_survive(tmp_path, letter):
    path = CAMPAIGNS / f"campaign-{letter}.csv"
    if not path.exists():
        pytest.skip("the campaigns that come beside this checkout are not there")
    assert_round_trip(read_log(path), tmp_path / "again.csv")


def test_numbers_are_written_as_people_would(sheet, read, tmp_path):
    log = read(sheet)
    write_log(log.rows, tmp_path / "again.csv")
    with open(tmp_path / "again.csv", encoding="utf-8", newline="") as stream:
        written = list(csv.DictReader(stream))
    for column in (
        *("q1_deg", "q2_deg", "theta_deg", "psi_deg", "temperature_C", "step_period_ms", "pressure_hPa"),
    ):
        moving = [f"q{row['joint']}_" in column for row in written]
        shown = ["" if own else row[column] for own, row in zip(moving, written, strict=True)]
        original = [sheet.get(row, column) for row in range(6)]
        assert shown == ["" if own else cell for own, cell in zip(moving, original, strict=True)]


def test_a_folder_that_is_not_there_is_told(sheet, read, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_log(read(sheet), tmp_path / "nowhere" / "again.csv")
