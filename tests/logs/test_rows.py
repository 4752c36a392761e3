"""Rows that no reader has checked are refused at the log's door, all faults at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.errors import InputError, check_count, check_rate, check_workers
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.logs import read_log
from tests.hidden.generate import hide


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("rows") / "log.csv"
    hide("session", seed=1).write(path)
    return read_log(path)


@pytest.mark.parametrize(
    ("column", "value", "rule"),
    [
        ("steps", np.nan, "finite number"),
        ("steps", 0, "above 0"),
        ("steps", -3, "above 0"),
        ("theta", np.inf, "finite number"),
        ("joint", 7, "1, 2 or 3"),
        ("direction", "x", r"\+ or -"),
    ],
)
def test_a_frame_that_cannot_be_computed_with_is_no_log(log, column, value, rule):
    rows = log.rows.astype({column: object if column in ("joint", "direction") else float})
    rows.iloc[[3, 9], rows.columns.get_loc(column)] = value
    with pytest.raises(InputError, match=rf"column {column}, .*{rule} in rows 3 and 9"):
        replace(log, rows=rows)


def test_every_fault_is_told_at_once(log):
    rows = log.rows.astype({"steps": float})
    rows.iloc[3, rows.columns.get_loc("steps")] = np.nan
    rows.iloc[5:15, rows.columns.get_loc("psi")] = np.nan
    with pytest.raises(InputError) as refused:
        replace(log, rows=rows)
    assert [issue.column for issue in refused.value.problems] == ["steps", "psi"]
    assert "rows 5, 6, 7, 8, 9 and 5 more" in str(refused.value)


def test_what_is_excluded_may_be_anything(log):
    rows = log.rows.astype({"steps": float})
    rows.loc[3, ["steps", "status"]] = [np.nan, "excluded"]
    assert len(replace(log, rows=rows).usable) == len(log) - 1


@pytest.mark.parametrize("compute", [diagnose, fit_least_squares])
def test_rows_that_were_changed_after_reading_are_refused(log, compute):
    changed = replace(log, rows=log.rows.copy())
    changed.rows.loc[4, "steps"] = -5
    with pytest.raises(InputError, match="above 0 in row 4"):
        compute(changed)


def test_a_missing_column_is_named(log):
    with pytest.raises(InputError, match="lack the columns q2 and psi"):
        replace(log, rows=log.rows.drop(columns=["psi", "q2"]))


@pytest.mark.parametrize("alpha", [0, 1, -0.1, 2, np.nan, None, "0.01", True])
def test_a_false_alarm_rate_lies_between_0_and_1(log, alpha):
    with pytest.raises(InputError, match="alpha"):
        diagnose(log, alpha=alpha)
    with pytest.raises(InputError, match="rate"):
        check_rate("rate", alpha)


@pytest.mark.parametrize("seed", [-1, 0.5, None, True])
def test_a_seed_is_a_whole_number(log, seed):
    with pytest.raises(InputError, match="seed"):
        diagnose(log, seed=seed)
    with pytest.raises(InputError, match="count"):
        check_count("count", seed)


def test_workers_are_all_cores_or_some():
    check_workers(-1)
    check_workers(3)
    for wrong in (0, -2, 1.5):
        with pytest.raises(InputError, match="workers"):
            check_workers(wrong)
