"""Rows of a Log that were made or changed by hand are held to what a file may give."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_closed_form


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("steps", np.nan),
        ("steps", 0),
        ("steps", -5),
        ("steps", np.inf),
        ("steps", "many"),
        ("check_every", 0),
        ("joint", 4),
        ("direction", "up"),
        ("status", "OK"),
        ("time", pd.NaT),
        ("session", None),
        ("theta", np.nan),
        ("theta", 1e9),
        ("q1", np.nan),
        ("start", np.nan),
        ("temperature", -1.0),
        ("humidity", -5.0),
        ("payload", -0.1),
        ("covariate:pressure_hPa", np.inf),
    ],
)
def test_what_no_file_could_give_is_refused_with_column_and_row(sheet, read, column, value):
    log = read(sheet)
    rows = log.rows.astype({column: object}) if column in ("steps", "session") else log.rows.copy()
    if rows[column].dtype.kind in "iu":
        rows = rows.astype({column: float})
    rows.loc[2, column] = value
    if column == "steps" and value != "many":
        rows = rows.astype({column: float})
    with pytest.raises(InputError) as refused:
        replace(log, rows=rows)
    (issue,) = refused.value.problems
    assert issue.column == column
    assert ("in rows 0, 1, 2" if value == "many" else "in row 2;") in issue.message


def test_every_fault_is_told_at_once_and_a_missing_column_by_name(sheet, read):
    log = read(sheet)
    with pytest.raises(InputError) as refused:
        replace(log, rows=log.rows.assign(steps=0, psi=np.nan))
    assert [issue.column for issue in refused.value.problems] == ["steps", "psi"]
    assert "in rows 0, 1, 2, 3, 4 and 1 more" in str(refused.value)
    with pytest.raises(InputError, match="need the columns direction, steps"):
        replace(log, rows=log.rows.drop(columns=["steps", "direction"]))


def test_rows_changed_in_place_do_not_reach_a_fit(sheet, read):
    log = read(sheet)
    log.rows.loc[0, "theta"] = np.nan
    with pytest.raises(InputError, match="column theta, value 'nan': not allowed in row 0;"):
        fit_closed_form(log)
