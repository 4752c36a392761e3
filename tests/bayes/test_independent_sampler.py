"""The same hierarchical model, written out again and sampled by nested sampling."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares
from scipy.special import ndtri
from scipy.stats import kurtosis

from stickslip_fit.bayes import Prior
from stickslip_fit.bayes.priors import build_group_data
from stickslip_fit.laws import Configuration, ConstantStep

TRUTHS = np.array(
    [[970e-9, 0.30, 440e-9], [990e-9, 0.31, 430e-9], [950e-9, 0.29, 425e-9], [965e-9, 0.31, 450e-9]]
)
BOX = 9.0  # standard errors, under the prior's repeatability
REPEATED = 30


def nested(log_steps, traverses, prior, seed, **settings):
    """Posterior of (mean, log spread, log repeatability, each session's parameters) by dynesty.

    Returns mean and standard deviation of each, and the Monte Carlo errors of both, from repeated runs as
    dynesty simulates them; the weights alone say two thirds of that.
    """
    dynesty = pytest.importorskip("dynesty", reason="dynesty is not installed (the extra test)")
    from dynesty.utils import jitter_run, resample_run

    p, sessions = len(prior.centre), len(traverses.groups)
    counts = traverses.rows["steps"].to_numpy() - 2.5
    y, rounding = np.log(counts), (5 / np.sqrt(12) / counts) ** 2
    session = pd.factorize(traverses.rows["session"])[0]

    def misfit(parameters):
        return y - log_steps(parameters[session].T)

    # Sessions begin even within boxes that hold all their posterior, and the campaign's density goes to the
    # likelihood: the same posterior, without the funnel in which nested sampling gets stuck.
    best = least_squares(
        lambda z: misfit(prior.centre + prior.width * z.reshape(sessions, p)), np.zeros(sessions * p)
    )
    error = BOX * prior.repeatability * np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))

    def transform(u):
        z = ndtri(np.clip(u[: 2 * p + 1], 1e-12, 1 - 1e-12))
        mean = prior.centre + prior.width * z[:p]
        log_spread = np.log(prior.spread) + np.log(prior.spread_factor) * z[p : 2 * p]
        log_noise = np.log(prior.repeatability) + np.log(prior.repeatability_factor) * z[2 * p]
        within = (best.x + error * (2 * u[2 * p + 1 :] - 1)).reshape(sessions, p)
        return np.concatenate([mean, log_spread, [log_noise], (prior.centre + prior.width * within).ravel()])

    def log_likelihood(x):
        parameters = x[2 * p + 1 :].reshape(sessions, p)
        variance = np.exp(2 * x[2 * p]) + rounding
        departure = (parameters - x[:p]) / np.exp(x[p : 2 * p])
        return -0.5 * np.sum(misfit(parameters) ** 2 / variance + np.log(2 * np.pi * variance)) - np.sum(
            0.5 * departure**2 + x[p : 2 * p]
        )

    dimensions = 2 * p + 1 + sessions * p
    sampler = dynesty.NestedSampler(
        log_likelihood, transform, dimensions, rstate=np.random.default_rng(seed), **settings
    )
    sampler.run_nested(print_progress=False, dlogz=0.1)
    results, rng = sampler.results, np.random.default_rng(seed)
    outer = np.any(np.abs(2 * results.samples_u[:, 2 * p + 1 :] - 1) > 0.8, axis=1)
    assert importance(results) @ outer < 1e-3, "the boxes cut the posterior"
    again = [jitter_run(resample_run(results, rstate=rng), rstate=rng) for _ in range(REPEATED)]
    repeated = np.array([moments(run.samples, importance(run)) for run in again])
    return *moments(results.samples, importance(results)), *repeated.std(axis=0)


def importance(results):
    weight = np.exp(results.logwt - results.logwt.max())
    return weight / weight.sum()


def moments(x, weight):
    mean = weight @ x
    return mean, np.sqrt(weight @ (x - mean) ** 2)


def ours(found):
    """The same of our draws, with the errors of as many independent ones as they are worth."""
    draws = found.draws
    columns = [draws.mean, np.log(draws.spread), np.log(draws.repeatability)[:, None]]
    x = np.concatenate([*columns, draws.parameters.reshape(len(draws), -1)], axis=1)
    size = found.quality["ess_bulk"].to_numpy()
    mean, sd = x.mean(axis=0), x.std(axis=0)
    return mean, sd, sd / np.sqrt(size), sd * np.sqrt((kurtosis(x, fisher=False) - 1) / (4 * size))


def check_agreement(found, theirs):
    """Means and standard deviations within Monte Carlo error: of the campaign, the noise and all sessions."""
    mean, sd, mean_error, sd_error = ours(found)
    their_mean, their_sd, their_mean_error, their_sd_error = theirs
    assert np.abs((mean - their_mean) / np.hypot(mean_error, their_mean_error)).max() < 4.0
    assert np.abs((sd - their_sd) / np.hypot(sd_error, their_sd_error)).max() < 4.0


@pytest.mark.nightly
@pytest.mark.nightly
def test_constant_step_agrees_with_nested_sampling(traverses_of, fitted):
    law = ConstantStep(3, Configuration("anywhere"))
    rows = traverses_of(TRUTHS, 0.003, np.random.default_rng(1), replicates=4).rows
    traverses = build_group_data(law, rows[np.isclose(rows["q2"], -np.pi / 2)].reset_index(drop=True))
    prior = Prior(
        ("gamma",), ("nm",), np.array([970e-9]), np.array([30e-9]), np.array([15e-9]), 0.003, 2.0, 1.5
    )
    theirs = nested(lambda x: np.log(0.012 / x[0]), traverses, prior, 1, nlive=200, sample="rwalk")
    check_agreement(fitted(traverses, prior, target_ess=2000, max_steps=400), theirs)


@pytest.mark.nightly
def test_prismatic_joint_agrees_with_nested_sampling(traverses_of, tight_prior, fitted):
    """Nineteen dimensions."""
    traverses = traverses_of(TRUTHS, 0.003, np.random.default_rng(1))
    recoil = np.abs(np.cos(traverses.rows["q2"].to_numpy()))
    load = np.cos(traverses.rows["q2"].to_numpy()) * np.cos(traverses.rows["theta"].to_numpy())

    def log_steps(x):
        a, b, c = x
        return np.log(0.012 / ((1 - b * recoil) * (a - c * load)))

    theirs = nested(log_steps, traverses, tight_prior, 2, nlive=600, sample="rwalk", walks=80)
    check_agreement(fitted(traverses, tight_prior, target_ess=2000, max_steps=400), theirs)
