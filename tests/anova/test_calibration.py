"""Error rates: false alarms of each named analysis, power, and intervals that know of their selection."""

import numpy as np
import pytest
from scipy import stats

from stickslip_fit.anova import FactorTestDesign, choose_most_informative, step_size_observations
from stickslip_fit.anova.contrasts import (
    TARGET_POWER,
    adjust_holm,
    build_comparison,
    detectable_difference,
    f_test_power,
    holm_levels,
    largest_difference,
    smallest_noncentrality,
    sums_of_squares,
)
from stickslip_fit.anova.designs import (
    WITHIN_SESSION_ERROR,
    design_day_tests,
    design_direction_tests,
    design_normal_force_tests,
)

LOGS = 10_000
SAME = 3.3  # standard deviations: one honest study in a thousand is further off

DAYS = ("Mon", "Tue", "Wed", "Thu")
BALANCED = {(d, s, t): 2 for d in DAYS for s in "+-" for t in (0.0, -30.0, -60.0)}
UNEQUAL = {cell: 1 + (7 * index) % 3 for index, cell in enumerate(BALANCED)}
GAPS = {
    cell: count for cell, count in UNEQUAL.items() if cell not in {("Tue", "+", -30.0), ("Wed", "-", -60.0)}
}
DESIGNS = {"balanced": BALANCED, "unequal": UNEQUAL, "missing cells": GAPS}
ANALYSES = {
    "day": design_day_tests,
    "direction": design_direction_tests,
    "normal-force": design_normal_force_tests,
}


def binomial(rate: float) -> float:
    return SAME * np.sqrt(rate * (1 - rate) / LOGS)


def null_logs(question: FactorTestDesign, rng: np.random.Generator, interaction: float) -> np.ndarray:
    """What is compared, in logs where the factor does nothing, shape (LOGS, units).

    Sessions differ by ten repeatabilities, and where the question is asked over sessions, levels differ in
    each session at random by `interaction` of them, which is no effect of the factor.
    """
    rows = question.observations.reset_index(drop=True)
    noise = rng.standard_normal((LOGS, len(rows)))
    sessions, session = np.unique(rows["session"].to_numpy(object), return_inverse=True)
    if question.analysis != "day":
        noise += 10.0 * rng.standard_normal((LOGS, len(sessions)))[:, session]
    if question.error_term == WITHIN_SESSION_ERROR:
        return noise
    cells = rows.groupby(["session", "level"], sort=False).ngroup().to_numpy()
    noise += interaction * rng.standard_normal((LOGS, cells.max() + 1))[:, cells]
    share = (cells[:, None] == np.arange(cells.max() + 1)).astype(float)
    return noise @ (share / share.sum(axis=0))


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("analysis", ANALYSES)
def test_false_alarms_of_ten_thousand_null_logs(log_of_readings, readings_of, analysis, design):
    log = log_of_readings(readings_of(DESIGNS[design]))
    asked = ANALYSES[analysis](step_size_observations(log), log.machine, choose_most_informative)
    questions = [each for each in asked if isinstance(each, FactorTestDesign)]
    assert questions
    rng = np.random.default_rng(3)
    for question in questions:
        for interaction in (0.0, 3.0):
            units = question.units
            values = null_logs(question, rng, interaction)
            p = sums_of_squares(values, build_comparison(units["level"], units["block"])).p_value
            rate = np.mean(p < 0.05)
            assert rate == pytest.approx(0.05, abs=binomial(0.05)), (question.error_term, interaction)


@pytest.mark.parametrize("sizes", [(3, 3), (3, 3, 3), (2, 5, 3, 4)])
def test_power_is_what_its_formula_says(sizes):
    """Of the case that it is for: two levels apart, all others where they help least."""
    comparison = build_comparison(np.repeat(np.arange(len(sizes)), sizes))
    difference = detectable_difference(1.0, comparison)
    least = np.argsort(sizes, kind="stable")[:2]
    true = np.zeros(len(sizes))
    n, m = np.array(sizes)[least]
    true[least] = difference * np.array([m, -n]) / (n + m)
    noise = np.random.default_rng(5).standard_normal((LOGS, sum(sizes)))
    p = sums_of_squares(true[comparison.level] + noise, comparison).p_value
    assert np.mean(p < 0.05) == pytest.approx(TARGET_POWER, abs=binomial(TARGET_POWER))
    assert f_test_power(smallest_noncentrality(difference, 1.0, comparison), comparison.df) == pytest.approx(
        TARGET_POWER
    )


@pytest.mark.slow
def test_what_is_detectable_is_declared_among_many_tests_as_often_as_it_says():
    """Of 20 tests of which one has an effect: the level that Holm leaves, not that of a single test."""
    comparison, rng = build_comparison(np.repeat([0, 1], 3)), np.random.default_rng(8)
    n, tests = 2000, 20
    noise = rng.standard_normal((n, tests, 6))
    p = sums_of_squares(noise, comparison).p_value
    levels = np.array([holm_levels(each)[0] for each in p])
    true = np.array([detectable_difference(1.0, comparison, level) for level in levels])
    assert np.median(true) > 2.0 * detectable_difference(1.0, comparison)
    noise[:, 0] += true[:, None] * comparison.level
    p[:, 0] = sums_of_squares(noise[:, 0], comparison).p_value
    declared = np.array([adjust_holm(each)[0] < 0.05 for each in p])
    assert np.mean(declared) == pytest.approx(TARGET_POWER, abs=SAME * np.sqrt(0.16 / n))


def test_the_level_that_holm_leaves_decides_as_the_adjusted_p_value_does():
    rng = np.random.default_rng(9)
    for _ in range(300):
        p = rng.random(rng.integers(1, 12)) ** rng.integers(1, 6)
        assert ((p < holm_levels(p)) == (adjust_holm(p) < 0.05)).all()


def test_power_counts_what_blocks_leave_to_compare():
    """Two pairs of levels that no block connects: two degrees of freedom for four levels."""
    comparison = build_comparison(np.tile([0, 1, 2, 3], 4), np.tile([0, 0, 1, 1, 2, 2, 3, 3], 2))
    assert (comparison.connected, comparison.df) == (False, (2, 10))
    true = np.array([0.0, 1.5, 0.0, 1.0])[comparison.level]
    expected = f_test_power(float(sums_of_squares(true, comparison).between), comparison.df)
    noise = np.random.default_rng(7).standard_normal((LOGS, 16))
    p = sums_of_squares(true + noise, comparison).p_value
    assert np.mean(p < 0.05) == pytest.approx(expected, abs=binomial(expected))


@pytest.mark.parametrize("df", [(1, 1), (1, 4), (3, 8), (20, 1), (60, 400)])
def test_power_is_a_tail_of_the_noncentral_f_distribution(df):
    critical = stats.f.isf(0.05, *df)
    for size in (0.5, 5.0, 50.0):
        assert f_test_power(size, df) == pytest.approx(stats.ncf.sf(critical, *df, size), rel=1e-8)


@pytest.mark.slow
def test_the_interval_of_the_largest_difference_knows_that_it_was_picked():
    """The same numbers with Student's interval would be right in about 88 of 100 logs."""
    rng, comparison = np.random.default_rng(6), build_comparison(np.repeat(np.arange(3), 3))
    right = 0
    for values in rng.standard_normal((2000, 9)):
        found = largest_difference(values, comparison)
        right += found.low <= 0.0 <= found.high
    assert right / 2000 == pytest.approx(0.95, abs=SAME * np.sqrt(0.05 * 0.95 / 2000))
