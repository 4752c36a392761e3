"""Simulation-based calibration and coverage, with truths drawn from the prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstwo

from stickslip_fit.fit.bayes.marginal import Marginal
from stickslip_fit.fit.bayes.traverses import predict_draws

SESSIONS = 3


@pytest.fixture(scope="module")
def ranks_of(traverses_of, fitted):
    """A maker of ranks of truths among their posterior draws, shape (campaigns, quantities)."""

    def ranks(truth_prior, fit_prior, campaigns, sessions=SESSIONS, target_ess=200):
        found = []
        for seed in range(campaigns):
            rng = np.random.default_rng([seed, sessions])
            mean, spread, repeatability = (each[0] for each in truth_prior.draw(1, rng))
            parameters = mean + spread * rng.standard_normal((sessions, len(mean)))
            traverses = traverses_of(parameters, repeatability, rng)
            got = fitted(traverses, fit_prior, seed, target_ess, max_steps=100)
            assert got.quality["k_hat"].max() < 0.7
            row = traverses.rows.iloc[[5]]
            todays = got.draws.parameters[:, -1]
            pairs = [
                *zip(got.draws.mean.T, mean, strict=True),
                *zip(got.draws.spread.T, spread, strict=True),
                (got.draws.repeatability, repeatability),
                *zip(todays.T, parameters[-1], strict=True),
                (
                    predict_draws(traverses.law, row, todays[:, None])[:, 0],
                    traverses.law.predict(row, parameters[-1])[0],
                ),
            ]
            found.append([np.mean(draws < truth) for draws, truth in pairs])
        return np.array(found)

    return ranks


def departures(ranks):
    """Largest distance of each quantity's ECDF from the uniform one, and the band none should leave."""
    n, quantities = ranks.shape
    ordered = np.sort(ranks, axis=0)
    ladder = np.arange(n + 1)[:, None] / n
    distance = np.maximum(ladder[1:] - ordered, ordered - ladder[:-1]).max(axis=0)
    return distance, kstwo.ppf(1 - 0.001 / quantities, n)


def check_coverage(ranks):
    n, quantities = ranks.shape
    for share in (0.68, 0.95):
        inside = np.sum(np.abs(ranks - 0.5) < share / 2, axis=0)
        low, high = binom.ppf([0.0005 / quantities, 1 - 0.0005 / quantities], n, share)
        assert np.all((low <= inside) & (inside <= high)), (share, inside / n)


@pytest.fixture(scope="module")
def ranks(ranks_of, tight_prior):
    return ranks_of(tight_prior, tight_prior, 24)


def test_truths_rank_evenly_among_the_draws(ranks):
    distance, band = departures(ranks)
    assert np.all(distance < band), distance


def test_intervals_cover(ranks):
    check_coverage(ranks)


def test_a_wrong_prior_scale_is_found_out(ranks_of, tight_prior):
    """The check is worth something: spread between sessions believed a fifth of what it is."""
    wrong = replace(tight_prior, spread=tight_prior.spread / 5, spread_factor=1.2)
    distance, band = departures(ranks_of(tight_prior, wrong, 8))
    assert np.any(distance > band)


def test_a_forgotten_jacobian_is_found_out(ranks_of, tight_prior, monkeypatch):
    """A density in the spreads taken for one in their logarithms, where one session says little of them."""
    factor = 4.0
    vague = replace(tight_prior, spread=tight_prior.spread / 5, spread_factor=factor)
    right = Marginal.log_density

    def without_jacobian(self, x):
        return right(self, x) - np.log(factor) * x[:, :-1].sum(axis=1)

    monkeypatch.setattr(Marginal, "log_density", without_jacobian)
    distance, band = departures(ranks_of(vague, vague, 20, sessions=1))
    assert np.any(distance > band)


@pytest.mark.nightly
@pytest.mark.parametrize("sessions", [1, 3, 20])
def test_truths_rank_evenly_and_intervals_cover_in_a_thousand_campaigns(ranks_of, tight_prior, sessions):
    ranks = ranks_of(tight_prior, tight_prior, 1000, sessions)
    distance, band = departures(ranks)
    assert np.all(distance < band), distance
    check_coverage(ranks)
