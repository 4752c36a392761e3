"""What each strategy makes of its traverses, beside the estimators of `fit`."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit import estimation as fit
from stickslip_fit.bayes import fit_bayes, weak_prior
from stickslip_fit.bayes.marginal import linearize_at_mode
from stickslip_fit.bayes.priors import build_group_data
from stickslip_fit.causes import library
from stickslip_fit.causes.temporal import SessionJump
from stickslip_fit.errors import InputError
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from stickslip_fit.logs import read_log
from stickslip_fit.strategies import (
    ClosedForm,
    ConstantStepStrategy,
    Hierarchical,
    IOptimal,
    LeastSquares,
    Thesis,
    WithCauses,
    causes_from_other_sessions,
    causes_from_result,
    compare_strategies,
    default_strategies,
    other_sessions,
)
from stickslip_fit.strategies.base import LawFit, UncertainLaw, predict_together, solve_law, solve_together
from stickslip_fit.strategies.evaluation import evaluate_strategies, make_cases
from stickslip_fit.strategies.library import CampaignFit
from tests.conftest import CALIBRATION, SWEEPS


@pytest.fixture(scope="module")
def trials(log):
    return list(make_cases(log, other_sessions))


@pytest.mark.slow
def test_the_closed_form_is_that_of_fit(log, trials):
    calibrated = fit.fit_closed_form(log)
    errors = evaluate_strategies(trials, [ClosedForm()]).errors.set_index("traverse")
    wanted = calibrated.si.predict(log.usable.loc[errors.index])["step_size"]
    assert errors["predicted"].to_numpy() == pytest.approx(wanted.to_numpy(), rel=1e-8)
    assert not calibrated.residuals["used"].loc[errors.index].any()


def test_the_constant_step_is_measured_in_the_first_configuration(log, trials):
    """Joint 3: arm level. Joint 2: base on its side, arm in. Joint 1: arm level and in."""
    errors = evaluate_strategies(trials, [ConstantStepStrategy()]).errors
    rows = log.usable
    full = rows[abs(rows["stop"] - rows["start"]) > rows["joint"].map({1: 4.18, 2: 4.18, 3: 0.0119})]
    level, side = abs(full["theta"]) < 1e-9, abs(full["theta"] + np.pi / 2) < 1e-9
    down, inside = abs(full["q2"] + np.pi / 2) < 1e-9, full["q3"] < 1e-9
    upright = level & (full["psi"] == 0)
    where = {1: upright & down & inside, 2: side & inside, 3: upright & down}
    for (joint, session, way), subset in errors.groupby(["joint", "session", "direction"]):
        there = where[joint] & (full["joint"] == joint)
        first = full[there & (full["session"] == session) & (full["direction"] == way)].iloc[0]
        step = abs(first["stop"] - first["start"]) / (first["steps"] - 2.5)
        assert subset["predicted"].to_numpy() == pytest.approx(step)


@pytest.mark.slow
def test_the_constant_step_is_that_of_fit(log, trials):
    constant = fit.fit_constant_step(log, fit.fit_closed_form(log))
    errors = evaluate_strategies(trials, [ConstantStepStrategy()]).errors.set_index("traverse")
    wanted = constant.si.predict(log.usable.loc[errors.index])["step_size"]
    assert errors["predicted"].to_numpy() == pytest.approx(wanted.to_numpy(), rel=1e-8)
    assert not constant.residuals["used"].loc[errors.index].any()


@pytest.mark.parametrize("strategy", default_strategies(2), ids=lambda strategy: strategy.name)
def test_nothing_is_learnt_from_what_was_not_driven(strategy, trials):
    rng = np.random.default_rng(5)
    for trial in trials[::7]:
        before = evaluate_strategies([trial], [strategy]).errors
        rows = trial.rows.copy()
        rows.loc[before["traverse"], "steps"] = rng.integers(1000, 90_000, len(before))
        after = evaluate_strategies([replace(trial, rows=rows)], [strategy]).errors
        assert after["predicted"].tolist() == before["predicted"].tolist()
        assert (after["measured"] != before["measured"]).all()


@pytest.mark.slow
@pytest.mark.parametrize("today", [1, 3])
def test_the_hierarchy_agrees_with_draws_from_its_posterior(today, log, trials):
    trial = next(each for each in trials if each.task.law.joint == 3)
    strategy = Hierarchical(today)
    made = trial.rows.loc[trial.task.offered.index[strategy.choose(trial.task)]]
    known = log.usable.index.isin(np.concatenate([trial.task.others.index, made.index]))
    drawn = fit_bayes(replace(log, rows=log.usable[known]), progress=False).si.predict(trial.rows)
    mean, sd = strategy.calibrate(trial.task, made)(trial.rows)
    assert np.all(np.abs(np.exp(mean) / drawn["steps"] - 1.0) < 0.35 * drawn["relative_error"])
    assert np.all(np.abs(np.log(sd / drawn["relative_error"])) < np.log(1.6))


@pytest.fixture(scope="module")
def warm(campaign, written):
    """A log in which every step grows by 1 % a kelvin, in rooms that differ."""
    two_joints = tuple(each for each in CALIBRATION + SWEEPS if each["joint"] != 1)
    table = campaign(("2012-03-05", "2012-03-06", "2012-03-07"), two_joints)
    temperature = np.random.default_rng(8).uniform(18.0, 26.0, len(table)).round(2)
    counts = table["steps"] / (1.0 + 0.01 * (temperature - temperature.mean()))
    table = table.assign(temperature_C=temperature, steps=(counts / 5).round().astype(int) * 5)
    return read_log(written(table))


@pytest.mark.slow
def test_causes_fitted_to_other_sessions_take_their_effect_out(warm):
    cause = next(each for each in library() if each.name == "temperature")
    plain = LeastSquares(IOptimal(), 2)
    known = causes_from_other_sessions(warm, [cause])
    found = compare_strategies(warm, [plain, WithCauses(plain, known)])
    rms = found.accuracy().set_index(["joint", "strategy"])["rms_relative"]
    for joint in (2, 3):
        assert rms[joint, plain.name] > 0.015
        assert rms[joint, f"{plain.name}, with causes"] < 0.005


@pytest.mark.slow
def test_fits_solved_together_are_those_solved_one_by_one(warm, monkeypatch):
    """Of two joints, both directions, few and many traverses, with and without a cause of several sizes."""
    cause = next(each for each in library() if each.name == "temperature")
    causes, fits = (cause.bind(warm.usable, warm.machine),), []
    jump = (SessionJump(session=warm.usable["session"].iloc[0]),)
    for number, trial in enumerate(make_cases(warm, other_sessions)):
        law, many = trial.task.law, trial.task.others
        few = trial.rows.iloc[IOptimal().pick(trial.task, len(law.parameters) + 1)]
        fits += [LawFit(law, few, 0.003), LawFit(law, many, 0.01)]
        for rows, size in ((few, 0.002 * number), (many, -0.001 * number)):
            fits.append(LawFit(FixedCauseLaw(law, causes, np.array([size])), rows, 0.003))
        middle = float(few["session_seconds"].median())
        fits.append(LawFit(FixedCauseLaw(law, jump, np.array([0.03, middle])), few, 0.003))
    monkeypatch.setattr("stickslip_fit.estimation._optimize.MIN_ROWS", 0)  # slow fits go on alone
    for one, found in zip(fits, solve_together(fits), strict=True):
        rows = one.measured if one.measured["session"].nunique() == 1 else one.measured.assign(session="one")
        alone = solve_law(one.law, rows, one.repeatability)
        assert found.values == pytest.approx(alone.values[0], rel=1e-6)
        assert found.covariance == pytest.approx(alone.covariance[0], rel=1e-5)
        assert found.known.tolist() == alone.known[0].tolist()


@pytest.mark.slow
def test_campaigns_solved_together_are_those_solved_one_by_one(warm):
    """Of two joints and both directions, with different numbers of sessions and traverses."""
    cases, fits, alone = list(make_cases(warm, other_sessions)), [], []
    for number, trial in enumerate(cases):
        law, others = trial.task.law, trial.task.others
        if number % 2:
            others = others[others["session"] == others["session"].iloc[0]]
        fits.append(CampaignFit(law, others, trial.rows.iloc[: 1 + number % 3]))
        data = build_group_data(law, pd.concat([others, fits[-1].measured]))
        prior = weak_prior(law, data.rows)
        marginal, mode, _ = linearize_at_mode(data, prior)
        posterior = marginal.conditional(mode[None])
        place = list(data.groups.table["session"]).index(trial.task.session)
        z = posterior.sessions(posterior.centre)[:, place, 0]
        alone.append(prior.centre + prior.width * z)
    for found, wanted in zip(solve_together(fits), alone, strict=True):
        assert found.values == pytest.approx(wanted, rel=1e-6)


def test_predictions_made_together_are_those_of_each_law(warm):
    cause = next(each for each in library() if each.name == "temperature")
    causes = (cause.bind(warm.usable, warm.machine),)
    for trial in make_cases(warm, other_sessions):
        law, p = trial.task.law, len(trial.task.law.parameters)
        values, covariance = trial.task.nominal[0], np.diag(1e-16 * np.arange(1.0, p + 1.0))
        laws = [law, *(FixedCauseLaw(law, causes, np.array([size])) for size in (0.002, -0.001)), law]
        predictors = [
            UncertainLaw(one, values * (1 + 0.01 * k), covariance * k) for k, one in enumerate(laws, start=1)
        ]
        for one, (mean, sd) in zip(predictors, predict_together(predictors, trial.rows), strict=True):
            response, slopes = one.law.model(trial.rows)(np.tile(one.values, (len(trial.rows), 1)))
            assert mean == pytest.approx(response, abs=1e-9)
            assert sd == pytest.approx([np.sqrt(row @ one.covariance @ row) for row in slopes], rel=1e-6)


@pytest.mark.slow
def test_a_session_has_no_part_in_the_causes_it_is_calibrated_with(warm, trials):
    cause, tuesday = next(each for each in library() if each.name == "temperature"), "2012-03-06"
    rows = warm.rows.copy()
    subset = rows["session"] == tuesday
    warmer = 1.0 + 0.05 * (rows.loc[subset, "temperature"] - 295.0)
    rows.loc[subset, "steps"] = (rows.loc[subset, "steps"] * warmer).astype(int)
    before, after = (causes_from_other_sessions(each, [cause]) for each in (warm, replace(warm, rows=rows)))
    assert after[tuesday].values.tolist() == before[tuesday].values.tolist()
    assert abs(after["2012-03-05"].values[0] - before["2012-03-05"].values[0]) > 0.005
    assert all(trial.task.session not in set(trial.task.others["session"]) for trial in trials)


def test_causes_may_not_be_judged_by_the_traverses_they_were_fitted_to(warm):
    cause = next(each for each in library() if each.name == "temperature")
    fitted = fit.fit_least_squares(warm, causes=[cause])
    with pytest.raises(InputError, match="fitted to the traverses that they would be judged by"):
        causes_from_result(warm, fitted)
    half = warm.rows["session"] == "2012-03-05"
    elsewhere = replace(warm.select(half), file_sha256="another")
    known = causes_from_result(warm, fit.fit_least_squares(elsewhere, causes=[cause]))
    assert list(known) == list(warm.sessions)


@pytest.mark.slow
def test_more_traverses_are_worth_more(log):
    few, many = LeastSquares(Thesis()), LeastSquares(Thesis(), 3)
    errors = compare_strategies(log, [few, many]).shared
    claimed = errors.groupby("strategy")["sd"].mean()
    assert claimed[many.name] < claimed[few.name]
    off = np.abs(np.log(errors["predicted"] / errors["measured"]))
    assert pd.Series(off < 3 * np.hypot(errors["sd"], 0.0027)).mean() > 0.98
