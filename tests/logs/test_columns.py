"""The header: which column is which quantity, and what is said when that can't be known."""

import numpy as np
import pytest

REQUIRED = [
    *("session", "time", "joint", "direction", "steps"),
    *("q1_deg", "q2_deg", "q3_mm", "theta_deg", "psi_deg"),
]


@pytest.mark.parametrize("column", REQUIRED)
def test_a_missing_required_column_is_told(sheet, problems, column):
    sheet.drop(column)
    (told,) = problems(sheet)
    assert (told.line, told.column) == (1, column)
    assert "missing" in told.message


@pytest.mark.parametrize("name", ["Steps", " steps", "STEPS ", "steps."])
def test_a_required_column_almost_right_is_hinted_at(sheet, problems, name):
    sheet.rename("steps", name)
    (told,) = problems(sheet)
    assert told.column == "steps"
    assert f"found {name!r}: write steps" in told.message


def test_a_column_with_its_unit_in_brackets_is_hinted_at(sheet, problems):
    sheet.rename("theta_deg", "Theta [deg]")
    (told,) = problems(sheet)
    assert told.column == "theta_deg"
    assert "'Theta [deg]'" in told.message


@pytest.mark.parametrize(
    ("column", "name", "remedy"),
    [
        ("theta_deg", "theta", "theta_deg or theta_rad"),
        ("theta_deg", "theta_furlong", "theta_deg or theta_rad"),
        ("q3_mm", "q3_deg", "q3_mm, q3_m, q3_um or q3_nm"),
        ("q1_deg", "q1_mm", "q1_deg or q1_rad"),
        ("from_mm", "from", "from_mm"),
        ("from_mm", "from_km", "from_nm"),
        ("temperature_C", "temperature_F", "temperature_C or temperature_K"),
        ("temperature_C", "temperature_c", "temperature_C"),
        ("step_period_ms", "step_period", "step_period_ms or step_period_s"),
        ("step_period_ms", "step_period_us", "step_period_ms or step_period_s"),
        ("pressure_hPa", "humidity", "humidity_pct"),
        ("pressure_hPa", "supply_mV", "supply_V"),
        ("pressure_hPa", "payload_mg", "payload_g or payload_kg"),
    ],
)
def test_a_known_quantity_without_a_unit_of_its_own_is_told(sheet, problems, column, name, remedy):
    sheet.rename(column, name)
    (told,) = problems(sheet)
    assert (told.line, told.column) == (1, name)
    assert remedy in told.message


@pytest.mark.parametrize(
    ("first", "second"), [("q1_deg", "q1_rad"), ("from_deg", "from_rad"), ("temperature_C", "temperature_K")]
)
def test_two_columns_for_one_quantity_are_told_with_both_names(sheet, problems, first, second):
    sheet.add(second, ["0.5"] * 6)
    (told,) = problems(sheet)
    assert (told.line, told.column) == (1, second)
    assert first in told.message


def test_a_name_that_stands_twice_is_told(sheet, problems):
    sheet.add("steps", ["5"] * 6)
    sheet.add("pressure_hPa", ["990"] * 6)
    found = problems(sheet)
    assert [told.column for told in found] == ["steps", "pressure_hPa"]
    assert all("2 times" in told.message for told in found)


def test_columns_without_a_name_are_told_by_their_place(sheet, problems):
    sheet.add("", ["1"] * 6)
    sheet.add("  ", ["1"] * 6)
    assert [told.column for told in problems(sheet)] == ["number 21", "number 22"]


def test_faults_of_header_and_cells_are_told_together(sheet, problems):
    sheet.rename("theta_deg", "theta")
    sheet.drop("psi_deg")
    sheet.set(2, "q3_mm", "13")
    assert [(told.line, told.column) for told in problems(sheet)] == [
        (1, "theta"),
        (1, "psi_deg"),
        (4, "q3_mm"),
    ]


def test_columns_of_the_lab_s_own_keep_name_and_values_whatever_they_end_in(sheet, read):
    sheet.add("supply_current_A", ["1", " 2.5 ", "-3e-1", "", "+4", ".5"])
    sheet.add("operator", ["ann", "bob", "", "ann", "1", "2"])
    sheet.add("remark", [""] * 6)
    rows = read(sheet).rows
    np.testing.assert_array_equal(rows["covariate:pressure_hPa"], [990.25, 990.5, 991, 991, 992, np.nan])
    np.testing.assert_array_equal(rows["covariate:supply_current_A"], [1, 2.5, -0.3, np.nan, 4, 0.5])
    assert list(rows["text:operator"]) == ["ann", "bob", "", "ann", "1", "2"]
    assert list(rows["text:remark"]) == [""] * 6


@pytest.mark.parametrize("name", ["start", "before_load", "usable", "covariate:x", "time_s", "steps_2"])
def test_a_column_of_the_lab_s_own_never_takes_the_place_of_another(sheet, read, name):
    expected = read(sheet).rows
    sheet.add(name, ["7"] * 6)
    rows = read(sheet).rows
    assert rows.drop(columns=f"covariate:{name}").equals(expected)
    assert (rows[f"covariate:{name}"] == 7).all()


@pytest.mark.parametrize("odd", ["n/a", "nan", "inf", "1e999", "1,5"])
def test_a_column_with_a_few_odd_cells_is_text_and_a_note_says_which(sheet, read, odd):
    sheet.set(3, "pressure_hPa", f'"{odd}"')
    log = read(sheet)
    assert list(log.rows["text:pressure_hPa"]) == ["990.25", "990.5", "991", odd, "992", ""]
    (note,) = log.notes
    assert "1 of 6 cells is no number" in note
    assert repr(odd) in note
    assert "line 5 of" in note


def test_an_optional_column_almost_right_is_kept_and_noted(sheet, read):
    sheet.rename("status", "Status")
    log = read(sheet)
    assert set(log.rows["status"]) == {"ok"}
    (note,) = log.notes
    assert "'Status'" in note
    assert "status" in note
