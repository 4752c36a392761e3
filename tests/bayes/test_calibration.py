"""Simulation-based calibration and coverage under each published law, with truths drawn from the prior."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstwo

from stickslip_fit.bayes.marginal import MarginalLikelihood
from stickslip_fit.bayes.priors import predict_log_steps

SESSIONS = 3
WITHHELD = 0.01  # share of campaigns whose fit may say of itself that it is not to be believed


def campaign_ranks(case, fitted, fit_prior, sessions, seed):
    """Ranks of a campaign's truths among their posterior draws, and whether the fit stands by its draws.

    The quantities are the campaign's mean and spread, the repeatability, every session's parameters, those
    of a session to come, and log steps in a configuration that was not logged: of the last session, and of
    the one to come.
    """
    rng = np.random.default_rng([seed, sessions])
    mean, spread, repeatability = (each[0] for each in case.prior.draw(1, rng))
    parameters = mean + spread * rng.standard_normal((sessions + 1, len(mean)))
    traverses = case.traverses(parameters[:-1], repeatability, rng)
    got = fitted(traverses, fit_prior, seed, target_ess=200, max_steps=100)
    draws = got.draws
    fresh = draws.mean + draws.spread * rng.standard_normal(draws.mean.shape)
    everyones = np.concatenate([draws.parameters, fresh[:, None]], axis=1)
    pairs = [
        (draws.mean, mean),
        (draws.spread, spread),
        (draws.repeatability[:, None], repeatability),
        *((everyones[:, session], parameters[session]) for session in range(sessions + 1)),
        *(
            (
                predict_log_steps(case.law, case.to_come, everyones[:, [one]]),
                case.law.predict(case.to_come, own),
            )
            for one, own in ((-2, parameters[-2]), (-1, parameters[-1]))
        ),
    ]
    return np.concatenate([np.mean(drawn < truth, axis=0) for drawn, truth in pairs]), got.converged


def study(case, fitted, fit_prior, campaigns, sessions=SESSIONS):
    """Ranks in many campaigns, shape (campaigns, quantities); few fits may disown their draws."""
    ranks, stands = zip(
        *(campaign_ranks(case, fitted, fit_prior, sessions, seed) for seed in range(campaigns)), strict=True
    )
    assert np.mean(stands) >= 1 - WITHHELD
    return np.array(ranks)


def departures(ranks):
    """Largest distance of each quantity's ECDF from the uniform one, and the band none should leave."""
    n, quantities = ranks.shape
    ordered = np.sort(ranks, axis=0)
    ladder = np.arange(n + 1)[:, None] / n
    distance = np.maximum(ladder[1:] - ordered, ordered - ladder[:-1]).max(axis=0)
    return distance, kstwo.ppf(1 - 0.001 / quantities, n)


def coverage(ranks, share):
    """How many central intervals hold the truth, of each quantity, and between what limits that should be."""
    n, quantities = ranks.shape
    inside = np.sum(np.abs(ranks - 0.5) < share / 2, axis=0)
    return inside, binom.ppf([0.0005 / quantities, 1 - 0.0005 / quantities], n, share)


def check(ranks):
    distance, band = departures(ranks)
    assert np.all(distance < band), distance
    for share in (0.68, 0.95):
        inside, (low, high) = coverage(ranks, share)
        assert np.all((low <= inside) & (inside <= high)), (share, inside)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law", ["prismatic", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("elbow", "base"))]
)
def test_truths_rank_evenly_among_the_draws_and_intervals_cover(cases, fitted, law):
    check(study(cases[law], fitted, cases[law].prior, 6))


@pytest.mark.nightly
def test_a_wrong_prior_scale_is_found_out(cases, fitted):
    """The check is worth something: spread between sessions believed a fifth of what it is."""
    case = cases["prismatic"]
    wrong = replace(case.prior, spread=case.prior.spread / 5, spread_factor=1.2)
    distance, band = departures(study(case, fitted, wrong, 8))
    assert np.any(distance > band)


@pytest.mark.nightly
def test_a_forgotten_jacobian_is_found_out(cases, fitted, monkeypatch):
    """A density in the spreads taken for one in their logarithms, where one session says little of them."""
    factor = 4.0
    right, case = MarginalLikelihood.log_density, cases["prismatic"]
    vague = replace(case.prior, spread=case.prior.spread / 5, spread_factor=factor)

    def without_jacobian(self, x):
        return right(self, x) - np.log(factor) * x[:, :-1].sum(axis=1)

    monkeypatch.setattr(MarginalLikelihood, "log_density", without_jacobian)
    distance, band = departures(study(replace(case, prior=vague), fitted, vague, 20, sessions=1))
    assert np.any(distance > band)


@pytest.mark.nightly
@pytest.mark.parametrize("sessions", [1, 3, 20])
@pytest.mark.parametrize("law", ["prismatic", "elbow", "base"])
def test_truths_rank_evenly_and_intervals_cover_in_a_thousand_campaigns(cases, fitted, law, sessions):
    check(study(cases[law], fitted, cases[law].prior, 1000, sessions))
