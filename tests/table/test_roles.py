"""What a table has to be like: every fault in one message, with its column and row."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles, prepare_rows
from stickslip_fit.causes.roles import direction_labels, direction_sign
from tests.table.signals import LAW, signal


@pytest.fixture(scope="module")
def rows():
    return signal(np.random.default_rng(0), "white", 2, 30)


def faults(frame, law=LAW, **roles) -> list[str]:
    with pytest.raises(ssf.InputError) as caught:
        ssf.diagnose_table(frame, law, gain=False, **roles)
    return list(map(str, caught.value.problems))


def test_every_unknown_column_is_named_with_what_is_similar(rows):
    said = faults(rows, session="rum", time="tt", position="place")
    assert len(said) == 3
    assert "did you mean run?" in said[0]
    assert "did you mean t?" in said[1]
    assert "its columns are run, t, q" in said[2]


def test_cells_that_are_no_numbers_are_named_with_their_rows(rows):
    bad = rows.assign(vel=rows["vel"].astype(object), q=np.where(np.arange(60) < 5, np.inf, rows["q"]))
    bad.loc[3, "vel"], bad.loc[7, "acc"] = "fast", np.nan
    said = faults(bad, position="q")
    assert "column vel, value 'fast': row 4 is no finite number; correct it, or leave out its row" in said
    assert any(one.startswith("column acc, value 'nan': row 8") for one in said)
    assert sum("column q" in one for one in said) == 4  # three cells, and how many more
    assert "2 more cells" in said[-1]


@pytest.mark.parametrize(
    ("change", "roles", "message"),
    [
        (lambda rows: rows.iloc[:0], {}, "the table has no rows"),
        (lambda rows: pd.concat([rows, rows["vel"]], axis=1), {}, "stands more than once"),
        (lambda rows: rows.assign(way=list("abc") * 20), {"direction": "way"}, "two values"),
        (lambda rows: rows.assign(run=None), {"session": "run"}, "row 1 is empty"),
        (lambda rows: rows.assign(t="noon"), {"time": "t"}, "is no time"),
        (lambda rows: "no-such-file.csv", {}, "cannot be read"),
        (lambda rows: 3, {}, "a table is a DataFrame or the path of a file, not int"),
        (lambda rows: rows, {"time": 3}, "time names a column"),
    ],
)
def test_a_table_that_cannot_be_used_has_one_clear_message(rows, change, roles, message):
    assert message in "\n".join(faults(change(rows), **roles))


def test_a_column_that_would_be_overwritten_has_to_be_renamed(rows):
    said = faults(rows.rename(columns={"vel": "joint"}), LAW.replace("vel", "joint"))
    assert "rename it" in said[0]


def test_files_that_are_no_tables(tmp_path):
    for name, content, message in (
        ("empty.csv", "", "is empty"),
        ("ragged.csv", "a,b\n1,2\n3\n", "is no table that can be read"),
        ("twice.csv", "a,a\n1,2\n", "stands more than once"),
    ):
        path = tmp_path / name
        path.write_text(content)
        assert message in faults(path, "a ~ k*b")[0]


def test_a_file_gives_what_its_frame_gives(rows, tmp_path):
    rows.to_csv(tmp_path / "a.csv", index=False)
    rows.to_parquet(tmp_path / "a.parquet")
    answers = [
        ssf.diagnose_table(table, LAW, session="run", gain=False)
        for table in (rows, tmp_path / "a.csv", str(tmp_path / "a.parquet"))
    ]
    assert len({one.p_value for one in answers}) == 1
    assert [one.table.file.split("/")[-1] for one in answers] == ["", "a.csv", "a.parquet"]
    assert all(len(one.table.sha256) == 64 for one in answers)


def test_rows_stand_in_order_of_time_in_each_session(rows):
    prepared = prepare_rows(rows.sample(frac=1.0, random_state=3), TableRoles("run", "t"))
    assert prepared["session"].is_monotonic_increasing or prepared["session"].is_monotonic_decreasing
    for _, session in prepared.groupby("session"):
        np.testing.assert_allclose(session["session_seconds"], 0.01 * np.arange(30), atol=1e-12)


def test_times_of_day_are_seconds_and_an_order_counts_rows(rows):
    start = pd.Timestamp("2024-05-31T14:00:00")
    for cells in (
        start + pd.to_timedelta(rows["t"], unit="s"),
        rows["t"].map(lambda t: f"2024-05-31T14:00:{t:09.6f}"),
    ):
        prepared = prepare_rows(rows.assign(when=cells), TableRoles("run", "when"))
        np.testing.assert_allclose(prepared["session_seconds"], rows["t"], atol=1e-6)
    ordered = prepare_rows(rows, TableRoles("run", "order"))
    np.testing.assert_array_equal(ordered["session_seconds"], np.tile(np.arange(30.0), 2))
    assert prepare_rows(rows, TableRoles("run"))["session_seconds"].isna().all()


def test_directions_are_signs_or_two_values():
    for cells, signs in (
        ([-2.0, 0.0, 0.1], [-1, 0, 1]),
        (["down", "up", "up"], [-1, 1, 1]),
        ([False, True, True], [-1, 1, 1]),
    ):
        column = pd.Series(cells)
        np.testing.assert_array_equal(direction_sign({"way": column}, "way", direction_labels(column)), signs)
