"""Variance components, against the likelihood written out whole, and intervals against known truths."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.optimize import minimize

from stickslip_fit.anova import NotTestable
from stickslip_fit.anova.variance_components import (
    build_cell_statistics,
    estimate_components,
    fit_reml,
    generalized_pivotal_intervals,
)

SAME = 3.3


def drawn(rng, counts, day, day_direction, replicate, difference=5.0):
    """Readings of one configuration; `counts` of each session and direction."""
    counts = np.asarray(counts)
    cell = day * rng.standard_normal((len(counts), 1)) + day_direction * rng.standard_normal(counts.shape)
    cell = cell + np.array([0.0, difference])[: counts.shape[1]]
    session, direction = (np.repeat(codes.ravel(), counts.ravel()) for codes in np.indices(counts.shape))
    values = 950.0 + cell[session, direction] + replicate * rng.standard_normal(counts.sum())
    return pd.DataFrame(
        {
            "joint": 3, "session": [f"s{k}" for k in session], "direction": np.array(["+", "-"])[direction],
            "step_size": values * 1e-9, "configuration": "c0", "orientation": "c0",
            "q1": 0.0, "q2": -1.5, "q3": np.nan, "theta": 0.0, "psi": 0.0, "low": 0.0, "high": 0.012,
        }
    )  # fmt: skip


def written_out(rows, variances):
    """-2 log of the restricted likelihood, every reading a row of the covariance."""
    day, day_direction, replicate = variances
    session, direction = rows["session"].to_numpy(), rows["direction"].to_numpy()
    same_day = session[:, None] == session[None, :]
    same_cell = same_day & (direction[:, None] == direction[None, :])
    covariance = day * same_day + day_direction * same_cell + replicate * np.eye(len(rows))
    fixed = (direction[:, None] == np.unique(direction)).astype(float)
    y = rows["step_size"].to_numpy() * 1e9 - 950.0
    inverse = np.linalg.inv(covariance)
    information = fixed.T @ inverse @ fixed
    residual = y - fixed @ np.linalg.solve(information, fixed.T @ inverse @ y)
    return (
        np.linalg.slogdet(covariance)[1]
        + np.linalg.slogdet(information)[1]
        + float(residual @ inverse @ residual)
    )


@pytest.mark.parametrize(
    ("counts", "truth"),
    [
        ([[2, 3], [1, 2], [3, 3], [2, 1]], (3.0, 2.0, 1.0)),
        ([[2, 3], [1, 0], [3, 3], [0, 2], [2, 2]], (3.0, 2.0, 1.0)),
        ([[2, 3], [1, 2], [3, 3]], (0.0, 0.0, 1.0)),
        ([[2, 3], [1, 2], [3, 3]], (3.0, 0.0, 1.0)),
        ([[2], [3], [4], [1]], (3.0, 0.0, 1.0)),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_no_variances_are_likelier_than_ours(counts, truth, seed):
    rows = drawn(np.random.default_rng(seed), counts, *truth)
    found = fit_reml(build_cell_statistics(rows))
    ours = np.array([found.day, found.day_direction, found.replicate]) * 1e18
    at_ours = written_out(rows, ours)
    free = [0, 1, 2] if len(counts[0]) > 1 else [0, 2]

    def deviance(logarithms):
        variances = np.zeros(3)
        variances[free] = np.exp(logarithms)
        return written_out(rows, variances)

    bounds = [(-25.0, 6.0)] * len(free)
    for start in (np.zeros(len(free)), np.full(len(free), -4.0), np.linspace(2.0, -2.0, len(free))):
        best = minimize(deviance, start, method="L-BFGS-B", bounds=bounds)
        assert at_ours <= best.fun + 1e-6


def test_balanced_estimates_are_those_of_the_table():
    """Where the table's are positive; day = (MS day - MS interaction) / 4 and so on, two readings a cell."""
    rows = drawn(np.random.default_rng(4), np.full((6, 2), 2), 4.0, 2.0, 1.0)
    y = rows["step_size"].to_numpy().reshape(6, 2, 2) * 1e9
    cell, session = y.mean(axis=2), y.mean(axis=(1, 2))
    error = np.sum((y - cell[:, :, None]) ** 2) / 12
    interaction = 2 * np.sum((cell - session[:, None] - cell.mean(axis=0) + y.mean()) ** 2) / 5
    day = 4 * np.var(session, ddof=1)
    found = fit_reml(build_cell_statistics(rows))
    assert found.replicate * 1e18 == pytest.approx(error, rel=1e-5)
    assert found.day_direction * 1e18 == pytest.approx((interaction - error) / 2, rel=1e-5)
    assert found.day * 1e18 == pytest.approx((day - interaction) / 4, rel=1e-5)


def coverage(logs, counts, truth):
    rng, right = np.random.default_rng(5), np.zeros((logs, 4))
    day, interaction, replicate = truth
    true = np.array([day**2, interaction**2, replicate**2, day**2 + interaction**2])
    for log in range(logs):
        found = generalized_pivotal_intervals(build_cell_statistics(drawn(rng, counts, *truth)))
        bounds = np.array([found.day, found.day_direction, found.replicate, found.total]) * 1e18
        right[log] = (bounds[:, 0] <= true) & (true <= bounds[:, 1])
    return right.mean(axis=0)


TRUTHS = {
    "nothing but replicates": (0.0, 0.0, 1.0),
    "days alike in both": (3.0, 0.0, 1.0),
    "all": (3.0, 2.0, 1.0),
}


@pytest.mark.parametrize("name", TRUTHS)
def test_intervals_cover_also_where_a_variance_is_nothing(name):
    found = coverage(40, [[2, 2], [3, 2], [1, 2], [3, 3]], TRUTHS[name])
    assert np.all(found >= 0.95 - SAME * np.sqrt(0.05 * 0.95 / 40))


@pytest.mark.nightly
@pytest.mark.parametrize("name", TRUTHS)
def test_intervals_cover_in_many_logs(name):
    found = coverage(3000, [[2, 2], [3, 2], [1, 2], [3, 3]], TRUTHS[name])
    assert np.all(found >= 0.95 - SAME * np.sqrt(0.05 * 0.95 / 3000))


def test_where_nothing_changes_the_interval_begins_at_zero():
    found = estimate_components(drawn(np.random.default_rng(6), np.full((3, 2), 3), 0.0, 0.0, 1.0))
    assert found.day.low == found.day_direction.low == 0.0
    assert found.day.high > 0.0


def test_the_difference_between_directions_is_the_paired_t_interval():
    rows = drawn(np.random.default_rng(8), np.full((5, 2), 3), 3.0, 2.0, 1.0)
    found = estimate_components(rows)
    mean = rows.groupby(["session", "direction"])["step_size"].mean().unstack()
    paired = stats.ttest_rel(mean["+"], mean["-"])
    assert found.direction == pytest.approx(float((mean["+"] - mean["-"]).mean()))
    assert (found.direction_low, found.direction_high) == pytest.approx(paired.confidence_interval())


@pytest.mark.parametrize("counts", [[[3, 3]], [[1, 1], [1, 1], [1, 1]], [[2, 0], [0, 2], [2, 2]]])
def test_too_little_is_refused_with_what_it_needs(counts):
    found = estimate_components(drawn(np.random.default_rng(7), counts, 1.0, 1.0, 1.0))
    assert isinstance(found, NotTestable)
    assert "two sessions" in found.reason
