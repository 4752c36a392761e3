"""Whether a poor day gains from the days before it, under the prior that everybody gets."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from stickslip_fit.bayes import weak_prior
from stickslip_fit.bayes.priors import build_group_data, predict_log_steps
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.laws import BaseAtOneReach, Prismatic
from stickslip_fit.machine import load_machine
from tests.bayes.conftest import simulate_counts

REPEATABILITY, CAMPAIGNS, DAYS = 0.003, 8, 8
MACHINE = load_machine()


def base_day():
    theta = np.radians([0.0, -90.0, -30.0, -60.0, 0.0, -45.0])
    stop = np.radians([120.0, 120.0, 120.0, 120.0, 0.0, 30.0])
    geometry = {"q2": np.radians(-90.0), "q3": 0.0, "theta": theta, "psi": 0.0, "stop": stop}
    return pd.DataFrame(geometry | {"start": np.radians(-120.0)})


def prismatic_day():
    q2, theta = np.radians([-90, 0, 0, -45, -135, -60]), np.radians([0, 0, -90, 0, 0, -45])
    return pd.DataFrame({"q2": q2, "theta": theta, "psi": 0.0, "start": 0.0, "stop": 0.012})


LAWS = {
    "base": (BaseAtOneReach(MACHINE, np.radians(-90.0), 0.0), base_day(), [95e-6, -14e-6], [4e-7, 4e-7]),
    "prismatic": (Prismatic(), prismatic_day(), [970e-9, 0.3, 430e-9], [15e-9, 0.004, 4e-9]),
}


def last_days(name, fitted):
    """Log steps of the traverses that the last day, with two, did not make, campaign by campaign.

    Yields the truth, shape (n,), draws for the last day and for one of which nothing is known, shape (d, n),
    and what least squares makes of the last day alone, shape (n,).
    """
    law, day, mean, spread = LAWS[name]
    for seed in range(CAMPAIGNS):
        rng = np.random.default_rng([seed, len(mean)])
        parameters = mean + np.array(spread) * rng.standard_normal((DAYS, len(mean)))
        full = pd.concat([day.assign(session=f"day {k}") for k in [*range(DAYS - 1)] * 2 + [DAYS - 1]])
        rows = full.assign(direction="+", check_every=5).sort_values("session", kind="stable")
        own = parameters[rows["session"].str[4:].astype(int)]
        rows["steps"] = simulate_counts(law, rows, own, REPEATABILITY, rng)
        unseen, rows = rows.iloc[-len(day) + 2 :], rows.iloc[: -len(day) + 2].reset_index(drop=True)
        draws = fitted(build_group_data(law, rows), weak_prior(law, rows), seed).draws
        new = draws.mean + draws.spread * rng.standard_normal(draws.mean.shape)
        alone, *_ = fit_joint(law, rows.iloc[-2:], MACHINE)
        yield (
            law.predict(unseen, parameters[-1]),
            *(predict_log_steps(law, unseen, each[:, None].repeat(len(unseen), 1))
              for each in (draws.parameters[:, -1], new)),
            law.predict(unseen, alone.values[0]) if alone.known.all() else np.full(len(unseen), np.nan),
        )  # fmt: skip


@pytest.fixture(scope="module", params=["base", pytest.param("prismatic", marks=pytest.mark.nightly)])
def outcome(request, fitted):
    """Each array with the campaigns first."""
    return request.param, *(np.array(each) for each in zip(*last_days(request.param, fitted), strict=True))


def rms(off):
    return np.sqrt(np.mean(off**2))


@pytest.mark.slow
def test_the_last_day_is_better_known_than_by_itself_or_by_the_others(outcome):
    name, truth, today, new, alone = outcome
    ours = rms(np.median(today, axis=1) - truth)
    assert ours < 0.6 * rms(np.median(new, axis=1) - truth)
    if name == "base":
        assert ours < 0.9 * rms(alone - truth)
    else:
        # Two traverses do not tell three parameters.
        assert np.isnan(alone).all()


@pytest.mark.slow
def test_its_intervals_cover(outcome):
    """Traverse by traverse, since those of one day go astray together."""
    _, truth, today, *_ = outcome
    off_centre = np.abs(np.mean(today < truth[:, None], axis=1) - 0.5)
    for share in (0.68, 0.95):
        low, high = binom.ppf([1e-4, 1 - 1e-4], CAMPAIGNS, share)
        inside = np.sum(off_centre < share / 2, axis=0)
        assert np.all((low <= inside) & (inside <= high))
