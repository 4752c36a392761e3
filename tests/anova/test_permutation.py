from itertools import product

import numpy as np
import pytest
from scipy import stats

from stickslip_fit.anova.contrasts import build_comparison, sums_of_squares
from stickslip_fit.anova.factor_test import permute_levels

SAME = 3.3


def test_readings_of_two_days_are_exchanged_as_scipy_does():
    rng = np.random.default_rng(1)
    for _ in range(5):
        one, two = rng.standard_normal(4), 0.7 + rng.standard_normal(5)
        theirs = stats.permutation_test(
            (one, two),
            lambda x, y, axis: np.abs(x.mean(axis=axis) - y.mean(axis=axis)),
            vectorized=True,
            alternative="greater",
            n_resamples=np.inf,
        )
        found = permute_levels(np.concatenate([one, two]), build_comparison([0] * 4 + [1] * 5))
        assert found.exact
        assert found.arrangements == 126
        assert found.p_value == pytest.approx(theirs.pvalue)


def test_sessions_keep_their_readings():
    """Two directions in sessions: the exact test turns the sign of each session's difference."""
    difference = np.array([1.0, 0.4, -0.2, 0.9, 1.3])
    values = np.ravel(np.stack([10 * np.arange(5) + difference, 10 * np.arange(5)], axis=1))
    found = permute_levels(values, build_comparison([0, 1] * 5, np.repeat(np.arange(5), 2)))
    flips = [abs(np.dot(signs, difference)) for signs in product((1, -1), repeat=5)]
    assert found.p_value == pytest.approx(np.mean(np.array(flips) >= abs(difference.sum()) - 1e-12))
    assert found.floor == 2 / 32


@pytest.mark.parametrize(
    ("levels", "blocks", "floor"),
    [
        ([0, 0, 0, 1, 1, 1], None, 2 / 20),
        ([0, 0, 0, 1, 1], None, 1 / 10),
        ([0, 1, 2] * 2, [0] * 3 + [1] * 3, 6 / 36),
        ([0, 1, 2, 0, 1], [0, 0, 0, 1, 1], 2 / 12),
    ],
)
def test_the_floor_is_the_smallest_p_that_any_values_reach(levels, blocks, floor):
    comparison = build_comparison(levels, blocks)
    effect = np.array([0.0, 1.0, 5.0])[comparison.level]
    best = permute_levels(effect + 1e-3 * np.random.default_rng(0).standard_normal(len(levels)), comparison)
    assert best.p_value == pytest.approx(floor)
    assert best.floor == pytest.approx(floor)


def test_sessions_keep_their_readings_where_arrangements_are_drawn():
    """One session far off: exchanging readings between sessions would give another p."""
    difference = np.array([9.0] + [1.0] * 10 + [-1.0] * 4)
    values = np.ravel(np.stack([difference, np.zeros(15)], axis=1))
    found = permute_levels(values, build_comparison([0, 1] * 15, np.repeat(np.arange(15), 2)))
    signs = 1 - 2 * ((np.arange(2**15)[:, None] >> np.arange(15)) & 1)
    exact = np.mean(np.abs(signs @ difference) >= difference.sum() - 1e-12)
    assert not found.exact
    assert found.p_value == pytest.approx(exact, abs=SAME * np.sqrt(exact / found.arrangements))


def test_drawn_arrangements_agree_with_the_f_test_and_never_say_zero():
    rng, comparison = np.random.default_rng(2), build_comparison(np.repeat(np.arange(5), 6))
    values = rng.standard_normal(30) + 0.35 * comparison.level
    found = permute_levels(values, comparison)
    assert not found.exact
    assert found.p_value == pytest.approx(float(sums_of_squares(values, comparison).p_value), abs=0.015)
    far = permute_levels(values + 100.0 * comparison.level, comparison)
    assert far.p_value == far.floor == 1e-4


def test_p_values_of_null_logs_are_uniform():
    rng, comparison = np.random.default_rng(3), build_comparison([0, 0, 0, 1, 1, 1, 2, 2])
    p = np.array([permute_levels(rng.standard_t(3, 8), comparison).p_value for _ in range(150)])
    assert stats.kstest(p, "uniform").pvalue > 1e-3
