"""Empty cells: which rows and columns are left out, and that the answer says so."""

import warnings

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.diagnosis._json import diagnosis_to_json

LAW, N = "y ~ a + b*x", 60


@pytest.fixture
def table():
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"t": np.arange(N) / 2, "x": rng.uniform(0, 5, N), "T": rng.standard_normal(N)})
    return frame.assign(y=2 + 0.3 * frame["x"] + 0.5 * frame["T"] + 0.1 * rng.standard_normal(N))


def diagnose(frame, law=LAW, generic_causes=(), **roles):
    """Without generic causes where only rows and notes are looked at: those take longest."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return ssf.diagnose_table(frame, law, generic_causes=generic_causes, gain=False, **roles)


def put(frame, column, *cells):
    """The table with these cells in the rows 4, 7, 10 and so on."""
    changed = frame.assign(**{column: frame[column].astype(object)})
    changed.loc[3 : 3 * len(cells) : 3, column] = cells
    return changed


def test_rows_without_a_response_are_left_out_and_named_as_in_the_table(table):
    bad = put(table, "y", np.nan, "NA", " - ", "")
    answer = diagnose(bad)
    assert answer.table.rows == N - 4
    assert "4 of 60 rows are left out, where y is empty: rows 4, 7, 10 and 13." in " ".join(
        str(answer).split()
    )
    assert diagnosis_to_json(answer)["table"]["notes"] == list(answer.table.notes)
    left = table.drop(index=[3, 6, 9, 12])
    assert answer.p_value == diagnose(left).p_value


def test_rows_of_a_fit_are_left_out_too(table):
    fit = ssf.fit_table(put(table, "x", None), LAW)
    pd.testing.assert_series_equal(
        fit.parameters["estimate"], ssf.fit_table(table.drop(index=3), LAW).parameters["estimate"]
    )


@pytest.mark.parametrize("role", ["session", "time", "direction", "position", "group"])
def test_rows_without_a_cell_of_a_role_are_left_out(table, role):
    frame = table.assign(role=np.where(np.arange(N) % 2, -1.0, 1.0)).drop(columns="T")
    answer = diagnose(put(frame, "role", np.nan), shared="all", **{role: "role"})
    assert answer.table.notes[0] == "1 of 60 rows is left out, where role is empty: row 4."
    assert answer.table.rows == N - 1


@pytest.mark.slow
def test_a_minus_is_a_value_of_a_direction_and_of_what_a_cause_acts_by(table):
    ways = table.assign(way=np.where(np.arange(N) % 2, "-", "+"))
    cause = ssf.Cause("lag", "+ k*x", "k", by="way")
    answer = diagnose(ways, direction="way", causes=[cause])
    assert answer.table.rows == N
    assert answer.table.notes == ()
    assert diagnose(put(ways, "way", ""), causes=[cause]).table.rows == N - 1


def test_sessions_keep_their_names_beside_an_empty_cell(table):
    frame = put(table.assign(run=np.repeat([1, 2], N // 2)), "run", None)
    assert ssf.fit_table(frame, LAW, session="run").sessions == ("1", "2")


def test_later_messages_count_rows_as_the_table_does(table):
    bad = put(table, "y", np.nan, "over")
    with pytest.raises(ssf.InputError, match="row 7, column y, value 'over': is no finite number"):
        diagnose(bad)
    with pytest.raises(ssf.InputError, match="no number in row 9 of the table"):
        diagnose(
            put(table, "x", np.nan).assign(y=np.where(np.arange(N) == 8, -1, 1 + table["T"] ** 2)),
            "log(y) ~ a + b*x",
        )


def test_an_effect_of_a_column_with_few_empty_cells_is_found(table):
    answer = diagnose(put(table, "T", np.nan, "nan"), generic_causes=None)
    assert answer.findings[0].cause == "covariate:T"
    assert answer.table.notes == ("2 of 60 rows are left out, where T is empty: rows 4 and 7.",)


def test_a_column_with_many_empty_cells_is_left_out_and_named(table):
    bad = put(table, "T", *[np.nan] * 7)
    answer = diagnose(bad.assign(nothing=np.nan, note=""), generic_causes=None)
    assert answer.table.rows == N
    assert answer.table.notes == ("The column T is left out: 7 cells of 60 are empty.",)
    assert answer.untestable["covariate:T"] == "7 of its cells are empty or infinite"


def test_columns_with_few_empty_cells_each_are_kept_until_a_fifth_of_the_rows_is_lost(table):
    gaps = {f"T{k}": np.where(np.arange(N) // 6 == k, np.nan, table["T"]) for k in range(3)}
    answer = diagnose(table.assign(**gaps), generic_causes=None)
    assert answer.table.rows == N - 12
    why = "6 cells of 60 are empty, and with those of other columns 18 rows would be lost."
    assert f"The column T2 is left out: {why}" in answer.table.notes


def test_an_infinite_cell_of_a_column_is_a_gap(table):
    answer = diagnose(put(table, "T", np.inf, None))
    assert answer.table.notes == ("2 of 60 rows are left out, where T is empty or infinite: rows 4 and 7.",)


def test_a_column_of_numbers_with_a_text_in_it_is_named(table):
    answer = diagnose(put(table, "T", None, "over").assign(note="good"))
    assert answer.table.notes == ("The column T is left out: 'over' in row 7 is no number.",)
    assert answer.table.rows == N


def test_empty_rows_and_columns_need_no_word(table):
    bad = table.assign(nothing=np.nan)
    bad.loc[[3, 8]] = np.nan
    answer = diagnose(bad)
    assert answer.table.notes == ()
    assert answer.table.rows == N - 2


def test_a_needed_column_that_is_empty_is_refused(table):
    with pytest.raises(ssf.InputError, match="column y: is empty in every row"):
        diagnose(table.assign(y=np.nan))


@pytest.mark.slow
def test_rows_that_are_left_out_keep_their_place_in_the_order(table):
    gap = diagnose(put(table, "y", *[np.nan] * 2), time="order")
    seconds = gap.selection.problem.rows["session_seconds"].tolist()
    assert seconds == [float(row) for row in range(N) if row not in (3, 6)]


def test_an_overflow_of_an_instrument_is_an_empty_cell(table):
    answer = diagnose(put(table, "y", 9.9e37).astype(float))
    assert answer.table.rows == N - 1
    assert "9.9e+37 in y is how instruments mark an overflow, and counts as empty." in answer.table.notes


def test_a_value_beside_which_all_others_vanish_is_refused(table):
    with pytest.raises(ssf.InputError, match=r"row 4, column y, value '1e\+30': is more than 1e\+15 times"):
        diagnose(put(table, "y", 1e30).astype(float), time="t")


def test_a_constant_response_is_refused_in_these_words(table):
    with pytest.raises(ssf.InputError, match="the response is constant: y is 3 in every row"):
        diagnose(table.assign(y=3.0), time="t")


def test_an_exact_fit_and_sessions_without_scatter_end_without_a_warning(table):
    assert (
        diagnose(table.assign(y=2 + 3 * table["x"]), generic_causes=None, time="t").verdict == "nothing wrong"
    )
    short = table.assign(s=np.repeat([f"s{k}" for k in range(25)], [2] * 15 + [3] * 10))
    assert diagnose(short, generic_causes=None, session="s").table.rows == N


@pytest.mark.slow
@pytest.mark.parametrize(("column", "mark"), [("y", -999), ("x", 9999.9), ("T", -99.0)])
def test_a_number_of_nines_far_from_all_others_counts_as_empty_and_is_named(table, column, mark):
    answer = diagnose(put(table, column, mark, mark).astype({column: float}))
    assert f"{mark:.15g} in {column}, 2 cells far from all others" in answer.table.notes[0]
    left = diagnose(table.drop(index=[3, 6]))
    assert (answer.table.rows, answer.p_value) == (N - 2, left.p_value)


@pytest.mark.parametrize(
    ("column", "values"), [("x", (999.0, 1030.0)), ("y", (99.0,)), ("T", (-998.0, -998.0))]
)
def test_what_may_have_been_measured_stays(table, column, values):
    frame = table.assign(x=table["x"] * 10 + 980.0)
    assert diagnose(put(frame, column, *values).astype({column: float})).table.rows == N


def test_a_text_in_a_row_that_is_left_out_does_not_make_its_column_one_of_texts(table):
    bad = put(put(table, "T", np.nan), "x", "over")
    assert diagnose(bad).table.rows == N - 1
