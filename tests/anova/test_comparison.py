import numpy as np
import pytest
from scipy import stats
from statsmodels.regression.linear_model import OLS

from stickslip_fit.anova.contrasts import build_comparison, largest_difference, level_means, sums_of_squares


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_one_way_is_scipy_s(rng):
    level = np.repeat([0, 1, 2], [3, 5, 2])
    values = 950.0 + rng.standard_normal(10) + level
    found = sums_of_squares(values, build_comparison(level))
    theirs = stats.f_oneway(*(values[level == one] for one in range(3)))
    assert float(found.statistic) == pytest.approx(theirs.statistic, rel=1e-12)
    assert float(found.p_value) == pytest.approx(theirs.pvalue, rel=1e-10)


def test_two_levels_within_blocks_are_the_paired_t_test(rng):
    plus, minus = 950.0 + rng.standard_normal((2, 6))
    comparison = build_comparison(np.repeat(["+", "-"], 6), np.tile(np.arange(6), 2))
    values = np.concatenate([plus, minus])
    paired = stats.ttest_rel(plus, minus)
    assert float(sums_of_squares(values, comparison).statistic) == pytest.approx(paired.statistic**2)
    interval = paired.confidence_interval()
    found = largest_difference(values, comparison)
    assert sorted(np.abs([found.low, found.high])) == pytest.approx(sorted(np.abs(interval)))


def test_missing_cells_are_compared_by_least_squares(rng):
    """Against a plain regression on dummy columns."""
    block = np.array([0, 0, 0, 1, 1, 2, 2, 2])
    level = np.array([0, 1, 2, 0, 1, 0, 1, 2])
    values = rng.standard_normal(8)
    blocks, levels = np.eye(3)[block], np.eye(3)[level][:, 1:]
    both = np.hstack([blocks, levels])
    rest = {
        name: float(np.sum((values - x @ np.linalg.lstsq(x, values, rcond=None)[0]) ** 2))
        for name, x in (("blocks", blocks), ("both", both))
    }
    comparison = build_comparison(level, block)
    found = sums_of_squares(values, comparison)
    assert found.df == (2, 2, 3)
    assert float(found.within) == pytest.approx(rest["both"])
    assert float(found.between) == pytest.approx(rest["blocks"] - rest["both"])
    assert float(found.total) == pytest.approx(np.sum((values - values.mean()) ** 2))
    means, factor = level_means(values, comparison)
    slopes = np.linalg.lstsq(both, values, rcond=None)[0][3:]
    assert means[1:] - means[0] == pytest.approx(slopes)
    variances = np.diag(np.linalg.inv(both.T @ both))[3:]
    assert factor[1, 1] + factor[0, 0] - 2 * factor[0, 1] == pytest.approx(variances[0])


@pytest.mark.parametrize("blocks", [1, 4])
def test_stacked_sums_of_squares_are_those_of_least_squares_fits(rng, blocks):
    """Of unequal cells, some of them empty, with a level that is in one block only."""
    level, block = np.append(rng.integers(0, 3, 40), 3), rng.integers(0, blocks, 41)
    values = 950.0 + 30.0 * block + rng.standard_normal((5, 41))
    found = sums_of_squares(values, build_comparison(level, block))
    by_block = np.eye(blocks)[block]
    both = np.hstack([by_block, np.eye(4)[level][:, 1:]])
    for index, row in enumerate(values - np.median(values)):
        mean, smaller, larger = (OLS(row, design).fit() for design in (np.ones(41), by_block, both))
        assert found.df == (blocks - 1, 3, larger.df_resid)
        assert found.within[index] == pytest.approx(larger.ssr, rel=1e-10)
        assert found.between[index] == pytest.approx(smaller.ssr - larger.ssr, rel=1e-10)
        assert found.blocks[index] == pytest.approx(mean.ssr - smaller.ssr, rel=1e-10, abs=1e-9)


def test_three_levels_get_tukey_s_interval(rng):
    groups = [950.0 + rng.standard_normal(4) + 2 * index for index in range(3)]
    found = largest_difference(np.concatenate(groups), build_comparison(np.repeat([0, 1, 2], 4)))
    theirs = stats.tukey_hsd(*groups)
    interval = theirs.confidence_interval()
    pair = (found.largest, found.smallest)
    assert found.difference == pytest.approx(theirs.statistic[pair])
    assert (found.low, found.high) == pytest.approx((interval.low[pair], interval.high[pair]), rel=1e-6)


def test_omega_squared_is_hays(rng):
    values, level = rng.standard_normal(9) + np.repeat([0, 3, 1], 3), np.repeat([0, 1, 2], 3)
    found = sums_of_squares(values, build_comparison(level))
    by_hand = (found.between - 2 * found.variance) / (found.total + found.variance)
    assert float(found.omega_squared) == pytest.approx(float(by_hand))
    assert float(sums_of_squares(np.tile([1.0, 2.0, 4.0], 3), build_comparison(level)).omega_squared) == 0.0


def test_levels_that_blocks_do_not_connect_are_seen():
    assert not build_comparison([0, 1, 2, 3], [0, 0, 1, 1]).connected
    assert build_comparison([0, 1, 1, 2], [0, 0, 1, 1]).connected
