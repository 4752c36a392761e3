"""CSV as it comes: encodings, line ends, separators, quotation marks, and lines that count true."""

import codecs
import csv

import pandas as pd
import pytest


@pytest.mark.parametrize("end", ["\r\n", "\r", "\n"])
@pytest.mark.parametrize("mark", [b"", codecs.BOM_UTF8])
def test_line_ends_and_a_byte_order_mark_change_nothing(sheet, read, end, mark):
    expected = read(sheet).rows
    pd.testing.assert_frame_equal(read(mark + sheet.text().replace("\n", end).encode()).rows, expected)


def test_empty_lines_are_skipped_and_counted(sheet, read, problems):
    lines = sheet.text().splitlines()
    spaced = "\n\r\n" + lines[0] + "\n\n" + "\r\n\r".join(lines[1:]) + "\n\n"
    pd.testing.assert_frame_equal(read(spaced).rows, read(sheet).rows)
    sheet.set(1, "steps", "x")
    lines = sheet.text().splitlines()
    (told,) = problems("\n\r\n" + lines[0] + "\n\n" + "\r\n\r".join(lines[1:]) + "\n\n")
    # Two lines before the header, one after it, one between the rows.
    assert (told.line, told.column, told.value) == (7, "steps", "x")


def test_what_a_spreadsheet_saves_around_a_table_is_left_out_with_a_note(sheet, read, problems):
    expected = read(sheet)
    assert not expected.notes

    def save() -> str:
        head, *lines = (line + ",," for line in sheet.text().splitlines())
        empty = "," * head.count(",")
        return "\n".join([head, empty, *lines[:3], f" {empty}", *lines[3:], empty, empty])

    log = read(save())
    pd.testing.assert_frame_equal(log.rows, expected.rows)
    (note,) = log.notes
    assert note.endswith("day.csv: 4 empty rows and 2 empty unnamed columns left out")
    sheet.set(4, "steps", "x")
    (told,) = problems(save())
    assert (told.line, told.column, told.value) == (8, "steps", "x")


def test_an_unnamed_column_with_a_cell_and_rows_without_any_are_told(sheet, problems):
    sheet.add("", ["", "", "", "cell", "", ""])
    (told,) = problems(sheet)
    assert (told.line, told.column) == (1, "number 21")
    (told,) = problems(",".join(sheet.header) + "\n" + 2 * ("," * 20 + "\n"))
    assert "no rows" in told.message


def test_quoted_line_ends_count_as_lines(sheet, problems):
    sheet.set(0, "note", '"one\ntwo\r\nthree\rfour, ""five"""')
    sheet.set(2, "note", '"six\n"')
    sheet.set(3, "theta_deg", "level")
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (9, "theta_deg", "level")


def test_text_is_kept_literally(sheet, read):
    notes = ['"a, ""b""\r\nc"', " NA ", '5" pipe', "null", '""', "\N{GREEK SMALL LETTER MU}m, no"]
    notes[5] = f'"{notes[5]}"'
    for row, (session, note) in enumerate(
        zip(["NA", "001", "nan", " x ", "None", "1e3"], notes, strict=True)
    ):
        sheet.set(row, "session", session)
        sheet.set(row, "note", note)
    rows = read(sheet).rows
    assert set(rows["session"]) == {"NA", "001", "nan", " x ", "None", "1e3"}
    assert list(rows["note"]) == ['a, "b"\r\nc', " NA ", '5" pipe', "null", "", "μm, no"]


@pytest.mark.parametrize("wide", ["a,b", "x" + "," * 30])
def test_a_row_of_another_width_is_told_with_its_line_and_both_widths(sheet, problems, wide):
    lines = sheet.text().splitlines()
    lines.insert(3, wide)
    (told,) = problems("\n".join(lines))
    assert (told.line, told.value) == (4, wide)
    assert f"has {wide.count(',') + 1} cells where the header has 20" in told.message


def test_rows_of_another_width_do_not_hide_other_faults(sheet, problems):
    sheet.set(4, "steps", "x")
    lines = sheet.text().splitlines()
    lines.insert(1, "too,few")
    found = problems("\n".join(lines))
    assert [(told.line, told.column) for told in found] == [(2, None), (7, "steps")]


@pytest.mark.parametrize("closing", ["", "\n", "\r\n"])
@pytest.mark.parametrize("row", [0, 3, 5])
def test_a_quotation_mark_that_is_never_closed_swallows_nothing_in_silence(sheet, problems, row, closing):
    line = sheet.set(row, "note", '"never closed')
    found = problems(sheet.text().rstrip("\n") + closing)
    assert any(told.line == line and "never closed" in told.message for told in found)


def test_what_an_open_quotation_mark_swallows_may_be_long(sheet, problems):
    line, limit = sheet.set(1, "note", '"' + "long " * 40_000), csv.field_size_limit()
    assert any(told.line == line and "never closed" in told.message for told in problems(sheet))
    assert csv.field_size_limit() == limit  # which is that of all readers of the process


def test_a_header_with_a_quotation_mark_that_is_never_closed(sheet, problems):
    (told,) = problems('"' + sheet.text())
    assert told.line == 1
    assert "never closed" in told.message


