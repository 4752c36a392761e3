"""Closed forms beside one large multivariate normal of all counts, campaign means and sessions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from stickslip_fit.bayes.marginal import (
    find_mode,
    linearize,
    linearize_at_mode,
    solve_spd_batched,
)


def brute_force(traverses, prior, x):
    """Mean and covariance of (y, phi of every session), all at once."""
    p, sessions = len(prior.centre), len(traverses.groups)
    spread, repeatability = prior.levels(x)
    design = traverses.rows[["q2", "theta", "psi"]].to_numpy()
    pick = np.zeros((len(design), p * sessions))
    for row, session in enumerate(traverses.groups.of_row):
        pick[row, p * session : p * (session + 1)] = design[row]
    phi = block_diag(*[np.diag(spread**2)] * sessions)
    phi += np.tile(np.diag(prior.width**2), (sessions, sessions))
    mean = np.tile(prior.centre, sessions)
    cross = pick @ phi
    y_covariance = cross @ pick.T + np.diag(repeatability**2 + traverses.rounding)
    return 9.0 + pick @ mean, y_covariance, mean, phi, cross


@pytest.fixture(scope="module")
def x():
    return np.random.default_rng(2).normal(size=(5, 4))


@pytest.mark.parametrize("z", [0.0, 0.7])
def test_marginal_likelihood_is_that_of_the_multivariate_normal(linear_traverses, linear_prior, x, z):
    """Wherever a linear law is linearised."""
    marginal = linearize(linear_traverses, linear_prior, np.full((3, 3), z))
    found = marginal.conditional(x).log_likelihood
    for one, value in zip(x, found, strict=True):
        mean, covariance, *_ = brute_force(linear_traverses, linear_prior, one)
        assert value == pytest.approx(
            multivariate_normal(mean, covariance).logpdf(linear_traverses.y), abs=1e-8
        )


def test_sessions_given_the_levels_are_those_of_the_multivariate_normal(linear_traverses, linear_prior, x):
    given = linearize(linear_traverses, linear_prior, np.zeros((3, 3))).conditional(x)
    expected = linear_prior.centre[:, None, None] + linear_prior.width[:, None, None] * given.sessions(
        given.centre
    )
    for k, one in enumerate(x):
        mean, covariance, phi_mean, _, cross = brute_force(linear_traverses, linear_prior, one)
        best = phi_mean + cross.T @ np.linalg.solve(covariance, linear_traverses.y - mean)
        assert expected[:, :, k].T.ravel() == pytest.approx(best, abs=1e-10)


def test_draws_of_the_sessions_have_the_covariance_of_the_multivariate_normal(
    linear_traverses, linear_prior, x
):
    rng, one = np.random.default_rng(3), x[0]
    draws = 20_000
    given = linearize(linear_traverses, linear_prior, np.zeros((3, 3))).conditional(np.tile(one, (draws, 1)))
    mean = given.draw_mean(rng)
    z = given.sessions(mean) + given.draw_departures(rng)
    phi = (linear_prior.width[:, None, None] * z).transpose(2, 1, 0).reshape(draws, -1)
    _, covariance, _, phi_covariance, cross = brute_force(linear_traverses, linear_prior, one)
    wanted = phi_covariance - cross.T @ np.linalg.solve(covariance, cross)
    size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.cov(phi.T) / size == pytest.approx(wanted / size, abs=5 * np.sqrt(2 / draws))


def test_with_a_wide_prior_the_sessions_are_the_least_squares(linear_traverses, linear_prior):
    """Closed form, least squares and Bayes are one on a linear-Gaussian case."""
    wide = replace(linear_prior, width=np.full(3, 1e3), spread=np.full(3, 1e3))
    levels = np.zeros((1, 4))
    given = linearize(linear_traverses, wide, np.zeros((3, 3))).conditional(levels)
    found = wide.centre + (wide.width[:, None] * given.sessions(given.centre)[:, :, 0]).T
    weight = 1.0 / np.sqrt(wide.repeatability**2 + linear_traverses.rounding)
    design = linear_traverses.rows[["q2", "theta", "psi"]].to_numpy()
    for session in range(3):
        subset = linear_traverses.groups.of_row == session
        best, *_ = np.linalg.lstsq(
            design[subset] * weight[subset, None],
            (linear_traverses.y - 9.0)[subset] * weight[subset],
            rcond=None,
        )
        assert found[session] == pytest.approx(best, abs=1e-8)


def test_mode_and_curvature_of_a_known_density():
    root = np.array([[1.0, 0.0], [0.4, 0.3]])
    centre, covariance = np.array([1.0, -3.0]), root @ root.T
    density = multivariate_normal(centre, covariance)
    mode, found = find_mode(lambda x: density.logpdf(x), np.zeros(2))
    assert mode == pytest.approx(centre, abs=1e-6)
    assert found == pytest.approx(covariance, rel=1e-5)


def test_small_systems_are_solved():
    rng = np.random.default_rng(4)
    roots = rng.normal(size=(50, 4, 4))
    matrices = roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(4)
    right = rng.normal(size=(50, 4, 2))
    solution, log_determinant = solve_spd_batched(np.moveaxis(matrices, 0, -1), np.moveaxis(right, 0, -1))
    assert np.moveaxis(solution, -1, 0) == pytest.approx(np.linalg.solve(matrices, right), rel=1e-8)
    assert log_determinant == pytest.approx(np.linalg.slogdet(matrices)[1], rel=1e-10)


def test_a_nearly_linear_law_is_expanded_where_its_counts_are(traverses_of, tight_prior):
    """The expansion is about each session's own parameters, though the prior is far off."""
    rng = np.random.default_rng(5)
    truth = np.array([[900e-9, 0.25, 400e-9], [1000e-9, 0.33, 470e-9]])
    far = replace(tight_prior, centre=np.array([700e-9, 0.1, 0.0]), width=np.array([4e-7, 0.5, 4e-7]))
    marginal, _, _ = linearize_at_mode(traverses_of(truth, 0.001, rng, replicates=4), far)
    given = marginal.conditional(np.zeros((1, 4)))
    found = far.centre + (far.width[:, None] * given.sessions(given.centre)[:, :, 0]).T
    assert found == pytest.approx(truth, rel=0.01)
