"""Every rule about a cell: the fault's line, column and value are told, with what to do."""

import pytest

# Row and column of the good sheet, what is planted there, and a word of what must be said.
FAULTS = [
    (0, "session", "", "label"),
    (0, "session", "  ", "label"),
    (1, "time", "", "empty"),
    (1, "time", "yesterday", "2012-03-05T09:41:10"),
    (1, "time", "2012-03-05", "time of day"),
    (1, "time", "05.03.2012 09:41", "2012-03-05T09:41:10"),
    (1, "time", "2012-02-30T09:41", "2012-03-05T09:41:10"),
    (1, "time", "3012-02-03T09:41", "2012-03-05T09:41:10"),
    (1, "time", "2012-03-05T09:41:10Z", "zone"),
    (1, "time", "2012-03-05T09:41+01:00", "zone"),
    (2, "joint", "4", "prismatic"),
    (2, "joint", "0", "prismatic"),
    (2, "joint", "2.5", "prismatic"),
    (2, "joint", "two", "prismatic"),
    (2, "joint", "", "prismatic"),
    (0, "direction", "", "+ or -"),
    (0, "direction", "up", "+ or -"),
    (0, "direction", "−", "+ or -"),
    (0, "steps", "", "positive integer"),
    (0, "steps", "0", "positive integer"),
    (0, "steps", "-12540", "positive integer"),
    (0, "steps", "12540.5", "positive integer"),
    (0, "steps", "12_540", "positive integer"),
    (0, "steps", "0x30FC", "positive integer"),
    (0, "steps", "nan", "positive integer"),
    (0, "steps", "1e30", "positive integer"),
    (0, "steps", "12541", "multiple of check_every, 5"),
    (1, "steps", "13204", "multiple of check_every, 5"),
    (3, "steps", "18002", "multiple of check_every, 4"),
    (4, "steps", "9901", "multiple of check_every, 5"),
    (1, "check_every", "0", "positive integer"),
    (1, "check_every", "2.5", "positive integer"),
    (1, "check_every", "-5", "positive integer"),
    (1, "check_every", "five", "positive integer"),
    (0, "q1_deg", "", "empty"),
    (0, "q1_deg", "x", "decimal point"),
    (0, "q1_deg", "120.001", "-120 to 120 deg"),
    (0, "q1_deg", "1 0", "decimal point"),
    (0, "q2_deg", "30.0001", "-210 to 30 deg"),
    (0, "q2_deg", "-211", "-210 to 30 deg"),
    (2, "q3_mm", "-0.001", "0 to 12 mm"),
    (2, "q3_mm", "12.001", "0 to 12 mm"),
    (2, "q3_mm", "", "empty"),
    (2, "q3_mm", "infinity", "finite"),
    (3, "theta_deg", "nan", "finite"),
    (3, "theta_deg", "", "empty"),
    (3, "theta_deg", "−30", "-30"),
    (3, "psi_deg", "inf", "finite"),
    (3, "psi_deg", "1e999", "finite"),
    (3, "psi_deg", "1e308", "number"),
    (3, "psi_deg", "45°", "decimal point"),
    (2, "from_deg", "31", "-210 to 30 deg"),
    (2, "to_deg", "-210.5", "-210 to 30 deg"),
    (2, "from_deg", "zero", "decimal point"),
    (2, "to_deg", "0", "of no length"),
    (0, "from_mm", "12", "of no length"),
    (0, "to_mm", "0", "of no length"),
    (1, "from_mm", "12.5", "0 to 12 mm"),
    (2, "from_mm", "3", "rotary"),
    (2, "to_mm", "3", "to_deg"),
    (3, "to_mm", "3", "rotary"),
    (1, "from_deg", "3", "prismatic"),
    (0, "to_deg", "oops", "prismatic"),
    (1, "status", "done", "interrupted"),
    (1, "status", "OK", "interrupted"),
    (0, "theta_deg", "1e9", "-3600 to 3600 deg"),
    (0, "psi_deg", "-3601", "-3600 to 3600 deg"),
    (0, "temperature_C", "-273.15", "-273.149 to 726.85 °C"),
    (0, "temperature_C", "1e4", "-273.149 to 726.85 °C"),
    (0, "temperature_C", "warm", "decimal point"),
    (0, "temperature_C", "NA", "decimal point"),
    (0, "step_period_ms", "0", "1e-06 to 3.6e+06 ms"),
    (0, "step_period_ms", "-10", "1e-06 to 3.6e+06 ms"),
    (0, "pressure_hPa", "1e308", "-1e+100 to 1e+100"),
]


@pytest.mark.parametrize(("row", "column", "value", "said"), FAULTS)
def test_a_fault_is_told_with_its_line_column_value_and_remedy(sheet, problems, row, column, value, said):
    line = sheet.set(row, column, value)
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (line, column, value)
    assert said in told.message


def test_a_direction_that_disagrees_with_from_and_to_is_told(sheet, problems):
    line = sheet.set(2, "direction", "+")
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (line, "direction", "+")
    assert "from_deg and to_deg: 0 to -60 deg" in told.message


def test_an_empty_end_is_the_range_s_when_the_direction_is_judged(sheet, problems):
    sheet.set(0, "direction", "-")
    sheet.set(0, "from_mm", "0.5")
    sheet.set(0, "to_mm", "6")
    sheet.set(5, "direction", "-")
    sheet.set(5, "from_mm", "")
    sheet.set(5, "to_mm", "6")
    (told,) = problems(sheet)
    assert (told.line, told.column) == (2, "direction")


