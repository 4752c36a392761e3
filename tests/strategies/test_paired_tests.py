"""Variances that borrow from each other, and the verdicts that rest on them."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from stickslip_fit.strategies.statistics import INDISTINGUISHABLE, compare_pairs, shrink_variances

SESSIONS = 3


@pytest.mark.parametrize("prior", [4.0, 12.0])
def test_how_much_variances_have_in_common_is_found_again(prior):
    """Drawn as Smyth's model has it: s0^2 d0 / chi2(d0), each then seen with 2 degrees of freedom."""
    rng = np.random.default_rng(1)
    true = 0.09 * prior / chi2.rvs(prior, size=40_000, random_state=rng)
    shrunk, df = shrink_variances(
        true * chi2.rvs(2, size=len(true), random_state=rng) / 2, df=2, max_df=10**6
    )
    assert df == pytest.approx(prior + 2, rel=0.15)
    # The best guess of each, in the mean of its inverse, is the truth.
    assert np.mean(shrunk / true) == pytest.approx(1.0, rel=0.03)


def test_without_company_a_variance_stays_as_it_is():
    shrunk, df = shrink_variances(np.array([1.0, 4.0]), df=2, max_df=2)
    assert (shrunk.tolist(), df) == ([1.0, 4.0], 2.0)


def errors_of(rms: np.ndarray) -> pd.DataFrame:
    """One traverse in each session whose relative error is the strategy's rms there, (sessions, k)."""
    sessions, strategies = np.indices(rms.shape)
    return pd.DataFrame(
        {
            "strategy": [f"s{k}" for k in strategies.ravel()], "session": sessions.ravel(),
            "absolute": rms.ravel(), "relative": rms.ravel(),
        }
    )  # fmt: skip


def drawn(rng: np.random.Generator, better: float) -> np.ndarray:
    """Ten strategies in three sessions, some less steady than others; the first `better` times as good."""
    steady = 0.15 * np.exp(rng.uniform(0.0, 1.2, 10))
    day = 0.3 * rng.standard_normal((SESSIONS, 1))
    rms = np.exp(day + steady * rng.standard_normal((SESSIONS, 10)))
    rms[:, 0] /= better
    return rms


@pytest.mark.slow
@pytest.mark.parametrize("logs", [80, pytest.param(2000, marks=pytest.mark.nightly)])
def test_strategies_that_are_alike_are_rarely_told_apart(logs):
    rng = np.random.default_rng(2)
    wrong = sum(
        (compare_pairs(errors_of(drawn(rng, 1.0)), ("session",))["verdict"] != INDISTINGUISHABLE).any()
        for _ in range(logs)
    )
    assert wrong <= 0.05 * logs + 3 * np.sqrt(0.05 * 0.95 * logs)


@pytest.mark.slow
def test_three_sessions_show_a_strategy_that_is_six_times_as_good():
    rng, logs = np.random.default_rng(3), 60
    seen = [
        (pairs.loc[pairs["strategy"] == "s0", "verdict"] == "better").mean()
        for pairs in (compare_pairs(errors_of(drawn(rng, 6.0)), ("session",)) for _ in range(logs))
    ]
    assert np.mean(seen) > 0.8
