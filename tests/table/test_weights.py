"""Rows that are weighted: by a column of uncertainties, or as the noise grows with the response."""

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.cli import app
from stickslip_fit.errors import InputError

DECAY = "N ~ N0*exp(-t/tau) + b"


def decay(seed):
    """Counts of a source, 20,000 to 30, as noisy as their square roots."""
    t, rng = 20.0 * np.arange(120), np.random.default_rng(seed)
    expected = 20_000 * np.exp(-t / 300) + 30
    return pd.DataFrame({"t": t, "N": rng.poisson(expected), "u": 2 * np.sqrt(expected)})


def line(seed, effect=0.0):
    """A line with noise alike in all rows, and what a temperature or a curve adds."""
    rng = np.random.default_rng(seed)
    x, temperature = rng.uniform(0, 10, 80), rng.normal(21, 1, 80)
    y = 1 + 2 * x + effect * x**3 + 0.3 * rng.standard_normal(80)
    return pd.DataFrame({"x": x, "T": temperature, "y": y})


def text_of(result):
    return " ".join(str(result).split())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5000, *(pytest.param(k, marks=pytest.mark.nightly) for k in (5005, 5006))])
def test_counts_that_follow_their_law_raise_no_alarm(seed):
    """Where all rows count alike, each of these does."""
    found = ssf.diagnose_table(decay(seed).drop(columns="u"), DECAY, time="t", gain=False)
    assert found.verdict == "nothing wrong"
    noise = found.selection.problem.scale
    assert noise.max() / noise.min() == pytest.approx(np.sqrt(20_000 / 30), rel=0.5)
    assert "The noise of N grows with the response, from" in text_of(found)


def test_noise_that_is_a_share_of_the_response_raises_no_alarm():
    rng = np.random.default_rng(5000)
    x = rng.uniform(0.2, 20.0, 60)
    frame = pd.DataFrame({"x": x, "y": 3 * x**1.5 * np.exp(0.1 * rng.standard_normal(60))})
    found = ssf.diagnose_table(frame, ssf.Law("y ~ a*x**p", bounds={"p": (0.5, 3)}), gain=False)
    assert found.verdict == "nothing wrong"
    assert "grows with the response" in text_of(found)
    assert found.extended_law().parameters["estimate"].tolist() == pytest.approx([3.0, 1.5], rel=0.05)


@pytest.mark.parametrize("effect", [0.0, 0.002, 0.02])
def test_an_effect_that_grows_is_no_noise_that_does(effect):
    found = ssf.diagnose_table(line(1, effect), "y ~ a + b*x", gain=False)
    assert np.ptp(found.selection.problem.relative_sd) == 0.0
    assert "grows with" not in text_of(found)
    assert (found.verdict == "nothing wrong") == (effect == 0.0)


@pytest.mark.slow
def test_an_effect_in_noise_that_grows_is_named_with_its_size():
    rng = np.random.default_rng(3)
    x, temperature = rng.uniform(0.2, 20.0, 100), rng.normal(21.0, 1.0, 100)
    y = 3 * x**1.5 * (1 + 0.02 * rng.standard_normal(100)) + 0.2 * (temperature - 21)
    found = ssf.diagnose_table(
        pd.DataFrame({"x": x, "T": temperature, "y": y}),
        ssf.Law("y ~ a*x**p", bounds={"p": (0.5, 3)}),
        gain=False,
    )
    (finding,) = found.findings
    assert finding.cause == "covariate:T"
    assert finding.effect.estimate == pytest.approx(0.2 * np.std(temperature), rel=0.3)