def test_a_cell_that_cannot_be_read_is_not_taken_for_an_empty_one(sheet, problems):
    every = sheet.set(2, "check_every", "one")
    begins = sheet.set(5, "from_mm", "zero")
    # The range's end in the place of `zero` would make this a traverse of no length.
    sheet.set(5, "to_mm", "0")
    told = [(problem.line, problem.column, problem.value) for problem in problems(sheet)]
    assert told == [(every, "check_every", "one"), (begins, "from_mm", "zero")]


def test_from_equal_to_to_is_told_whichever_unit_they_are_in(sheet, problems):
    sheet.rename("to_deg", "to_rad")
    for row in range(6):
        sheet.set(row, "to_rad", "")
    sheet.set(2, "from_deg", "-90")
    line = sheet.set(2, "to_rad", "-1.5707963267948966")
    sheet.set(4, "from_deg", "-60")
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (line, "to_rad", "-1.5707963267948966")


def test_the_moving_joint_s_own_cell_is_ignored_whatever_it_holds(sheet, read):
    expected = read(sheet).rows
    for row, junk in ((0, "moving"), (1, "999"), (2, "nan"), (3, "1,5"), (4, "--"), (5, "-")):
        sheet.set(
            row,
            f"q{sheet.get(row, 'joint')}_{'mm' if sheet.get(row, 'joint') == '3' else 'deg'}",
            f'"{junk}"',
        )
    rows = read(sheet).rows
    assert rows.equals(expected)
    assert all(rows.loc[rows["joint"] == joint, f"q{joint}"].isna().all() for joint in (1, 2, 3))


def test_a_value_at_the_end_of_the_range_is_inside_it_in_every_unit(sheet, read):
    for column, name, row, value in (
        ("q1_deg", "q1_rad", 2, "-2.0943951023931957"),
        ("q2_deg", "q2_rad", 0, "-3.6651914291880923"),
        ("q3_mm", "q3_um", 4, "12000.000000000002"),
    ):
        for each in range(6):
            sheet.set(each, column, "0" if sheet.get(each, column) else "")
        sheet.rename(column, name)
        sheet.set(row, name, value)
    assert len(read(sheet)) == 6


def test_all_faults_of_a_file_are_told_together_in_the_order_of_lines_and_columns(sheet, problems):
    planted = [
        (0, "steps", "many"),
        (0, "theta_deg", ""),
        (1, "time", "noon"),
        (2, "q3_mm", "13"),
        (3, "status", "broken"),
        (5, "direction", "out"),
        (5, "temperature_C", "-300"),
    ]
    for row, column, value in planted:
        sheet.set(row, column, value)
    told = [(problem.line, problem.column, problem.value) for problem in problems(sheet)]
    assert told == [(row + 2, column, value) for row, column, value in planted]


def test_rows_that_are_never_fitted_are_checked_all_the_same(sheet, problems):
    interrupted = sheet.set(3, "q2_deg", "95")
    excluded = sheet.set(4, "q3_mm", "nowhere")
    assert [problem.line for problem in problems(sheet)] == [interrupted, excluded]


@pytest.fixture
def long_sheet(sheet):
    """Three thousand good traverses."""
    row = sheet.rows[0]
    sheet.rows = [
        [*row[:1], f"2012-03-05T09:{minute:02d}:{second:02d}", *row[2:]]
        for minute in range(50)
        for second in range(60)
    ]
    return sheet


def test_many_faults_of_one_kind_are_shown_twenty_times_and_counted(long_sheet, problems):
    for row in range(0, 3000, 20):
        long_sheet.set(row, "steps", "12x")
    told = problems(long_sheet)
    assert len(told) == 21
    assert [problem.line for problem in told[:20]] == list(range(2, 402, 20))
    assert "130 more" in told[-1].message
    assert told[-1].column == "steps"


@pytest.mark.parametrize("every", [1, 5])
def test_a_fault_that_much_of_a_column_shares_is_told_once(long_sheet, problems, every):
    for row in range(0, 3000, every):
        long_sheet.set(row, "q2_deg", "abc")
    (told,) = problems(long_sheet)
    count = f"{3000 // every:,} of 3,000 values are faulty, the first one in line 2: 'abc' is no number"
    assert count in str(told)
    assert "column q2_deg" in str(told)


def test_rows_of_another_width_are_told_once(long_sheet, problems):
    text = long_sheet.text().replace("990.25", "990,25")
    (told,) = problems(text)
    assert "3,000 of 3,000 rows are faulty, the first one in line 2" in told.message
    assert "has 21 cells where the header has 20; write decimals with a point, or" in told.message


def test_a_double_is_told_with_both_lines(sheet, problems):
    sheet.rows.append(list(sheet.rows[1]))
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (8, "time", "2012-03-05T09:05:00")
    assert "line 3 of" in told.message


@pytest.mark.parametrize(
    ("column", "other"), [("session", "sunday"), ("joint", "2"), ("time", "2012-03-05T09:05:01")]
)
def test_rows_that_differ_in_session_joint_or_time_are_no_doubles(sheet, read, column, other):
    double = list(sheet.rows[0])
    double[sheet.header.index("q3_mm")] = "0"
    sheet.rows.append(double)
    sheet.set(6, column, other)
    assert len(read(sheet)) == 7


def test_a_zone_on_some_rows_only_is_told_with_a_row_of_each_kind(sheet, problems):
    for row in range(6):
        if row != 4:
            sheet.set(row, "time", sheet.get(row, "time") + "+01:00")
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (6, "time", "2012-03-06T08:00:00")
    assert "line 2 of" in told.message
