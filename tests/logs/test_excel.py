"""Logs in Excel workbooks: read as they are, and faults told by sheet and cell."""

from datetime import datetime

import openpyxl
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log


def as_cell(column: str, text: str):
    """What a person's spreadsheet holds: numbers and dates, not text."""
    if text and column == "time":
        return datetime.fromisoformat(text)
    if column in ("session", "note", "direction", "status"):
        return text or None
    return float(text) if text else None


@pytest.fixture
def save(tmp_path):
    """Write a workbook with a sheet `Log` that begins in cell B3, and perhaps others."""

    def write(sheet, *, others=(), cell=as_cell):
        book = openpyxl.Workbook()
        book.active.title = "Log"
        for place, rows in enumerate([sheet.header, *sheet.rows]):
            for number, (column, text) in enumerate(zip(sheet.header, rows, strict=True)):
                value = text if place == 0 else cell(column, text)
                book.active.cell(place + 3, number + 2, value)
        for name in others:
            book.create_sheet(name)["A1"] = "nothing"
        path = tmp_path / "day.xlsx"
        book.save(path)
        return path

    return write


def refusals(path, **options) -> list[str]:
    with pytest.raises(InputError) as refused:
        read_log(path, **options)
    return [str(issue).removeprefix(f"{path}, ") for issue in refused.value.problems]


@pytest.mark.parametrize("cell", [as_cell, lambda column, text: text or None])
def test_a_workbook_of_numbers_and_dates_or_of_text_is_the_same_log(sheet, read, save, cell):
    path = save(sheet, cell=cell)
    log = read_log(path)
    pd.testing.assert_frame_equal(log.rows, read(sheet).rows)
    assert log.notes == ()
    assert log.sources[0][0] == str(path)


def test_sessions_that_excel_takes_for_dates_and_numbers_are_their_text(sheet, save):
    def cell(column, text):
        if column == "session":
            return datetime(2012, 3, 5) if text == "monday" else 6
        return as_cell(column, text)

    assert read_log(save(sheet, cell=cell)).sessions == ("2012-03-05", "6")


def test_faults_are_told_by_sheet_and_cell(sheet, save):
    sheet.set(1, "q2_deg", "abc")
    sheet.set(3, "steps", "-5")
    sheet.rename("theta_deg", "theta")
    path = save(sheet, cell=lambda column, text: text or None)
    assert refusals(path) == [
        "sheet 'Log', cell J3, column theta: has no unit; write theta_deg or theta_rad",
        "sheet 'Log', cell H5, column q2_deg, value 'abc': is no number; write digits and a decimal point, "
        "such as 12.5",
        "sheet 'Log', cell F7, column steps, value '-5': is no positive integer; write the steps driven, "
        "such as 12540",
    ]


def test_doubles_and_shared_faults_have_their_rows(sheet, save):
    sheet.rows.append(list(sheet.rows[1]))
    (double,) = refusals(save(sheet))
    assert double.startswith("sheet 'Log', cell C10, column time")
    assert "of row 5 of sheet 'Log' of " in double
    for row in range(7):
        sheet.set(row, "psi_deg", "level")
    (shared, _) = refusals(save(sheet, cell=lambda column, text: text or None))
    assert shared.startswith(
        "column psi_deg: 7 of 7 values are faulty, the first one in sheet 'Log', cell K4"
    )


def test_a_sheet_is_chosen_by_its_name(sheet, save):
    path = save(sheet, others=("Notes", "Plan"))
    (note,) = read_log(path).notes
    assert note == f"{path}: sheet 'Log' was read, and not 'Notes' and 'Plan'"
    assert len(read_log(path, sheet="Log")) == 6
    (none,) = refusals(path, sheet="Log 2")
    assert none == f"{path}: has no sheet 'Log 2', but 'Log', 'Notes' and 'Plan'; name one of these"
    (empty,) = refusals(path, sheet="Plan")
    assert "sheet 'Plan' has a header and no rows" in empty


def test_a_first_sheet_that_is_no_log_names_the_others(sheet, save):
    path = save(sheet, others=("Cover",))
    book = openpyxl.load_workbook(path)
    book.move_sheet("Cover", -1)
    book["Cover"]["A2"] = "calibration of March"
    book.save(path)
    (told,) = refusals(path)
    assert told.endswith("sheet 'Cover' has no column of a log; name another one, 'Log', with --sheet")
    assert len(read_log(path, sheet="Log")) == 6


def test_a_sheet_of_a_csv_file_is_refused(sheet, tmp_path):
    path = tmp_path / "day.csv"
    path.write_text(sheet.text(), encoding="utf-8")
    assert refusals(path, sheet="Log") == [
        "sheet, value 'Log': names a sheet, and no file is an Excel workbook; leave it out"
    ]


def test_decimal_commas_in_text_are_read_and_noted_or_refused_with_points(sheet, read, save):
    expected = read(sheet).rows
    path = save(
        sheet, cell=lambda column, text: as_cell(column, text) if column == "time" else text.replace(".", ",")
    )
    log = read_log(path)
    pd.testing.assert_frame_equal(
        log.rows.drop(columns="covariate:pressure_hPa"), expected.drop(columns="covariate:pressure_hPa")
    )
    assert "decimal commas" in log.notes[0]


def test_a_workbook_is_known_by_its_content_in_a_folder_and_selected_by_dates(sheet, save, tmp_path):
    save(sheet).rename(tmp_path / "day.csv")
    log = read_log(tmp_path, since="2012-03-06")
    assert log.sessions == ("tuesday",)
    assert log.rows["steps"].tolist() == [9900, 6270]


def test_a_damaged_workbook_is_one_message(sheet, save, tmp_path):
    path = save(sheet)
    path.write_bytes(path.read_bytes()[:-300])
    (told,) = refusals(path)
    assert "is no Excel workbook that can be read" in told


def test_rows_and_unnamed_columns_of_spaces_alone_do_not_matter(sheet, read, save):
    expected = read(sheet).rows
    sheet.rows.insert(2, [" "] * len(sheet.header))
    sheet.add(" ", [""] * len(sheet.rows))
    path = save(sheet, cell=lambda column, text: text or None)
    pd.testing.assert_frame_equal(read_log(path).rows, expected)
