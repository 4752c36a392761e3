"""Noise that is skewed or coarsely rounded is seen where it is clear, and nowhere else."""

import numpy as np
import pytest

from stickslip_fit.diagnosis.noise_shape import Quantization, find_count_spacing, fit_skewness

N, SESSIONS, KINDS = 480, 4, 40
SESSION = np.arange(N) * SESSIONS // N
KIND = np.arange(N) % KINDS


def draw(tails, rng):
    return rng.standard_normal(N) if tails == "gaussian" else rng.standard_t(5, N) / np.sqrt(5 / 3)


@pytest.mark.parametrize("tails", ["gaussian", "t5"])
@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_noise_as_assumed_is_not_skewed(tails, ratio):
    """8 logs each: even, and twice as large in a third of the configurations."""
    for seed in range(8):
        noise = draw(tails, np.random.default_rng(seed)) * np.where(KIND % 3 == 0, ratio, 1.0)
        assert fit_skewness(noise) is None


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("sd", [0.5, 1.0])
def test_log_normal_noise_is_skewed_and_its_long_tail_is_no_outlier(sign, sd):
    """It is drawn in, in order, to what heavy symmetric tails may give."""
    for seed in range(3):
        noise = sign * np.random.default_rng(seed).lognormal(0.0, sd, N)
        found = fit_skewness(noise)
        assert found is not None
        assert np.sign(found.g) == sign
        tame = found.symmetrize(noise) / found.scale
        assert np.abs(tame).max() < 5.0
        assert np.all(np.diff(tame[np.argsort(noise)]) >= 0)


def test_gross_errors_of_one_sign_are_no_skewness():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        noise = draw("gaussian", rng)
        noise[rng.choice(N, 5, replace=False)] += 200.0
        assert fit_skewness(noise) is None


def test_the_spacing_of_counts_is_found_where_it_is_coarser_than_the_checks():
    rng = np.random.default_rng(1)
    counts = 5 * np.round(rng.uniform(2000, 12000, N) / 5)
    coarse = 50 * np.round(counts / 50)
    assert not find_count_spacing(counts, 5, SESSION).any()
    assert np.all(find_count_spacing(counts, 1, SESSION) == 5)
    assert np.all(find_count_spacing(coarse, 5, SESSION) == 50)
    assert not find_count_spacing(coarse, 50, SESSION).any()
    one_session = find_count_spacing(np.where(SESSION == 1, coarse, counts), 5, SESSION)
    np.testing.assert_array_equal(one_session, np.where(SESSION == 1, 50, 0))
    with_errors = coarse.copy()
    with_errors[::200] = 5 * np.round(coarse[::200] / 11 / 5) + 5
    assert np.all(find_count_spacing(with_errors, 5, SESSION) == 50)


def test_few_or_equal_counts_say_nothing_of_their_spacing():
    assert not find_count_spacing(np.full(N, 12000), 5).any()
    assert not find_count_spacing(50 * np.arange(100, 109), 5).any()


def test_simulated_counts_are_rounded_as_the_log_s_are():
    """Against counts rounded as such, of expected 2,000, 5,010 and 9,000 with and without a spacing of 50."""
    rng = np.random.default_rng(2)
    expected, own = np.array([2000.0, 5010.0, 9000.0]), np.array([20.0, 2.0, 30.0])
    spacing = np.array([50.0, 50.0, 0.0])
    sd = np.sqrt(own**2 + spacing**2 / 12)
    noise = rng.standard_normal((3, 500))
    phase = expected / np.where(spacing > 0, spacing, np.inf)
    departure = Quantization(phase, spacing / sd).round(noise) * sd[:, None]
    counts = expected[:, None] + own[:, None] * noise
    counts[:2] = 50 * np.round(counts[:2] / 50)
    np.testing.assert_allclose(departure, counts - expected[:, None], atol=1e-8)
    np.testing.assert_allclose(departure[1], -10.0)
