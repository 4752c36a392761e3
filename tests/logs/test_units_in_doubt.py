"""Columns that look as if they were in another unit than they say: a warning, and nothing is converted."""

import warnings

import numpy as np
import pytest

from stickslip_fit.logs import read_log
from stickslip_fit.logs._units import TURNS, look_like_radians
from tests.hidden.generate import hide


@pytest.mark.parametrize(
    ("column", "values", "said"),
    [
        (
            "q2_deg",
            ["-1.5708", "-1.5708", "", "-1.5708", "", "-0.5236"],
            "column q2_deg: the values look like radians",
        ),
        ("theta_deg", ["0", "0", "-0.5236", "1.5708", "0", "0"], "name the column theta_rad"),
        ("q3_mm", ["", "", "0.006", "0", "0.012", ""], "column q3_mm: the values look like metres"),
    ],
)
def test_a_column_in_another_unit_is_a_warning_and_is_read_as_it_says(sheet, read, column, values, said):
    for row, value in enumerate(values):
        sheet.set(row, column, value)
    with pytest.warns(UserWarning, match=said):
        log = read(sheet)
    assert any(said in note for note in log.notes)
    name, unit = column.split("_")
    expected = np.array([float(value or "nan") for value in values]) * {"deg": np.pi / 180, "mm": 1e-3}[unit]
    np.testing.assert_allclose(log.rows[name], expected)


@pytest.mark.parametrize(
    ("convert", "said"),
    [
        (lambda celsius: 1.8 * celsius + 32.0, "degrees Fahrenheit"),
        (lambda celsius: celsius + 273.15, "kelvins"),
        (lambda celsius: celsius + 7.0, ""),  # another season
    ],
    ids=["Fahrenheit", "kelvin", "warm"],
)
def test_a_session_whose_temperatures_are_in_another_unit_is_a_warning(tmp_path, convert, said):
    table = hide("thesis", seed=1).table
    last = table["session"] == table["session"].iloc[-1]
    table["temperature_C"] = 21.0 + np.random.default_rng(1).normal(0, 0.5, len(table)).round(2)
    table.loc[last, "temperature_C"] = convert(table.loc[last, "temperature_C"]).round(2)
    table.to_csv(tmp_path / "log.csv", index=False)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        log = read_log(tmp_path / "log.csv")
    told = [note for note in log.notes if "the values look like" in note]
    assert [str(one.message) for one in caught] == told
    assert len(told) == bool(said)
    if said:
        assert said in told[0]
        assert str(table["session"].iloc[-1]) in told[0]


@pytest.mark.parametrize("values", [["0.5", "1", "", "2.25"], ["3", "", "", "0"], ["0.12", "", "", "0.13"]])
def test_small_angles_in_degrees_are_none(sheet, read, values):
    for row, value in enumerate(values):
        sheet.set(row, "theta_deg", value or "0")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read(sheet).notes == ()


def test_angles_that_were_measured_in_radians_are_seen_and_small_tilts_are_not():
    random, elbow = np.random.default_rng(1), (-3.665, 0.524)
    assert look_like_radians(random.uniform(-3.6, 0.5, 30).round(4), elbow)
    assert not look_like_radians(random.uniform(-210, 30, 30).round(4), elbow)
    assert not look_like_radians(random.normal(0, 0.5, 30).round(4), elbow)
    alarms = [look_like_radians(random.normal(0, 0.5, 8).round(3), TURNS) for _ in range(2000)]
    assert np.mean(alarms) < 1e-3
