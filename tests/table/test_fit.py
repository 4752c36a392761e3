"""A table's law fitted: the estimates and standard errors of others, predictions, and what is saved."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
from scipy.signal import lfilter

import stickslip_fit as ssf
from stickslip_fit.causes import TableRoles
from stickslip_fit.estimation.result import compute_checksum
from tests.table.bench import LAW, TRUE, bench, design


def test_independent_noise_is_ordinary_least_squares():
    frame = bench(3, difference=0.0)
    fit, by_others = ssf.fit_table(frame, LAW), sm.OLS(frame["F"], design(frame, extended=False)).fit()
    table = fit.parameters
    assert list(table["name"]) == ["M", "Fv", "Fc", "offset"]
    assert table["estimate"].to_numpy() == pytest.approx(by_others.params.to_numpy(), rel=1e-6)
    assert table["standard_error"].to_numpy() == pytest.approx(by_others.bse.to_numpy(), rel=1e-6)
    assert table[["low", "high"]].to_numpy() == pytest.approx(by_others.conf_int().to_numpy(), rel=1e-6)
    assert fit.covariance == pytest.approx(by_others.cov_params().to_numpy(), rel=1e-6)


def test_correlated_noise_is_generalized_least_squares():
    """Not digit for digit: GLSAR drops the first row, and the parameters bias its phi towards 0."""
    frame = bench(4, n=600, difference=0.0, phi=0.7)
    fit = ssf.fit_table(frame, LAW, time="t")
    by_others = sm.GLSAR(frame["F"], design(frame, extended=False), rho=1)
    result = by_others.iterative_fit(20)
    assert fit.autocorrelation[0] == pytest.approx(by_others.rho[0], abs=0.03)
    errors = fit.parameters["standard_error"].to_numpy()
    assert errors == pytest.approx(result.bse.to_numpy(), rel=0.15)
    difference = fit.parameters["estimate"].to_numpy() - result.params.to_numpy()
    assert np.all(np.abs(difference) < 0.3 * errors)
    plain = sm.OLS(frame["F"], design(frame, extended=False)).fit()
    assert errors[3] > 1.5 * plain.bse.iloc[3]


@pytest.mark.slow
def test_the_extended_laws_intervals_are_those_of_gls_given_the_noise(named):
    fit = named.extended_law()
    frame = bench(1, phi=0.6)
    n, (phi,) = len(frame), fit.autocorrelation
    correlation = fit.noise_sd**2 * phi ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    by_others = sm.GLS(frame["F"], design(frame, extended=True), sigma=correlation).fit()
    assert fit.parameters["estimate"].to_numpy() == pytest.approx(by_others.params.to_numpy(), rel=1e-3)
    expected = np.sqrt(np.diag(by_others.normalized_cov_params))
    assert fit.parameters["standard_error"].to_numpy() == pytest.approx(expected, rel=1e-3)
    (parameter,) = named.findings[0].parameters
    row = fit.parameters.iloc[-1]
    assert parameter.size.estimate == pytest.approx(row["estimate"], rel=1e-3)
    width = parameter.size.high - parameter.size.low
    assert width == pytest.approx(2 * 1.96 * row["standard_error"], rel=0.02)


@pytest.mark.nightly
def test_intervals_cover_the_truth_under_autocorrelation():
    inside = []
    for seed in range(200):
        table = ssf.fit_table(bench(seed, difference=0.0, phi=0.7), LAW, time="t").parameters
        true = table["name"].map(TRUE)
        inside.append(((table["low"] < true) & (true < table["high"])).to_numpy())
    assert np.all(np.mean(inside, axis=0) > 0.89)


def two_runs(seed=5, n=300):
    first, second = (bench(one, n, difference=0.0) for one in (seed, seed + 1))
    second = second.assign(F=second["F"] + 1.0, t=second["t"] + 100.0)
    return pd.concat([first.assign(run="a"), second.assign(run="b")], ignore_index=True)


@pytest.mark.slow
def test_parameters_of_many_short_sessions_have_intervals_that_cover_and_are_no_wider():
    """44 parameters, and noise in which 1,034 values count as about 57: 57 - 44 is no number of freedoms."""
    rng, within, reach = np.random.default_rng(1), [], []
    seconds = np.arange(47) / 15
    for _ in range(3):
        noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal((22, 200)))[:, -47:]
        frame = pd.DataFrame({"run": np.repeat(np.arange(22), 47), "t": np.tile(seconds, 22)})
        frame["y"] = 1.0 + 2.0 * frame["t"] + 0.1 * noise.ravel()
        table = ssf.fit_table(frame, ssf.Law("y ~ a + b*t"), session="run", time="t").parameters
        true = table["name"].map({"a": 1.0, "b": 2.0})
        within += [*table["low"].le(true) & true.le(table["high"])]
        reach += [*(table["high"] - table["low"]) / (2 * table["standard_error"])]
    assert np.mean(within) == pytest.approx(0.94, abs=0.045)
    assert max(reach) < 2.2


def test_each_session_has_its_own_values_and_shared_ones_have_one():
    frame = two_runs()
    own = ssf.fit_table(frame, LAW, session="run").parameters
    assert list(own["session"]) == ["a"] * 4 + ["b"] * 4
    shared = ssf.fit_table(frame, LAW, session="run", shared=["M", "Fv", "Fc"]).parameters
    assert [*zip(shared["name"], shared["session"], strict=True)] == [
        ("offset", "a"), ("offset", "b"), ("M", None), ("Fv", None), ("Fc", None)
    ]  # fmt: skip
    x = np.column_stack([frame["run"] == "a", frame["run"] == "b", design(frame, extended=False)[:, :3]])
    by_others = sm.OLS(frame["F"], x.astype(float)).fit()
    assert shared["estimate"].to_numpy() == pytest.approx(by_others.params.to_numpy(), rel=1e-6)
    assert shared["standard_error"].to_numpy() == pytest.approx(by_others.bse.to_numpy(), rel=1e-6)


def test_a_law_that_overflows_at_some_start_values_is_fitted_without_a_word():
    """A discharge under a set voltage, which is the same in all of a run: of it no width says anything."""
    rng, t = np.random.default_rng(202), np.tile(0.25 * np.arange(80), 3)
    frame = pd.DataFrame({"run": np.repeat([1, 2, 3], 80), "t": t})
    frame["V_set"] = np.repeat([5.0, 9.0, 12.0], 80)
    frame["V"] = frame["V_set"] * np.exp(-t / 10.0) + 0.008 * rng.standard_normal(240)
    fitted = ssf.fit_table(frame, "V ~ V_set*exp(-t/tau)", session="run").parameters
    assert fitted["estimate"].to_numpy(float) == pytest.approx(np.full(3, 10.0), rel=0.01)


def test_predictions_are_those_of_others_in_whatever_order_and_cover_new_values():
    frame = bench(3, difference=0.0)
    fit, by_others = ssf.fit_table(frame, LAW), sm.OLS(frame["F"], design(frame, extended=False)).fit()
    new = bench(9, difference=0.0).sample(frac=1.0, random_state=1)
    predicted = fit.predict(new.drop(columns="F"))
    expected = by_others.get_prediction(design(new, extended=False)).summary_frame()
    assert list(predicted.index) == list(new.index)
    names = {"predicted": "mean", "standard_error": "mean_se", "low": "obs_ci_lower", "high": "obs_ci_upper"}
    for name, other in names.items():
        assert predicted[name].to_numpy() == pytest.approx(expected[other].to_numpy(), rel=1e-6), name
    assert 0.9 < np.mean((predicted["low"] < new["F"]) & (new["F"] < predicted["high"])) < 0.99


def test_a_session_that_was_not_fitted_and_a_missing_column_are_refused():
    fit = ssf.fit_table(two_runs(), LAW, session="run")
    with pytest.raises(ssf.InputError, match="session c; sessions fitted: a, b"):
        fit.predict(two_runs().assign(run="c"))
    with pytest.raises(ssf.InputError, match="vel"):
        fit.predict(two_runs().drop(columns="vel"))


@pytest.mark.nightly
def test_time_is_counted_from_where_the_fitted_session_began():
    """A drift's later half, predicted by itself, is where it was."""
    frame = bench(7, difference=0.0)
    frame["F"] += 0.8 * frame["t"]
    fit = ssf.diagnose_table(frame, LAW, time="t", gain=False).extended_law()
    assert "session_seconds" in fit.law.columns
    whole, half = fit.predict(frame), fit.predict(frame.iloc[200:])
    pd.testing.assert_frame_equal(whole.iloc[200:], half)


