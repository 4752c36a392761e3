"""Empty cells of columns that change slowly are filled in between readings; others stay empty."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.estimation._gaps import fill_gaps


def make_rows(values, name="temperature"):
    n = len(values)
    seconds = np.cumsum(np.random.default_rng(1).uniform(50, 500, n))
    session = np.where(np.arange(n) < n // 2, "a", "b")
    return pd.DataFrame({"session": session, "session_seconds": seconds, name: values})


@pytest.mark.parametrize("name", ["temperature", "covariate:airflow"])
def test_a_line_is_filled_in_exactly_and_held_at_the_ends_of_a_session(name):
    rows = make_rows(np.zeros(40), name)
    true = 20.0 + 1e-3 * rows["session_seconds"].to_numpy()
    empty = np.isin(np.arange(40), [0, 7, 8, 33])
    filled = fill_gaps(rows.assign(**{name: np.where(empty, np.nan, true)}))[name].to_numpy()
    true[0] = true[1]
    assert filled == pytest.approx(true, abs=1e-12)


def test_what_jumps_from_traverse_to_traverse_stays_empty():
    """There the mean is nearer than the line between two readings."""
    values = np.random.default_rng(2).standard_normal(400)
    values[::9] = np.nan
    rows = make_rows(values)
    assert fill_gaps(rows) is rows


def test_a_payload_stays_empty_between_two_weighings():
    values = np.repeat([0.0, 5.0, 0.0, 5.0], 20)
    values[::7] = np.nan
    rows = make_rows(values, "payload")
    assert fill_gaps(rows) is rows


def test_a_session_without_a_reading_stays_empty():
    values = 20.0 + np.arange(60) / 10.0
    values[30:] = np.nan
    values[5] = np.nan
    filled = fill_gaps(make_rows(values))["temperature"].to_numpy()
    assert np.isfinite(filled[:30]).all()
    assert np.isnan(filled[30:]).all()