@pytest.mark.nightly
def test_what_a_law_lacks_may_grow_as_the_noise_does():
    """A vapour pressure over five decades, 3 % off its law where the noise is 0.3 % of it."""
    rng = np.random.default_rng(0)
    kelvin = np.linspace(290.0, 630.0, 30)
    lack = 1.0 + 0.03 * np.cos(2.0 * np.pi * (kelvin - 290.0) / 340.0)
    pressure = 1e7 * np.exp(-7000.0 / kelvin) * lack * (1.0 + 0.003 * rng.standard_normal(30))
    found = ssf.diagnose_table(pd.DataFrame({"T": kelvin, "p": pressure}), "p ~ A*exp(-B/T)")
    assert found.verdict == "unknown cause"
    assert "follows T, as a share of what the law predicts, by" in text_of(found)
    assert found.gain.extended < 0.7 * found.gain.baseline
    fit = found.extended_law()
    frame = pd.DataFrame({"T": kelvin})
    assert fit.predict(frame)["predicted"].to_numpy() == pytest.approx(pressure, rel=0.02)
    # The derivatives by the law's own parameters are exact.
    law, values = found.selection.fit.parts[0].law, found.selection.fit.parts[0].values
    jacobian = law.jacobian(found.selection.problem.rows, values)
    for k in range(values.shape[1]):
        step = 1e-6 * np.maximum(np.abs(values), 1e-3) * (np.arange(values.shape[1]) == k)
        ends = [law.predict(found.selection.problem.rows, values + way * step) for way in (1, -1)]
        assert (ends[0] - ends[1]) / (2 * step[:, k]) == pytest.approx(jacobian[:, k], rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("seed", [42003, 42027, 42048])
def test_few_rows_over_decades_raise_no_alarm_though_their_noise_grows(seed):
    """1 % of a response that grows to 160 times its least: a share of a table of 7 rows."""
    rng = np.random.default_rng(seed)
    x = np.sort(np.exp(rng.uniform(-1.0, 3.4, 7)))
    frame = pd.DataFrame({"x": x, "y": x**1.5 * (1.0 + 0.01 * rng.standard_normal(7))})
    assert ssf.diagnose_table(frame, "y ~ k*x**1.5", gain=False).verdict == "nothing wrong"


def test_sigma_weighs_rows_and_only_its_ratios_count():
    rng = np.random.default_rng(0)
    x, u = np.arange(60.0), rng.uniform(0.1, 3.0, 60)
    frame = pd.DataFrame({"x": x, "u": u, "y": 1 + 2 * x + 0.5 * u * rng.standard_normal(60)})
    fit = ssf.fit_table(frame, "y ~ a + b*x", sigma="u")
    (b, a), covariance = np.polyfit(x, frame["y"], 1, w=1 / u, cov=True)
    assert fit.parameters["estimate"].tolist() == pytest.approx([a, b])
    assert fit.parameters["standard_error"].tolist() == pytest.approx(np.sqrt(np.diag(covariance))[::-1])
    other = ssf.fit_table(frame.assign(u=1000 * u), "y ~ a + b*x", sigma="u")
    assert other.parameters["standard_error"].tolist() == pytest.approx(
        fit.parameters["standard_error"].tolist()
    )
    assert fit.predict(frame.drop(columns="u"))["predicted"].to_numpy() == pytest.approx(a + b * x)


@pytest.mark.slow
def test_the_scale_of_sigma_is_told_and_sigma_is_no_candidate():
    found = ssf.diagnose_table(decay(1), DECAY, time="t", sigma="u", gain=False)
    assert found.verdict == "nothing wrong"
    assert "Rows are weighted by 1 / u^2; the noise is 0.4" in text_of(found)
    assert "covariate:u" not in found.inclusion
    assert found.table.roles["sigma"] == "u"


@pytest.mark.parametrize(("cell", "why"), [(0.0, "above 0"), (-1.0, "above 0"), ("wide", "no finite number")])
def test_what_is_no_uncertainty_is_refused(cell, why):
    frame = decay(1).astype({"u": object})
    frame.loc[3, "u"] = cell
    with pytest.raises(InputError, match=rf"row 4, .*{why}"):
        ssf.diagnose_table(frame, DECAY, sigma="u")


@pytest.mark.slow
def test_sigma_is_an_option_and_a_role_of_law_files(tmp_path):
    data, law = tmp_path / "decay.csv", tmp_path / "decay.toml"
    decay(1).to_csv(data, index=False)
    law.write_text(f'formula = "{DECAY}"\n[roles]\ntime = "t"\nsigma = "u"\n')
    for options in (["--law", str(law)], ["--law", DECAY, "--time", "t", "--sigma", "u"]):
        result = CliRunner().invoke(app, ["diagnose-table", str(data), *options])
        assert result.exit_code == 0, result.output
        assert "Rows are weighted by 1 / u^2" in result.output
