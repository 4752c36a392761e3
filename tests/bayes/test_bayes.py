"""The fit of a whole log: what it returns, what it refuses, and what it says of poor input."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.bayes import (
    fit_bayes,
    leave_one_out,
    load_posterior,
    predictive_p_values,
    weak_priors,
)
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.moves import predict

JOINT_3 = tuple(
    {"joint": 3, "q2_deg": q2, "theta_deg": theta}
    for q2, theta in ((-90.0, 0.0), (0.0, -90.0), (0.0, 0.0), (-45.0, 0.0), (-150.0, 0.0))
)
SESSIONS = ("2012-03-05", "2012-03-06", "2012-03-07")


@pytest.fixture(scope="module")
def log(campaign, read_table):
    return read_table(campaign(sessions=SESSIONS, settings=JOINT_3))


@pytest.fixture(scope="module")
def posterior(log):
    return fit_bayes(log, progress=False)


def flags(result):
    return {flag.flag for flag in result.flags}


def test_agrees_with_least_squares_where_the_counts_decide(log, posterior):
    ours, theirs = posterior.si.parameters, fit_least_squares(log).si.parameters
    assert np.abs((ours["estimate"] - theirs["estimate"]) / theirs["standard_error"]).max() < 1.0
    assert posterior.flags == ()
    # Days without day-to-day spread lend each other strength.
    assert (ours["standard_error"] < 1.1 * theirs["standard_error"]).all()


def test_every_parameter_has_the_effective_draws_that_were_asked_for(posterior):
    quality = posterior.diagnostics
    assert quality["ess_bulk"].min() >= 1000
    assert quality["r_hat"].max() < 1.01
    assert quality["k_hat"].max() < 0.7
    spreads = {f"spread of {name}" for name in "abc"}
    assert set(quality["parameter"]) == {"a", "b", "c", "repeatability"} | spreads


@pytest.mark.slow
def test_the_same_seed_gives_the_same_numbers(log):
    forward = log.select(log.rows["direction"] == "+")
    one, again, other = (
        fit_bayes(forward, seed=seed, target_ess=200, progress=False).result for seed in (0, 0, 1)
    )
    assert again.si.parameters.equals(one.si.parameters)
    assert not other.si.parameters.equals(one.si.parameters)
    assert (one.provenance.seed, other.provenance.seed) == (0, 1)


def test_the_repeatability_is_told_as_the_posteriors(posterior):
    shown = str(posterior.result)
    assert "Repeatability by the posterior 0." in shown
    assert "No scatter is known" not in shown


@pytest.mark.slow
def test_saved_and_read_again(posterior, log, tmp_path):
    path = tmp_path / "posterior.nc"
    posterior.save(path)
    again = load_posterior(path)
    assert again.result.si.parameters.equals(posterior.si.parameters)
    assert str(again) == str(posterior)
    assert again.si.predict(log.usable).equals(posterior.si.predict(log.usable))
    path.write_bytes(b"not netCDF")
    with pytest.raises(InputError, match="no saved posterior"):
        load_posterior(path)


def test_drives_of_a_logged_session_and_of_one_to_come(posterior, log):
    """A session to come is predicted from what all have in common, and less surely."""
    drives = log.usable.iloc[[0, 0]].assign(check_every=1)
    drives["session"] = [drives["session"].iloc[0], ""]
    predicted = predict(posterior, drives.reset_index(drop=True))
    assert predicted["calibration"].tolist() == drives["session"].tolist()
    known = posterior.si.predict(drives.iloc[:1])
    assert predicted["steps"][0] == pytest.approx(known["steps"].item(), abs=0.5)
    widths = np.log(predicted["high"] / predicted["low"])
    assert widths[1] > widths[0]


def test_priors_are_printed_in_users_units(posterior):
    line = next(line for line in str(posterior.priors).splitlines() if " a " in line)
    assert line.split()[4:6] == ["nm", "±"]
    assert str(posterior.priors) in str(posterior)


def test_predicts_sessions_that_were_fitted_as_the_result_does(posterior, log):
    ours, theirs = posterior.si.predict(log.usable), posterior.result.si.predict(log.usable)
    assert ours["steps"].to_numpy() == pytest.approx(theirs["steps"], rel=2e-4)
    for bound in ("low", "high"):
        reach = np.log(ours[bound] / ours["steps"]) / np.log(theirs[bound] / theirs["steps"])
        assert reach.to_numpy() == pytest.approx(1.0, abs=0.1)


def test_predicts_a_session_to_come_with_the_spread_between_sessions(posterior, log):
    rows = log.usable.head(4)
    known, to_come = (
        posterior.si.predict(rows.assign(session=session)) for session in (SESSIONS[0], "2012-03-08")
    )
    assert (to_come["relative_error"] > 2 * known["relative_error"]).all()
    # Level, without load, the step size is a alone: its mean is uncertain, and it spreads about that.
    mean, spread = (posterior.draws(3, "+", name)[:, 0] for name in ("mean", "spread"))
    expected = np.sqrt(mean.var() + np.mean(spread**2)) / mean.mean()
    assert rows.loc[0, "direction"] == "+"
    assert to_come.loc[0, "relative_error"] == pytest.approx(expected, rel=0.1)
    assert to_come["steps"].to_numpy() == pytest.approx(known["steps"], rel=0.02)


def test_a_joint_that_was_not_fitted_is_not_predicted(posterior, log):
    with pytest.raises(InputError, match=r"joint 2, direction . was not fitted; fitted were 3 \+, 3 -"):
        posterior.si.predict(log.usable.assign(joint=2))


def test_predictive_checks_pass_for_the_models_own_counts(posterior):
    p_values = predictive_p_values(posterior)[["spread", "extreme", "memory"]]
    assert p_values.stack().between(0.005, 0.995).all()


def test_predictive_checks_find_noise_that_remembers(campaign, read_table):
    table = campaign(SESSIONS[:1], JOINT_3, ("+",), replicates=12, repeatability=0.0, check_every=1)
    slow = 1.0 + 0.01 * np.sin(np.arange(len(table)) / 8)
    table["steps"] = (table["steps"] * slow).round().astype(int)
    drifting = fit_bayes(read_table(table), progress=False)
    assert predictive_p_values(drifting)["memory"].item() < 0.001


def test_leave_one_out_is_the_log_density_of_each_count_foretold(posterior, log):
    """With 30 counts and 9 well-known parameters, close to that of the noise about the law."""
    found = leave_one_out(posterior)
    for row in found.itertuples():
        noise = posterior.joints[3].repeatability[row.direction].value
        assert row.elpd == pytest.approx(-30 * (np.log(noise * np.sqrt(2 * np.pi)) + 0.5), abs=25)
        assert 2 < row.p < 15


@pytest.mark.slow
def test_one_session_gives_numbers(campaign, read_table):
    result = fit_bayes(read_table(campaign(sessions=SESSIONS[:1], settings=JOINT_3)), progress=False).result
    table = result.si.parameters
    assert table["standard_error"].notna().all()
    found = table[(table["name"] == "a") & (table["direction"] == "+")].iloc[0]
    assert found["low"] < 976e-9 < found["high"]


@pytest.mark.slow
def test_a_session_with_one_direction_is_fitted_in_that_direction(campaign, read_table):
    table = campaign(sessions=SESSIONS[:2], settings=JOINT_3)
    half = table[(table["session"] == SESSIONS[0]) | (table["direction"] == "+")]
    result = fit_bayes(read_table(half), progress=False).result
    groups = result.joints[3].groups
    assert sorted(zip(groups["session"], groups["direction"], strict=True)) == [
        (SESSIONS[0], "+"), (SESSIONS[0], "-"), (SESSIONS[1], "+"),
    ]  # fmt: skip
    assert result.si.parameters["estimate"].notna().all()


def test_a_session_with_few_traverses_leans_on_the_others(campaign, read_table):
    table = campaign(sessions=SESSIONS, settings=JOINT_3, directions=("+",))
    poor = table[(table["session"] != SESSIONS[2]) | (table["q2_deg"] == -90.0)]
    log = read_table(poor)
    # Least squares cannot know b and c of the last session at all.
    assert fit_least_squares(log).si.parameters["estimate"].isna().sum() == 2
    found = fit_bayes(log, progress=False).result.si.parameters.set_index(["session", "name"])
    assert found["estimate"].notna().all()
    assert found.loc[(SESSIONS[2], "b"), "low"] < 0.30 < found.loc[(SESSIONS[2], "b"), "high"]
    errors = found["standard_error"]
    assert errors[SESSIONS[2], "b"] > 2 * errors[SESSIONS[0], "b"]


@pytest.mark.slow
def test_what_no_session_shows_is_not_reported(campaign, read_table):
    level = [setting for setting in JOINT_3 if setting["q2_deg"] == -90.0 or setting["theta_deg"] == -90.0]
    log = read_table(campaign(sessions=SESSIONS, settings=tuple(level)))
    posterior = fit_bayes(log, progress=False)
    table = posterior.si.parameters
    assert table[table["name"] == "c"]["estimate"].isna().all()
    assert table[table["name"] != "c"]["estimate"].notna().all()
    flag = next(flag for flag in posterior.flags if flag.flag == "not_identified")
    assert flag.parameters == ("c",)
    assert "theta = 0°, psi = 0° (arm upright: recoil and full load)" in flag.message
    assert posterior.si.predict(log.usable)["steps"].isna().all()


@pytest.mark.slow
def test_without_replicates_the_repeatability_is_said_to_lean_on_the_prior(campaign, read_table):
    table = campaign(sessions=SESSIONS[:1], settings=JOINT_3[:3], replicates=1)
    result = fit_bayes(read_table(table), progress=False).result
    assert flags(result) == {"few_replicates"}
    assert result.si.parameters["standard_error"].notna().all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sessions", "factor"),
    [
        (1, 10.0),
        (6, 0.1),
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in ((1, 1.3), (1, 0.1), (12, 0.1), (12, 10.0), (12, 1.3))
        ),
    ],
)
def test_a_count_wildly_off_is_named_and_no_other(campaign, read_table, sessions, factor):
    """Though it pulls its whole session, which others show up if there are others."""
    days = tuple(f"2012-03-{day:02d}" for day in range(5, 5 + sessions))
    table = campaign(sessions=days, settings=JOINT_3, directions=("+",))
    table.loc[7, "steps"] = 5 * round(factor * table.loc[7, "steps"] / 5)
    result = fit_bayes(read_table(table), progress=False).result
    [flag] = [flag for flag in result.flags if flag.flag == "outlier"]
    assert flag.session == days[0]
    assert f"count {table.loc[7, 'steps']} of" in flag.message
    expected = np.mean(list(map(int, re.search(r"from the (\d+) to (\d+) ", flag.message).groups())))
    assert expected == pytest.approx(table.loc[7, "steps"] / factor, rel=0.02)


@pytest.mark.slow
def test_what_has_not_converged_is_no_number(log):
    posterior = fit_bayes(log, max_steps=3, progress=False)
    result = posterior.result
    table = result.si.parameters
    assert flags(result) == {"not_converged"}
    assert table[["estimate", "standard_error", "low", "high"]].isna().all(axis=None)
    assert all("not_converged" in raised for raised in table["flags"])
    assert "after 3 steps" in result.flags[0].message
    assert posterior.si.predict(log.usable)["steps"].isna().all()


@pytest.mark.slow
def test_weights_with_heavy_tails_are_not_trusted(log, monkeypatch):
    """As if linearising went badly wrong."""
    from stickslip_fit.bayes import sampler as sample

    def astray(traverses, marginal, x, rng):
        draws, log_weight = right(traverses, marginal, x, rng)
        return draws, log_weight + 3.0 * rng.standard_exponential(len(x))

    right = sample.sample_sessions
    monkeypatch.setattr(sample, "sample_sessions", astray)
    result = fit_bayes(log, max_steps=50, progress=False).result
    assert flags(result) == {"not_converged"}
    assert result.si.parameters["estimate"].isna().all()


def test_a_prior_under_which_the_joint_stalls_is_refused(log):
    priors = weak_priors(log)
    stalled = replace(priors.prior(3, "+"), centre=np.array([9e-7, 0.3, 9.5e-7]))
    with pytest.raises(InputError, match="joint 3 would stall"):
        fit_bayes(log, priors=replace(priors, of={**priors.of, (3, "+"): stalled}), progress=False)


def test_a_prior_that_is_missing_is_asked_for(log):
    priors = weak_priors(log)
    without = replace(priors, of={(3, "+"): priors.prior(3, "+")})
    with pytest.raises(InputError, match="no entry for joint 3, direction -"):
        fit_bayes(log, priors=without, progress=False)