@pytest.fixture
def saved(named, tmp_path):
    path = tmp_path / "law.json"
    named.extended_law().save(path)
    return path


def test_what_is_loaded_is_what_was_saved(named, saved):
    fit, again = named.extended_law(), ssf.load_table_fit(saved)
    pd.testing.assert_frame_equal(fit.parameters, again.parameters)
    pd.testing.assert_frame_equal(fit.residuals, again.residuals, check_dtype=False)
    pd.testing.assert_frame_equal(fit.predict(bench(8)), again.predict(bench(8)))
    assert str(fit) == str(again)


@pytest.mark.slow
def test_generic_causes_and_sessions_are_saved(tmp_path):
    frame = two_runs(n=150)
    frame["F"] += 0.3 * (frame["t"] % 100.0) ** 2
    law = replace(LAW, units={**LAW.units, "t": "min"})
    diagnosis = ssf.diagnose_table(frame, law, session="run", time="t", position="q", gain=False)
    fit = diagnosis.extended_law()
    assert diagnosis.verdict != "nothing wrong"
    assert fit.law.columns != fit.law.law.columns
    fit.save(tmp_path / "law.json")
    again = ssf.load_table_fit(tmp_path / "law.json")
    pd.testing.assert_frame_equal(fit.predict(frame), again.predict(frame))
    assert again.roles == TableRoles("run", "t", "q", time_unit="min")


