"""The noise of a sampled signal: its filter, its estimate, and what it does to a diagnosis."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles
from stickslip_fit.diagnosis.autocorrelation import (
    Autocorrelation,
    FilterPattern,
    number_samples,
    partial_autocorrelations,
    predict_from_partials,
)
from stickslip_fit.diagnosis.restricted_likelihood import RestrictedLikelihood
from stickslip_fit.diagnosis.table import problem_from_table
from tests.differences import numeric_slopes
from tests.table.signals import LAW, RESONANCE, ROLES, correlation, signal

SHARED = {"session": "run", "time": "t"}


@pytest.mark.parametrize("kind", ["0.9", "rings"])
def test_the_filter_whitens_exactly_from_the_first_sample_of_every_sequence(kind):
    sample = np.r_[0:15, 17:25, 100:117]
    coefficients = np.array({"0.9": (0.9,), "rings": RESONANCE}[kind])
    noise_filter = Autocorrelation(sample, None, coefficients).noise_filter.toarray()
    covariance = np.zeros((40, 40))
    for rows in (slice(0, 15), slice(15, 23), slice(23, 40)):
        covariance[rows, rows] = correlation(kind, rows.stop - rows.start)
    np.testing.assert_allclose(noise_filter @ covariance @ noise_filter.T, np.eye(40), atol=1e-8)


def test_a_removed_row_ends_a_sequence():
    before = Autocorrelation(np.arange(20), None, np.array([0.8]))
    kept = np.delete(np.arange(20), 7)
    after = before.select(kept).noise_filter.toarray()
    assert after[7, 6] == 0  # row 8 has lost the one before
    assert after[7, 7] == 1
    np.testing.assert_array_equal(after[:7, :7], before.noise_filter.toarray()[:7, :7])


def test_coefficients_and_partial_autocorrelations_are_two_ways_to_say_the_same():
    partial = np.array([0.9, -0.5, 0.2])
    np.testing.assert_allclose(partial_autocorrelations(predict_from_partials(partial)), partial)
    pattern = FilterPattern.of(np.r_[0:9, 12:20], 3)
    _, log_determinant = np.linalg.slogdet(pattern.fill(partial).toarray())
    assert pattern.log_determinant(partial) == pytest.approx(log_determinant)


def restricted_likelihood(rows, phi: float) -> float:
    """Of a first-order autoregression about the law, written down directly."""
    vel = rows["vel"].to_numpy()
    law = np.column_stack([rows["acc"], vel, np.sign(vel), np.ones(len(rows))])
    inverse = np.linalg.inv(phi ** np.abs(np.subtract.outer(np.arange(len(rows)), np.arange(len(rows)))))
    normal = law.T @ inverse @ law
    left = rows["F"].to_numpy() - law @ np.linalg.solve(normal, law.T @ inverse @ rows["F"].to_numpy())
    df = len(rows) - law.shape[1]
    squares = left @ inverse @ left
    return 0.5 * (np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(normal)[1] - df * np.log(squares))


@pytest.mark.slow
def test_the_estimate_maximizes_the_restricted_likelihood():
    rows = signal(np.random.default_rng(4), "0.9", 1, 120)
    problem, _ = problem_from_table(rows, LAW, roles=TableRoles(**SHARED), generic_causes=())
    (found,) = problem.with_autocorrelation().correlation
    grid = np.arange(0.6, 0.99, 0.002)
    assert found == pytest.approx(
        grid[np.argmax([restricted_likelihood(rows, phi) for phi in grid])], abs=0.003
    )


def test_the_likelihood_and_its_slopes_are_those_of_the_covariance():
    """Of order 3, in two sessions with gaps, by the filter and by numerical derivatives."""
    rows = signal(np.random.default_rng(5), "0.9", 2, 50).drop(index=[3, 20, 21, 60])
    problem, _ = problem_from_table(rows, LAW, roles=TableRoles(**SHARED), generic_causes=())
    linearized, sample = problem.linearize(), problem.autocorrelation.sample
    border = linearized.project(np.column_stack([rows["temp"], rows["t"] ** 2]))
    likelihood, partial = RestrictedLikelihood(linearized, border, sample), np.array([0.8, -0.3, 0.2])
    filtered = FilterPattern.of(sample, 3).fill(partial).toarray()
    mean = filtered @ np.column_stack([linearized.basis.toarray(), border])
    left = filtered @ linearized.residual
    left -= mean @ np.linalg.lstsq(mean, left, rcond=None)[0]
    expected = 0.5 * (len(left) - mean.shape[1]) * np.log(left @ left)
    expected += 0.5 * np.linalg.slogdet(mean.T @ mean)[1] - np.linalg.slogdet(filtered)[1]
    value, slopes = likelihood.differentiate(partial)
    assert value == pytest.approx(expected, rel=1e-10)
    assert slopes == pytest.approx(
        numeric_slopes(lambda one: likelihood.differentiate(one)[0], partial, 1e-5), abs=1e-4
    )


def test_what_the_law_describes_already_changes_nothing_in_the_noise():
    """Projected, it is rounding, and no direction of that is part of the mean."""
    rows = signal(np.random.default_rng(6), "0.9", 1, 120)
    problem, _ = problem_from_table(rows, LAW, roles=TableRoles(**SHARED), generic_causes=())
    linearized, sample = problem.linearize(), problem.autocorrelation.sample
    own = rows[["acc", "vel"]].to_numpy() @ np.random.default_rng(7).normal(size=(2, 6))
    alone, beside = (
        Autocorrelation(sample, candidates).estimate(linearized).coefficients
        for candidates in (np.zeros((120, 0)), own)
    )
    np.testing.assert_allclose(beside, alone, rtol=1e-9)


@pytest.mark.nightly
def test_short_sessions_do_not_make_the_autocorrelation_too_small():
    found, plain = [], []
    for seed in range(6):
        rows = signal(np.random.default_rng(seed), "0.9", 5, 60)
        problem, _ = problem_from_table(rows, LAW, roles=TableRoles(**ROLES))
        residual = problem.linearize().residual
        plain.append(residual[1:] @ residual[:-1] / (residual @ residual))
        found.append(problem.with_autocorrelation().correlation.sum())
    assert np.mean(plain) < 0.85
    assert np.mean(found) == pytest.approx(0.9, abs=0.03)  # two and a half standard errors of six


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "order"), [("white", 0), ("0.5", 1), pytest.param("rings", 2, marks=pytest.mark.nightly)]
)
def test_the_order_is_that_of_the_noise(kind, order):
    orders = []
    for seed in range(3):
        rows = signal(np.random.default_rng(seed), kind, 1, 300)
        problem, _ = problem_from_table(rows, LAW, roles=TableRoles(**ROLES))
        orders.append(len(problem.with_autocorrelation().correlation))
    assert np.median(orders) == order
    assert np.mean(np.array(orders) == order) > 0.6


def test_only_a_regular_sequence_is_a_sampled_signal():
    rng = np.random.default_rng(1)
    assert number_samples(np.cumsum(rng.exponential(size=200)), np.zeros(200, int)) is None
    assert number_samples(np.zeros(50), np.zeros(50, int)) is None
    jitter = np.arange(200) + rng.uniform(-0.05, 0.05, 200)
    np.testing.assert_array_equal(number_samples(jitter, np.zeros(200, int)), np.arange(200))


# In each run test_gain.py and test_text.py have these numbers of the bench.
@pytest.mark.nightly
def test_a_diagnosis_says_how_many_independent_values_there_are():
    rows = signal(np.random.default_rng(2), "0.9", 1, 600)
    table = ssf.diagnose_table(rows, LAW, **ROLES, gain=False).table
    assert table.correlation_rows == pytest.approx(1.9 / 0.1, rel=0.5)
    assert table.independent == pytest.approx(600 / table.correlation_rows)
    assert table.correlation_time == pytest.approx(0.01 * table.correlation_rows, rel=1e-6)


@pytest.mark.nightly
def test_rows_without_a_time_have_no_order():
    rows = signal(np.random.default_rng(2), "0.9", 1, 300)
    diagnosis = ssf.diagnose_table(rows, LAW, session="run", gain=False)
    assert diagnosis.table.independent == 300
    for name in ("drift", "warm-up", "sudden-change", "memory"):
        assert "name 'order' as it" in diagnosis.untestable[name]


def test_noise_persists_over_at_most_four_tenths_of_the_longest_record():
    """Of a first-order autoregression the time is (1 + phi) / (1 - phi) rows."""
    sample, coefficient = np.r_[0:40, 100:161], np.array([0.99])
    shortened = Autocorrelation(sample, None, coefficient).shorten()
    longest = 0.4 * 61
    assert shortened.coefficients == pytest.approx([(longest - 1) / (longest + 1)], rel=1e-4)
    short = Autocorrelation(sample, None, np.array([0.9]))
    np.testing.assert_array_equal(short.shorten().coefficients, short.coefficients)
    ringing = Autocorrelation(np.arange(30), None, 0.999 ** np.arange(1, 3) * [1.5, -0.52]).shorten()
    assert ringing.correlation_rows == pytest.approx(min(12, ringing.correlation_rows), rel=1e-4)


@pytest.mark.nightly
def test_noise_that_swings_is_told_with_its_period():
    """Sunspots recur after about 11 years without a steady phase: G. U. Yule's autoregression of 1927."""
    from statsmodels.datasets import sunspots

    spots = sunspots.load_pandas().data
    law = ssf.Law("SUNACTIVITY ~ a", units={"YEAR": "years", "a": "1"})
    found = ssf.diagnose_table(spots, law, time="YEAR", gain=False)
    assert "periodic-in-time" not in [cause.name for cause in found.selection.problem.causes]
    assert found.table.noise_period == pytest.approx(10.8, abs=0.5)
    assert f"swings with a period of about {found.table.noise_period:.1f} years" in str(found.summary())
    rng = np.random.default_rng(4)
    white = ssf.diagnose_table(
        pd.DataFrame({"y": rng.standard_normal(300)}), "y ~ a", time="order", gain=False
    )
    assert np.isnan(white.table.noise_period)
