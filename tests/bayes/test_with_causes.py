"""Causes in the hierarchical model: truths rank evenly, and it agrees with least squares."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.stats import kstwo

from stickslip_fit.bayes import Priors, fit_bayes, load_posterior
from stickslip_fit.bayes.estimator import sample_groups
from stickslip_fit.bayes.priors import CausePriors, build_group_data
from stickslip_fit.bayes.sampler import memory_backends
from stickslip_fit.causes import EndStopLatency, ExtendedLaw, ThermalWarmUp
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from tests.bayes.conftest import simulate_counts

CAUSES = (ThermalWarmUp(), EndStopLatency())
PRIORS = CausePriors(
    names=("thermal-warm-up.A", "thermal-warm-up.tau", "end-stop-latency.L"),
    units=("%", "min", "steps"),
    centre=np.array([0.05, 0.0, 0.0]),
    width=np.array([0.02, 1.0, 100.0]),
    lower=np.array([-np.inf, 300.0, -np.inf]),
    upper=np.array([np.inf, 3000.0, np.inf]),
)
SESSIONS = 2
ERROR = np.array([0.002, 60.0, 10.0])


def campaign(cases, sizes, rng, replicates=3):
    """Two joints' traverses in `+` with causes at work, the levels drawn from their priors; truths too."""
    data_by_group, truths, priors = {}, {}, {}
    for case in (cases["prismatic"], cases["elbow"]):
        group = (case.law.joint, "+")
        mean, spread, repeatability = (each[0] for each in case.prior.draw(1, rng))
        own = mean + spread * rng.standard_normal((SESSIONS, len(mean)))
        rows = case.traverses(own, repeatability, rng, replicates).rows
        rows = rows.assign(q1=0.0)
        for name in ("q2", "q3", "theta", "psi"):
            rows[name] = rows.get(name, 0.0)
        place = rows.groupby("session").cumcount().to_numpy()
        rows["session_seconds"] = 240.0 * place
        law = ExtendedLaw(case.law, CAUSES)
        each = np.repeat(own, len(rows) // SESSIONS, axis=0)
        values = np.column_stack([each, np.tile(sizes, (len(rows), 1))])
        rows["steps"] = simulate_counts(law, rows, values, repeatability, rng)
        data_by_group[group] = rows, case.law
        truths[group] = np.concatenate([mean, spread, [repeatability], own.ravel()])
        priors[group] = case.prior
    return data_by_group, truths, Priors(priors, PRIORS)


def ranks(cases, seed, wrong=None):
    rng = np.random.default_rng([seed, 11])
    sizes = PRIORS.draw(1, rng)[0]
    data_by_group, truths, priors = campaign(cases, sizes, rng)
    # Where least squares would have them: near, but not there.
    about = PRIORS.unstandardize(PRIORS.standardize(sizes + ERROR * rng.standard_normal(3)))
    held = {
        group: build_group_data(FixedCauseLaw(law, CAUSES, about), rows)
        for group, (rows, law) in data_by_group.items()
    }
    priors = replace(priors, causes=wrong or PRIORS)
    samples = sample_groups(
        held, priors, about, ERROR, {group: memory_backends() for group in held},
        seed=seed, target_ess=150, max_steps=100, on_step=lambda steps: None,
    )  # fmt: skip
    found, stands = [], True
    for group, sample in samples.items():
        draws, own, stands = sample.draws, len(sample.prior.names), stands and sample.converged
        x = np.concatenate(
            [draws.mean[:, :own], draws.spread[:, :own], draws.repeatability[:, None],
             draws.parameters[:, :, :own].reshape(len(draws), -1)], axis=1
        )  # fmt: skip
        found.append(np.mean(x < truths[group], axis=0))
    common = draws.mean[:, own:]
    return np.concatenate([np.mean(common < sizes, axis=0), *found]), stands


def study(cases, campaigns, wrong=None):
    """Largest distance of each ECDF of ranks from the uniform one, and the band none should leave."""
    found, stands = zip(*(ranks(cases, seed, wrong) for seed in range(campaigns)), strict=True)
    assert np.mean(stands) >= 0.9
    ordered, ladder = np.sort(found, axis=0), np.arange(campaigns + 1)[:, None] / campaigns
    distance = np.maximum(ladder[1:] - ordered, ordered - ladder[:-1]).max(axis=0)
    return distance, kstwo.ppf(1 - 0.001 / distance.size, campaigns)


@pytest.mark.nightly
def test_truths_rank_evenly_among_the_draws(cases):
    distance, band = study(cases, 6)
    assert np.all(distance < band), distance


@pytest.mark.nightly
def test_truths_rank_evenly_in_hundreds_of_campaigns(cases):
    distance, band = study(cases, 300)
    assert np.all(distance < band), distance


def test_priors_are_standard_normal_where_they_should_be():
    """Every kind of bound: none, one, and two, even in the logarithm or in the number itself."""
    mixed = CausePriors(
        ("free", "above", "log", "even", "held"), ("%", "%", "min", "1", "min"),
        np.array([0.1, 0.0, 0.0, 0.0, 7.0]), np.array([0.2, 0.3, 1.0, 1.0, 0.0]),
        np.array([-np.inf, -0.2, 10.0, -1.0, -np.inf]), np.array([np.inf, np.inf, 1000.0, 3.0, np.inf]),
    )  # fmt: skip
    values = mixed.draw(20_000, np.random.default_rng(1))
    laws = (
        stats.norm(0.1, 0.2), stats.truncnorm(-0.2 / 0.3, np.inf, 0.0, 0.3), stats.loguniform(10.0, 1000.0),
        stats.uniform(-1.0, 4.0),
    )  # fmt: skip
    for column, law in zip(values.T, laws, strict=False):
        assert stats.kstest(column, law.cdf).pvalue > 1e-3
    assert np.all(values[:, 4] == 7.0)
    again = mixed.unstandardize(mixed.standardize(values[:50]))
    np.testing.assert_allclose(again, values[:50], rtol=1e-9)
    restored = CausePriors.from_json(json.loads(json.dumps(mixed.to_json())))
    np.testing.assert_array_equal(restored.lower, mixed.lower)


@pytest.fixture(scope="module")
def warm(campaign, read_table):
    """Joint 3 in three sessions in which it warms up and a stop is heard late, by hand."""
    settings = tuple(
        {"joint": 3, "q2_deg": q2, "theta_deg": theta} for q2 in (-90.0, -45.0, 0.0) for theta in (0.0, -90.0)
    )
    table = campaign(("2012-03-05", "2012-03-06", "2012-03-09"), settings, replicates=4)
    time = pd.to_datetime(table["time"])
    seconds = (time - time.groupby(table["session"]).transform("min")).dt.total_seconds()
    factor = 1 + 0.04 * (1 - np.exp(-seconds / 1500.0))
    table = table.assign(steps=np.round(table["steps"] / factor + 150).astype(int), check_every=1)
    return read_table(table)


@pytest.fixture(scope="module")
def posterior(warm):
    return fit_bayes(warm, causes=CAUSES, target_ess=400, progress=False)


def test_sizes_of_causes_are_those_of_least_squares(warm, posterior):
    """Whose error bars hold, and whose sessions are their own: priors are weak beside so many counts."""
    wanted = fit_least_squares(warm, causes=CAUSES).si.parameters.set_index(["name", "direction", "session"])
    found = posterior.si.parameters.set_index(["name", "direction", "session"])
    for name in ("thermal-warm-up.A", "thermal-warm-up.tau", "end-stop-latency.L"):
        one, other = (table.loc[name].iloc[0] for table in (found, wanted))
        assert abs(one["estimate"] - other["estimate"]) < 0.4 * other["standard_error"]
        assert one["standard_error"] == pytest.approx(other["standard_error"], rel=0.2)
    a = found.loc["a"]["estimate"]
    assert np.all(np.abs(a - wanted.loc["a"]["estimate"]) < 0.5 * wanted.loc["a"]["standard_error"])


@pytest.mark.slow
def test_a_posterior_with_causes_is_saved_and_foretells_a_session_to_come(warm, posterior, tmp_path):
    posterior.save(tmp_path / "fit.nc")
    again = load_posterior(tmp_path / "fit.nc")
    assert again.priors.causes.names == posterior.priors.causes.names
    assert "thermal-warm-up.tau" in str(again)
    rows = warm.usable.iloc[:2].assign(session="tomorrow")
    cold, hot = (again.si.predict(rows.assign(session_seconds=t))["steps"].to_numpy() for t in (0.0, 1e5))
    assert (cold - 150) / (hot - 150) == pytest.approx([1.04] * 2, abs=0.004)
    assert again.diagnostics["k_hat"].max() < 0.7
    assert list(again.campaign_means()["name"]) == ["a", "b", "c"] * 2
    assert "<table" in again._repr_html_()


@pytest.mark.slow
def test_what_no_count_tells_is_the_prior_s_and_said_to_be(campaign, read_table):
    """A drive that does not warm up says nothing of how fast it would."""
    settings = tuple({"joint": 3, "q2_deg": q2, "theta_deg": at} for q2, at in ((-90, 0), (0, 0), (0, -90)))
    found = fit_bayes(
        read_table(campaign(("2012-03-05", "2012-03-06"), settings, replicates=3)),
        causes=CAUSES[:1],
        target_ess=300,
        progress=False,
    ).result
    table = found.si.parameters.set_index("name")
    assert np.isnan(table.loc["thermal-warm-up.tau", "estimate"])
    assert table.loc["thermal-warm-up.tau", "flags"] == ("not_identified",)
    assert table.loc["thermal-warm-up.A", "low"] < 0 < table.loc["thermal-warm-up.A", "high"]
