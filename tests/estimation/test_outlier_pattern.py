"""Outlying counts: isolated ones, and those that have something in common."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from stickslip_fit.estimation.outlier_pattern import find_pattern

N, SESSIONS = 240, 4


@pytest.fixture(scope="module")
def rows():
    """Four sessions of a joint over twelve configurations in random order, twice in either direction."""
    random = np.random.default_rng(0)
    q2, theta = np.meshgrid(np.arange(5) * -0.5, np.arange(3) * -0.7)
    place = np.concatenate([random.permutation(np.repeat(np.arange(15), 4)) for _ in range(SESSIONS)])
    return pd.DataFrame(
        {
            "session": np.repeat([f"day {day}" for day in range(SESSIONS)], N // SESSIONS),
            "time": pd.date_range("2012-03-05", periods=N, freq="10min"),
            "direction": random.choice(["+", "-"], N),
            "q2": q2.ravel()[place],
            "theta": theta.ravel()[place],
            "psi": 0.0,
            "start": 0.0,
            "stop": 0.012,
        }
    )


def chosen(places) -> np.ndarray:
    return np.isin(np.arange(N), places)


@pytest.mark.slow
@pytest.mark.parametrize("repetitions", [30, pytest.param(2000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.nightly), 8])
def test_isolated_errors_are_seldom_called_a_pattern(rows, count, repetitions):
    random = np.random.default_rng(count)
    found = [find_pattern(rows, chosen(random.choice(N, count, replace=False))) for _ in range(repetitions)]
    alarms = sum(pattern is not None for pattern in found)
    assert alarms <= binom.ppf(0.999, repetitions, 0.01)


def test_what_outlying_counts_have_in_common_is_named(rows):
    early = [0, 1, 3, 60, 62, 63, 120, 121, 124]
    shared = np.flatnonzero((rows["q2"] == -2.0) & (rows["theta"] == 0.0))[::2]
    place = np.flatnonzero(rows["theta"] == -1.4)[::6]
    for places, kind, said in (
        (early, "begin", "come early in their session (9 of 9 in its first quarter)"),
        ([30, 31, 32, 33, 34], "time", "follow each other"),
        (np.arange(121, 180, 6), "session", "are of the same session (10 of 10)"),
        (shared, "configuration", "are of the same configuration and direction"),
        (place, "place", f"have the same theta ({len(place)} of {len(place)})"),
    ):
        pattern = find_pattern(rows, chosen(places))
        assert pattern is not None, kind
        assert (pattern.kind, pattern.text[: len(said)]) == (kind, said)
        assert pattern.p_value < 0.01


def test_one_count_is_isolated_and_two_in_a_row_are_a_pattern(rows):
    assert find_pattern(rows, chosen([5])) is None
    assert find_pattern(rows, chosen([5, 40])) is None
    assert find_pattern(rows, chosen([5, 6])).kind == "time"
    assert find_pattern(rows, chosen([59, 60])) is None  # of two sessions
    few = rows[:100]
    assert find_pattern(few, chosen([5, 6])[:100]) is None, "chance makes neighbours of two in 2 of 100 logs"


def test_without_times_nothing_is_said_of_order(rows):
    untimed = rows.assign(time=pd.NaT)
    assert find_pattern(untimed, chosen([5, 6])) is None
    assert find_pattern(untimed, chosen([30, 31, 32, 33])) is None
