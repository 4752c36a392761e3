"""Checks of premises: silent where they hold, loud where they fail, and honest where nothing can be told."""

from collections import Counter

import numpy as np
import pytest
from scipy import stats

from stickslip_fit.anova.factor_test import ASSUMPTION_LEVEL, brown_forsythe, check_assumptions, monte_carlo_p

LOGS = 100


def verdicts(values, time, level, block, name):
    return next(each.outcome for each in check_assumptions(values, time, level, block) if each.name == name)


def rates(draw, level, block, time, logs=LOGS):
    """How often each premise is doubted."""
    rng, doubted = np.random.default_rng(1), Counter()
    for _ in range(logs):
        checks = check_assumptions(draw(rng), time, level, block)
        doubted.update(each.name for each in checks if each.outcome == "doubtful")
    return {each.name: doubted[each.name] / logs for each in checks}


@pytest.fixture
def design():
    """Three sessions of eight readings, two levels in turn, five minutes apart."""
    block = np.repeat(np.arange(3), 8)
    return np.tile([0, 1], 12), block, np.tile(np.arange(8) * 300.0, 3)


@pytest.mark.slow
def test_a_premise_that_holds_is_doubted_as_seldom_as_is_said(design):
    level, block, time = design
    found = rates(lambda rng: 950.0 + 5.0 * block + rng.standard_normal(24), level, block, time)
    for name in ("normal scatter", "equal scatter", "drift within a session"):
        assert found[name] <= ASSUMPTION_LEVEL + 3.3 * np.sqrt(
            ASSUMPTION_LEVEL * (1 - ASSUMPTION_LEVEL) / LOGS
        ), name


@pytest.mark.slow
def test_premises_that_fail_are_doubted(design):
    _, block, time = design
    misheard = 8.0 * (np.arange(24) == 5)
    days = (block, block, time)
    loud = np.where(block == 0, 10.0, 1.0)
    wild = rates(lambda rng: misheard + rng.standard_normal(24), *design, 40)["normal scatter"]
    unequal = rates(lambda rng: loud * rng.standard_normal(24), *days, 40)["equal scatter"]
    drifting = rates(lambda rng: time / 300.0 + rng.standard_normal(24), *design, 40)
    assert min(wild, unequal, drifting["drift within a session"]) > 0.7


def test_equal_scatter_is_judged_about_medians():
    """Skewed cells: distances from their means would give another F."""
    values = np.random.default_rng(3).exponential(size=(4, 17))
    cell = np.repeat([0, 1, 2], [4, 6, 7])
    cells = [values[:, cell == one] for one in range(3)]
    distances = [np.abs(each - np.median(each, axis=1, keepdims=True)) for each in cells]
    expected = stats.f_oneway(*distances, axis=1).statistic
    assert brown_forsythe(values, cell) == pytest.approx(expected, rel=1e-12)


def test_a_simulated_p_value_is_that_of_scipy():
    """Of integers, too, of which many simulated ones would be as large."""
    values, cell = np.random.default_rng(4).standard_normal(12), np.zeros(12, dtype=int)
    expected = stats.monte_carlo_test(
        values,
        np.random.default_rng(0).standard_normal,
        lambda drawn, axis: np.sum(drawn > 1.0, axis=axis),
        vectorized=True,
        n_resamples=999,
        alternative="greater",
    )
    p_value = monte_carlo_p(lambda drawn, _: np.sum(drawn > 1.0, axis=-1), values, cell)
    assert p_value == expected.pvalue


def test_a_constant_between_sessions_is_no_drift_and_no_shape(design):
    level, block, time = design
    values = np.random.default_rng(2).standard_normal(24)
    far = check_assumptions(values + 1e4 * block + 50.0 * level, time, level, block)
    assert [each.p_value for each in far] == pytest.approx(
        [each.p_value for each in check_assumptions(values, time, level, block)]
    )


def test_levels_read_one_after_another_are_told_from_levels_in_turn(design):
    level, block, time = design
    values = np.zeros(24)
    assert verdicts(values, time, level, block, "levels in turn") == "holds"
    after = np.tile(np.repeat([0, 1], 4), 3)
    spread = np.where(time < 1200.0, time, time + 36000.0)
    assert verdicts(values, spread, after, block, "levels in turn") == "doubtful"


def test_few_readings_say_so():
    two = np.array([0, 0, 1, 1])
    found = check_assumptions(np.array([1.0, 2.0, 4.0, 3.0]), np.arange(4.0), two, np.zeros(4, dtype=int))
    assert [each.outcome for each in found[:3]] == ["cannot tell"] * 3
    assert all("too few" in each.message for each in found[:3])
