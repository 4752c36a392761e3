"""Box's epsilon estimated from runs along the travel, beside that of the covariance they were drawn with."""

import numpy as np
import pytest

from stickslip_fit.anova.position import box_epsilon

P = 12
PLACES = np.arange(P)
APART = np.abs(np.subtract.outer(PLACES, PLACES))
COVARIANCES = {
    "independent": np.eye(P),
    "autocorrelated": 0.7**APART,
    "a wave and noise": np.cos(APART / 3) + 0.1 * np.eye(P),
    "slopes and noise": np.outer(PLACES - 5.5, PLACES - 5.5) / 12 + 0.02 * np.eye(P),
}


def true_epsilon(covariance):
    """From its double-centred form."""
    centring = np.eye(P) - 1 / P
    centred = centring @ covariance @ centring
    return np.trace(centred) ** 2 / ((P - 1) * np.trace(centred @ centred))


def draw(covariance, n_runs, seed):
    return np.random.default_rng(seed).multivariate_normal(np.zeros(P), covariance, n_runs)


@pytest.mark.parametrize("what", COVARIANCES)
@pytest.mark.parametrize("share_missing", [0.0, 0.15])
def test_many_runs_tell_it(what, share_missing):
    runs = draw(COVARIANCES[what], 400, 1)
    runs[np.random.default_rng(2).random(runs.shape) < share_missing] = np.nan
    true = true_epsilon(COVARIANCES[what])
    assert 0.85 * true < box_epsilon(runs, 400.0) < 1.15 * true


@pytest.mark.parametrize("what", COVARIANCES)
def test_three_runs_rarely_promise_too_much(what):
    found = [box_epsilon(draw(COVARIANCES[what], 3, seed), 3.0) for seed in range(60)]
    assert np.mean(np.array(found) > 1.2 * true_epsilon(COVARIANCES[what])) < 0.15
    assert min(found) >= 1 / (P - 1) - 1e-9


def test_two_stretches_have_one_difference():
    assert box_epsilon(draw(np.eye(P), 5, 3)[:, :2], 5.0) == 1.0