def edited(path, change):
    content = json.loads(path.read_text("utf-8"))
    change(content)
    path.write_text(json.dumps(content), "utf-8")
    return path


def test_a_file_that_was_edited_is_refused(saved):
    edited(saved, lambda content: content["values"][0].__setitem__(0, 7.0))
    with pytest.raises(ssf.InputError, match="its checksum is another"):
        ssf.load_table_fit(saved)


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.update(values=[[1.0]]),
        lambda content: content["covariance"][0].__setitem__(0, -1.0),
        lambda content: content["law"]["source"].update(formula="__import__('os').system('true') ~ 1"),
        lambda content: content["law"]["causes"][0].update(kind="os"),
        lambda content: content.pop("roles"),
    ],
)
def test_a_damaged_file_is_one_message(saved, change):
    def with_checksum(content):
        change(content)
        content["checksum"] = compute_checksum(content)

    with pytest.raises(ssf.InputError, match="is a damaged fit"):
        ssf.load_table_fit(edited(saved, with_checksum))


def test_other_files_are_refused(tmp_path, named):
    path = tmp_path / "x.json"
    for text in (
        "",
        "{}",
        "[1]",
        '{"schema": "stickslip-fit/result/1"}',
        '{"schema": "stickslip-fit/table-fit/2"}',
    ):
        path.write_text(text)
        with pytest.raises(ssf.InputError, match=r"x\.json: (is no|was made by a newer)"):
            ssf.load_table_fit(path)
    with pytest.raises(ssf.InputError, match="cannot be read"):
        ssf.load_table_fit(tmp_path / "none.json")


def test_the_table_is_not_written_over(named, file):
    before = file.read_bytes()
    with pytest.raises(ssf.InputError):
        named.extended_law().save(file)
    assert file.read_bytes() == before


def friction(vel, Fv, Fc):
    return Fv * vel + Fc * np.sign(vel)


def test_functions_are_handed_over_again(tmp_path):
    """A file makes nothing be imported."""
    fit = ssf.fit_table(bench(3, difference=0.0), ssf.Law(friction, response="F"))
    fit.save(tmp_path / "law.json")
    with pytest.raises(ssf.InputError, match=r"has the functions .*:friction: hand them over"):
        ssf.load_table_fit(tmp_path / "law.json")
    again = ssf.load_table_fit(tmp_path / "law.json", functions=[friction])
    pd.testing.assert_frame_equal(fit.predict(bench(1)), again.predict(bench(1)))
    local = ssf.fit_table(bench(3), ssf.Law(lambda vel, Fv: Fv * vel, response="F"))
    with pytest.raises(ssf.InputError, match="cannot be saved"):
        local.save(tmp_path / "other.json")
    assert not (tmp_path / "other.json").exists()


@pytest.mark.parametrize(("noise", "words"), [(0.3, "99.0 %"), (0.0001, "more than 99.9 %")])
def test_a_share_of_the_variance_has_digits_that_say_something(noise, words):
    x = np.linspace(0.0, 9.5, 200)
    table = pd.DataFrame({"x": x, "y": 1.0 * x + noise * np.random.default_rng(1).standard_normal(len(x))})
    fit = ssf.diagnose_table(table, ssf.Law("y ~ k*x"), gain=False).extended_law()
    assert f"{words} of its variance explained" in " ".join(str(fit).split())


def test_a_parameter_on_its_bound_has_no_standard_error():
    law = ssf.Law(LAW.formula, bounds={"Fv": (6.0, 9.0)})
    fit = ssf.fit_table(bench(3, difference=0.0), law)
    row = fit.parameters.set_index("name").loc["Fv"]
    assert row["estimate"] == 6.0
    assert np.isnan(row["standard_error"])
    assert "Fv is on a bound" in " ".join(fit.flags)
    assert "Fv is on a bound" in str(fit)
