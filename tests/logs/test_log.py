"""A Log describes itself: sessions, joints, configurations, replicates, and all of it in words."""

import math
from dataclasses import replace

import pandas as pd
import pytest


@pytest.fixture
def replicated(sheet):
    """Joint 3 at one configuration: three times +, twice -, one of them interrupted; and one more session."""
    base = sheet.rows[0]
    direction, status = sheet.header.index("direction"), sheet.header.index("status")
    sheet.rows = []
    for minute, (way, state) in enumerate(
        [("+", ""), ("-", ""), ("+", "ok"), ("-", "interrupted"), ("+", ""), ("-", "")]
    ):
        row = list(base)
        row[1] = f"2012-03-05T09:{minute:02d}:00"
        row[direction], row[status] = way, state
        sheet.rows.append(row)
    other = list(base)
    other[0], other[1] = "tuesday", "2012-03-06T09:00:00"
    part = list(other)
    part[1] = "2012-03-06T09:10:00"
    part[sheet.header.index("from_mm")], part[sheet.header.index("to_mm")] = "6", "12"
    sheet.rows += [other, part]
    return sheet


def test_configurations_count_usable_traverses_of_each_direction(replicated, read):
    found = read(replicated).configurations()
    assert list(found["session"]) == ["monday", "tuesday", "tuesday"]
    assert list(found["+"]) == [3, 1, 1]
    assert list(found["-"]) == [2, 0, 0]
    # Two repeat the first +, one repeats the first -.
    assert list(found["replicates"]) == [3, 0, 0]
    assert list(found["low"]) == [0.0, 0.0, 0.006]
    assert list(found["high"]) == [0.012, 0.012, 0.012]
    assert found["q3"].isna().all()
    assert found["q2"].tolist() == pytest.approx([-math.pi / 2] * 3)


def test_one_configuration_in_two_units_is_one(replicated, read):
    replicated.rename("q2_deg", "q2_rad")
    for row, value in enumerate(
        ["-1.5707963267948966", "-1.57079632679489", "-1.5707963267949"] * 2 + ["0", "0"]
    ):
        replicated.set(row, "q2_rad", value)
    assert len(read(replicated).configurations()) == 3


def test_a_log_knows_its_sessions_joints_and_usable_rows(sheet, read):
    log = read(sheet)
    assert len(log) == 6
    assert log.sessions == ("monday", "tuesday")
    assert log.joints == (1, 2, 3)
    assert list(log.usable["joint"]) == [3, 3, 2, 3]
    assert list(log.usable.index) == [0, 1, 2, 3]
    assert list(log.usable["steps_before"]) == [0, 12540, 0, 25745]


def test_the_summary_says_what_a_person_wants_to_know(replicated, read):
    replicated.set(7, "note", "x")
    replicated.rename("pressure_hPa", "Humidity_pct")
    log = read(replicated)
    text = str(log.summary())
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert lines[0].startswith("8 traverses in 2 sessions (2012-03-05")
    assert log.sha256[:12] in text
    assert "Not fitted, but part of the history: 1 interrupted traverse" in " ".join(lines)
    # Driven in + and -, interrupted, excluded.
    assert "monday 2012-03-05 09:00 2012-03-05 09:05 3 3 1 0" in lines
    assert "tuesday" in text
    assert {"traverses 7", "over the full range 6", "configurations 2", "replicates 3"} <= {*lines}
    assert {"q2 (°) −90", "q3 (mm) moves", "psi (°) 0"} <= {*lines}
    assert "temperature (°C) 8 of 8 21.5" in lines
    assert "covariate:Humidity_pct 8 of 8 990.25" in lines
    assert any("Humidity_pct" in note for note in log.notes)
    assert all(note in " ".join(text.split()) for note in log.notes)
    assert str(log) == text


def test_a_log_of_thousands_of_sessions_is_summed_up_in_a_screenful(sheet, read):
    row = sheet.rows[0]
    sheet.rows = [
        [f"s{k:04d}", f"{1900 + k % 100}-01-{1 + k // 100:02d}T00:00", *row[2:]] for k in range(2000)
    ]
    text = str(read(sheet).summary())
    assert "The latest 10 of 2,000 sessions." in text
    assert text.count("\n") < 40


def test_rows_cannot_lose_their_order_or_history_by_selection_of_nothing(sheet, read):
    log = read(sheet)
    empty = log.select([False] * 6)
    assert len(empty) == 0
    assert list(empty.rows.columns) == list(log.rows.columns)
    assert empty.configurations().empty
    pd.testing.assert_frame_equal(log.select([True] * 6).rows, log.rows)


@pytest.mark.slow
def test_a_log_that_was_changed_after_reading_does_not_keep_the_hash_of_its_file(sheet, read):
    log = read(sheet)
    of_file, usable = log.sha256, log.rows["status"] == "ok"
    assert of_file == log.file_sha256
    kept = log.select(usable), log.exclude([0]), log.exclude([0]).select([True, False] * 3)
    assert [part.sha256 for part in kept] == [of_file] * 3
    replaced = replace(log, rows=log.rows.assign(steps=log.rows["steps"] + 1))
    dropped = replace(log, rows=log.rows.iloc[1:])
    changed = [replaced, dropped, replaced.select(usable), replaced.exclude([0])]
    log.rows.loc[0, "steps"] += 5
    changed += [log, log.select(usable)]
    hashes = [each.sha256 for each in changed]
    assert of_file not in hashes
    assert len(set(hashes)) == len(hashes)
    assert all("changed after reading" in str(each) for each in changed)
    log.rows.loc[0, "steps"] -= 5
    assert log.sha256 == of_file


@pytest.mark.parametrize(
    "change",
    [
        lambda rows: rows.assign(q3=rows["q3"] + 1e-4),
        lambda rows: rows.assign(note="x"),
        lambda rows: rows.assign(own=[[1]] * len(rows)),
        lambda rows: rows[::-1],
        lambda rows: rows.iloc[:0],
    ],
)
def test_every_kind_of_change_is_seen(sheet, read, change):
    log = read(sheet)
    changed = replace(log, rows=change(log.rows))
    assert changed.is_changed
    assert changed.sha256 != log.sha256
