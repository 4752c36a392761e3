"""The test of a difference: as many false alarms as it says, whatever the scatter from day to day."""

import numpy as np
import pytest
from scipy.stats import binom

from stickslip_fit.changes.difference import SessionEstimates, compare_means

ALPHA = 0.01
# From day to day, as the drives of the thesis scatter; and of its most uniform ones.
UNEVEN = np.array([1.838, 1.344, 0.498, 0.625, 0.498, 0.625]) / 100
EVEN = np.full(6, 0.005)
OF_TRAVERSES = 0.0009  # of a session's step size
PARAMETERS = (("a", 0.0015, True), ("b", 0.01, False), ("c", 0.02, False))  # the day is in the first one


def estimates_of(random, scatter, old, new, change=0.0):
    """Step sizes and parameters of six drives in so many sessions; the first drive changes."""
    n = old + new
    is_new, found = np.arange(n) >= old, []
    for drive, sd in enumerate(scatter):
        day = sd * random.normal(size=n) + (change * is_new if drive == 0 else 0.0)
        size = day + OF_TRAVERSES * random.normal(size=n)
        found.append(SessionEstimates("step size", size, np.full(n, OF_TRAVERSES**2), is_new, 1.0))
        for name, error, of_day in PARAMETERS:
            values = day * of_day + error * random.normal(size=n)
            found.append(SessionEstimates(name, values, np.full(n, error**2), is_new, error))
    return found


def alarms(scatter, old, new, repetitions, change=0.0, seed=0):
    random = np.random.default_rng(seed)
    return np.mean(
        [
            any(
                one.p_adjusted < ALPHA
                for one in compare_means(estimates_of(random, scatter, old, new, change), ALPHA)
            )
            for _ in range(repetitions)
        ]
    )


@pytest.mark.parametrize(
    ("scatter", "old", "new", "repetitions"),
    [
        pytest.param(UNEVEN, 6, 2, 150, id="uneven"),
        pytest.param(EVEN, 4, 1, 150, id="even"),
        pytest.param(np.zeros(6), 3, 3, 150, id="none"),
        *(
            pytest.param(scatter, *days, 6000, marks=pytest.mark.nightly)
            for scatter in (UNEVEN, EVEN, np.zeros(6))
            for days in ((3, 3), (6, 2), (4, 1))
        ),
    ],
)
def test_where_nothing_changes_at_most_one_comparison_in_a_hundred_alarms(scatter, old, new, repetitions):
    share = alarms(scatter, old, new, repetitions)
    assert share * repetitions <= binom.ppf(0.999, repetitions, ALPHA)


@pytest.mark.parametrize("repetitions", [60, pytest.param(2000, marks=pytest.mark.nightly)])
def test_a_change_of_three_per_cent_in_three_and_three_sessions_is_found_in_four_of_five(repetitions):
    share = alarms(EVEN, 3, 3, repetitions, change=0.03)
    assert share * repetitions >= binom.ppf(0.001, repetitions, 0.8)


def test_the_intervals_hold_all_true_differences_together():
    random, held = np.random.default_rng(3), []
    for _ in range(150):
        found = compare_means(estimates_of(random, UNEVEN, 3, 3, change=0.02), ALPHA)
        true = [0.02, 0.02, *[0.0] * (len(found) - 2)]
        held.append(all(one.low <= size <= one.high for one, size in zip(found, true, strict=True)))
    assert np.sum(held) >= binom.ppf(0.001, 150, 1 - ALPHA)


def test_a_change_as_large_as_said_is_detected_as_often_as_said():
    random, found, change = np.random.default_rng(4), [], 2.68
    for _ in range(400):
        is_new = np.arange(10) >= 5
        values = random.normal(size=10) + change * is_new
        (one,) = compare_means([SessionEstimates("x", values, np.full(10, 1e-6), is_new, 1.0)], ALPHA)
        found.append((one.p_adjusted < ALPHA, one.detectable))
    hits, detectable = np.array(found).T
    assert np.sqrt(np.mean(detectable**2)) == pytest.approx(change, rel=0.05)
    assert binom.ppf(0.001, 400, 0.8) <= hits.sum() <= binom.ppf(0.999, 400, 0.8)


def test_one_session_on_either_side_knows_no_scatter_and_still_compares_with_that_of_traverses():
    is_new = np.array([False, True])
    far = SessionEstimates("a", np.array([0.0, 1.0]), np.full(2, 0.01), is_new, 0.1)
    near = SessionEstimates("b", np.array([0.0, 0.1]), np.full(2, 0.01), is_new, 0.1)
    differences = compare_means([far, near], ALPHA)
    assert all(np.isnan(one.p_adjusted) and np.isnan(one.detectable) and one.df == 0 for one in differences)
    assert [one.p_within_days < ALPHA for one in differences] == [True, False]


def test_scatter_is_no_smaller_than_that_of_traverses():
    is_new = np.arange(6) >= 3
    agree = SessionEstimates("a", np.where(is_new, 1.0, 0.0), np.full(6, 1.0), is_new, 1.0)
    (one,) = compare_means([agree], ALPHA)
    assert one.standard_error == pytest.approx(np.sqrt(2 / 3))
    assert one.p_adjusted > 0.1
