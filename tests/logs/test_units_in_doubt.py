"""Columns that look as if they were in another unit than they say: a warning, and nothing is converted."""

import warnings

import numpy as np
import pytest

from stickslip_fit.logs._units import TURNS, look_like_radians


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
