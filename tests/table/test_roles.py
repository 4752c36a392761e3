"""What a table has to be like: every fault in one message, with its column and row."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit._format import typeset_text
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
    bad.loc[3, "vel"] = "fast"
    said = faults(bad, position="q")
    assert "row 4, column vel, value 'fast': is no finite number; correct it, or leave out its row" in said
    assert sum("column q" in one for one in said) == 4  # three cells, and how many more
    assert "2 more cells" in said[-1]


def test_a_column_of_texts_in_the_place_of_numbers_is_told_once(rows):
    (said,) = faults(rows.assign(vel="fast"))
    assert said.startswith("column vel, value 'fast': is a column of texts, and used as one of numbers; ")


@pytest.mark.parametrize(
    ("change", "roles", "message"),
    [
        (lambda rows: rows.iloc[:0], {}, "the table has no rows"),
        (lambda rows: pd.concat([rows, rows["vel"]], axis=1), {}, "stands more than once"),
        (lambda rows: rows.assign(way=list("abc") * 20), {"direction": "way"}, "two values"),
        (lambda rows: rows.assign(run=None), {"session": "run"}, "column run: is empty in every row"),
        (lambda rows: rows.assign(way=[0, 1, 2, 3] * 15), {"direction": "way"}, "this column has 0, 1, 2, 3"),
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
        ("ragged.csv", "a,b\n1,2\n3\n", "line 3, value '3': has 1 cell where the header has 2"),
        ("twice.csv", "a,a\n1,2\n", "stands more than once"),
    ):
        path = tmp_path / name
        path.write_text(content)
        assert message in faults(path, "a ~ k*b")[0]


@pytest.mark.slow
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


TIMES = pd.date_range("2024-01-20 22:00", periods=60, freq="30min")


@pytest.mark.parametrize(
    "form",
    [
        *("%d.%m.%Y %H:%M", "%d.%m.%y %H:%M:%S", "%d/%m/%Y %H:%M", "%d-%m-%Y %H:%M", "%m/%d/%Y %I:%M %p"),
        *("%H:%M:%S", "%I:%M:%S %p", "%Y%m%d-%H%M%S", "%Y/%m/%d %H:%M"),
    ],
)
def test_times_are_read_as_they_are_written(rows, form):
    prepared = prepare_rows(rows.assign(when=TIMES.strftime(form)), TableRoles(time="when"))
    np.testing.assert_allclose(prepared["session_seconds"], 1800.0 * np.arange(60))


def test_durations_are_times(rows):
    when = pd.to_timedelta(rows.index * 0.5, unit="s")
    prepared = prepare_rows(rows.assign(when=when), TableRoles(time="when"))
    np.testing.assert_allclose(prepared["session_seconds"], 0.5 * np.arange(60))


def test_a_date_that_may_be_read_in_two_ways_is_refused(rows):
    days = pd.date_range("2024-01-01", periods=60, freq="2h").strftime("%d/%m/%Y %H:%M")
    said = faults(rows.assign(when=days), time="when")
    assert said == [
        "column when, value '01/01/2024 00:00': may be day/month or month/day, since no number of the column "
        "is above 12; write dates such as 2024-05-31"
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cells", "note"),
    [
        ([0, 1], "In the column way, 1 is + and 0 is -."),
        ([-1, 0], "In the column way, 0 is + and -1 is -."),
        (["out", "back"], "In the column way, out is + and back is -."),
    ],
)
def test_the_answer_says_which_way_is_which(rows, cells, note):
    signed, words = (
        ssf.diagnose_table(rows.assign(way=pair * 30), LAW, direction="way", gain=False)
        for pair in ([1, -1] if "out" in cells else [-1, 1], cells)
    )
    assert words.table.notes == (note,)
    assert typeset_text(note) in " ".join(str(words).split())
    assert not signed.table.notes
    assert words.p_value == signed.p_value


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "law", "is_guess"),
    [
        ("when", LAW, True),
        ("when (s)", LAW, False),
        ("when_min", LAW, False),
        ("when", ssf.Law(LAW, units={"when": "days"}), False),
    ],
)
def test_the_answer_says_that_times_without_a_unit_count_as_seconds(rows, name, law, is_guess):
    timed = rows.assign(**{name: 0.5 * np.arange(60)})
    found = ssf.diagnose_table(timed, law, time=name, generic_causes=(), gain=False)
    note = "The times in when count as seconds, as neither the column's name nor the law gives a unit."
    assert found.table.notes == (note,) * is_guess


@pytest.mark.parametrize(
    ("times", "unit"),
    [
        (1959.0 + np.arange(60) / 12, "years"),
        (np.round(1959.0 + np.arange(60) / 12, 3), "years"),
        (1801.25 + np.arange(60) / 4, "years"),
        (1959.0 + np.arange(60), "s"),
        (np.arange(60) / 12, "s"),
        (1959.0 + np.arange(60) / 10, "s"),
    ],
)
def test_months_and_quarters_of_calendar_years_are_years(rows, times, unit):
    found = ssf.diagnose_table(rows.assign(when=times), LAW, time="when", generic_causes=(), gain=False)
    assert found.table.time_unit == unit
    assert ("count as years" in found.table.notes[0]) == (unit == "years")


def test_directions_are_signs_or_two_values():
    for cells, signs in (
        ([0, 1, 1], [-1, 1, 1]),
        ([2.0, 1.0, 1.0], [1, -1, -1]),
        (["fwd", "rev", "fwd"], [1, -1, 1]),
        (["rev", "fwd", "fwd"], [-1, 1, 1]),
        (["left", "right", "left"], [-1, 1, -1]),
        (["out", "in", "in"], [1, -1, -1]),
        ([-2.0, 0.0, 0.1], [-1, 0, 1]),
        (["down", "up", "up"], [-1, 1, 1]),
        ([False, True, True], [-1, 1, 1]),
    ):
        column = pd.Series(cells)
        np.testing.assert_array_equal(direction_sign({"way": column}, "way", direction_labels(column)), signs)