@pytest.mark.parametrize(("separator", "called"), [(";", "semicolons"), ("\t", "tabs"), ("|", "bars")])
@pytest.mark.parametrize("decimal", [".", ","])
def test_other_separators_and_decimal_commas_are_read_and_noted(sheet, read, separator, called, decimal):
    sheet.set(3, "note", "one; two")
    expected = read(sheet)
    sheet.set(3, "note", '"one; two"')
    sheet.set(2, "theta_deg", "-30.0")
    log = read(sheet.text().replace(",", separator).replace(".", decimal))
    pd.testing.assert_frame_equal(log.rows, expected.rows)
    (note,) = log.notes
    assert f"separated by {called}" in note
    assert ("decimals by commas" in note) == (decimal == ",")


def test_what_excel_writes_above_the_header_names_the_separator(sheet, read, problems):
    expected = read(sheet).rows
    pd.testing.assert_frame_equal(read("sep=;\r\n" + sheet.text().replace(",", ";")).rows, expected)
    line = sheet.set(2, "steps", "x")
    (told,) = problems("sep=;\n" + sheet.text().replace(",", ";"))
    assert told.line == line + 1


def test_decimal_commas_and_points_in_one_file_are_one_error(sheet, problems):
    sheet.set(0, "steps", "12.540")  # twelve thousand as Germans write it, among decimal commas
    sheet.set(2, "theta_deg", "-30,5")
    (told,) = problems(sheet.text().replace(",", ";").replace("-30;5", "-30,5").replace("21.5", "21,5"))
    assert (told.line, told.column, told.value) == (2, "steps", "12.540")
    assert "'21,5' in line 2, column temperature_C, a decimal comma; write all numbers in one way" in str(
        told
    )


def test_two_separators_in_a_header_are_one_error(problems):
    (told,) = problems("session,time,joint;direction;steps\n1,2,3;4;5\n")
    assert told.line == 1
    assert "commas and semicolons between the names of columns; separate all of them by one" in told.message


def test_a_decimal_comma_in_quotes_is_told_with_the_number_to_write(sheet, problems):
    line = sheet.set(2, "theta_deg", '"-30,5"')
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (line, "theta_deg", "-30,5")
    assert "-30.5" in told.message


def test_windows_1252_is_read_and_noted(sheet, read):
    sheet.set(1, "note", "caf\xe9")
    sheet.set(5, "note", "\xb5m \u2013 \u20ac")
    expected = read(sheet).rows
    log = read(sheet.text().encode("cp1252"))
    pd.testing.assert_frame_equal(log.rows, expected)
    (note,) = log.notes
    assert "not UTF-8, and was read as Windows-1252" in note


@pytest.mark.parametrize("foreign", [b"\xe9", b"\x81"])
def test_bytes_that_no_encoding_explains_are_told_by_line(sheet, problems, foreign):
    first = sheet.set(1, "note", "FOREIGN")
    sheet.set(2, "note", "5 \xb5m")  # in UTF-8, so that the other byte is damage
    (told,) = problems(sheet.text().encode().replace(b"FOREIGN", foreign))
    assert told.line == first
    assert f"0x{foreign[0]:02X} is not UTF-8" in told.message


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32"])
def test_wide_encodings_with_a_mark_are_read_and_noted(sheet, read, encoding):
    sheet.set(1, "note", "5 \xb5m")
    expected = read(sheet).rows
    log = read(sheet.text().replace(",", "\t").encode(encoding))
    pd.testing.assert_frame_equal(log.rows, expected)
    assert [encoding.upper() in note for note in log.notes] == [True, False]


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-32-be"])
def test_wide_encodings_without_a_mark_are_named(sheet, problems, encoding):
    (told,) = problems(sheet.text().encode(encoding))
    assert "UTF-8" in told.message
    assert told.line == 1


def test_a_zero_byte_is_told_with_its_line(sheet, problems):
    sheet.set(2, "note", "\0")
    (told,) = problems(sheet)
    assert (told.line, told.value) == (4, r"\x00")


@pytest.mark.parametrize("content", ["", "\n\n\r", "\ufeff", "\ufeff\n"])
def test_an_empty_file_says_so(problems, content):
    (told,) = problems(content)
    assert "empty" in told.message


@pytest.mark.parametrize("tail", ["", "\n", "\n\n\n"])
def test_a_header_alone_says_so(sheet, problems, tail):
    (told,) = problems(",".join(sheet.header) + tail)
    assert "no rows" in told.message


def test_a_note_of_many_megabytes_is_read(sheet, read):
    sheet.set(3, "note", '"' + "long,\n" * 1_500_000 + '"')
    assert len(read(sheet).rows["note"].iloc[3]) == 9_000_000


def test_spaces_around_numbers_and_words_are_accepted(sheet, read):
    expected = read(sheet).rows
    for row in range(6):
        for column in ("joint", "direction", "steps", "theta_deg", "temperature_C", "time"):
            sheet.set(row, column, f" {sheet.get(row, column)}\t")
    pd.testing.assert_frame_equal(read(sheet).rows, expected)
