"""CSV as it comes: encodings, line ends, separators, quotation marks, and lines that count true."""

from __future__ import annotations

import codecs

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


def test_a_header_with_a_quotation_mark_that_is_never_closed(sheet, problems):
    (told,) = problems('"' + sheet.text())
    assert told.line == 1
    assert "never closed" in told.message


@pytest.mark.parametrize(("separator", "called"), [(";", "semicolons"), ("\t", "tabs"), ("|", "bars")])
def test_a_spreadsheet_saved_with_another_separator_says_what_to_change(sheet, problems, separator, called):
    text = sheet.text().replace(",", separator).replace(".", ",")
    (told,) = problems(text)
    assert told.line == 1
    assert called in told.message
    assert "points" in told.message


def test_a_decimal_comma_in_quotes_is_told_with_the_number_to_write(sheet, problems):
    line = sheet.set(2, "theta_deg", '"-30,5"')
    (told,) = problems(sheet)
    assert (told.line, told.column, told.value) == (line, "theta_deg", "-30,5")
    assert "-30.5" in told.message


def test_bytes_of_another_encoding_are_told_with_line_column_and_byte(sheet, problems):
    first = sheet.set(1, "note", "caf\xe9")
    second = sheet.set(5, "note", "\xb5m")
    sheet.set(5, "steps", "x")
    found = problems(sheet.text().encode("latin-1"))
    assert [(told.line, told.column, told.value) for told in found] == [
        (first, "note", "caf\xe9"),
        (second, "note", "\xb5m"),
        (second, "steps", "x"),
    ]
    assert "0xE9" in found[0].message
    assert "UTF-8" in found[0].message


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
def test_wide_encodings_are_named(sheet, problems, encoding):
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
