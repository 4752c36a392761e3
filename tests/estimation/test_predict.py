"""Counts foretold for a plan, against counts that the simulator then makes of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from stickslip_fit.bayes import fit_bayes
from stickslip_fit.causes import ExtendedLaw, SessionJump
from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_closed_form, fit_least_squares
from stickslip_fit.laws import Prismatic
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.moves.prediction import predict
from stickslip_fit.reporting.predictions import summarize_predictions
from stickslip_fit.simulation import LawValues, simulate

TRUTH = {"+": np.array([976e-9, 0.30, 438e-9]), "-": np.array([903e-9, 0.27, -405e-9])}
CALIBRATION = "q2_deg = [-90, 0]\ntheta_deg = [-90, 0]\n"
FRESH = "q2_deg = [-75, -45, -15]\ntheta_deg = [-60, -30]\n"


@pytest.fixture
def planned(tmp_path):
    """A maker of plans of joint 3."""

    def make(sweep, dates="2012-03-05", directions='["+", "-"]', check_every=5, noise=0.27):
        path = tmp_path / "plan.toml"
        path.write_text(
            f"check_every = {check_every}\nreplicates = 2\n[sessions]\ndates = [{dates}]\n"
            f"[noise]\nrepeatability_pct = {noise}\n"
            f"[[sweep]]\njoint = 3\ndirections = {directions}\n{sweep}"
        )
        return read_plan(path, load_machine())

    return make


def truth(day_to_day=0.0):
    values = {(3, way, None): value for way, value in TRUTH.items()}
    return LawValues({3: Prismatic()}, values, {(3, way): day_to_day for way in TRUTH})


def inside(predicted, log):
    """Which counts of a simulated plan lie in their intervals."""
    counts = log.rows["steps"].to_numpy()
    return (predicted["low"].to_numpy() <= counts) & (counts <= predicted["high"].to_numpy())


def days(count):
    return ", ".join(f"2012-03-{day:02d}" for day in range(5, 5 + count))


@pytest.mark.slow
@pytest.mark.parametrize("campaigns", [8, pytest.param(1000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("estimator", [fit_closed_form, fit_least_squares])
def test_intervals_hold_the_counts_of_a_plan(planned, estimator, campaigns):
    """What a count is rounded up to adds half a per cent to the 95."""
    first, then = planned(CALIBRATION), planned(FRESH)
    hits = np.empty((campaigns, len(then.rows())))
    for seed in range(campaigns):
        fit = estimator(simulate(first, truth(), load_machine(), seed=seed))
        later = simulate(then, truth(), load_machine(), seed=10_000 + seed)
        hits[seed] = inside(predict(fit, then), later)
    share = hits.mean(axis=1)
    margin = 4 * share.std() / np.sqrt(campaigns)
    assert 0.95 - margin < share.mean() < 0.955 + margin
    worst = hits.sum(axis=0).min()
    assert worst >= binom.ppf(0.001 / hits.shape[1], campaigns, 0.95)


@pytest.mark.slow
@pytest.mark.parametrize("campaigns", [6, pytest.param(300, marks=pytest.mark.nightly)])
def test_a_function_of_each_logged_session_is_not_that_of_a_session_to_come(planned, campaigns):
    """With that of the latest session the intervals hold a fifth of the counts."""
    logged, then = planned(CALIBRATION, days(4)), planned(FRESH, "2012-03-20")
    sds = (0.02, 0.01)

    def curve(*sessions):
        limits = ((0.0, 4000.0),)
        return SmoothTerm(("session_seconds",), limits, ((1,), (2,)), sds, sessions=sessions)

    labels, shares = [one.label for one in logged.sessions], []
    law = ExtendedLaw(Prismatic(), (curve(*labels, then.sessions[0].label),))
    for seed in range(campaigns):
        drawn = np.random.default_rng(seed).standard_normal((len(labels) + 1, len(sds))) * sds
        values = {(3, way, None): np.r_[one, drawn.ravel()] for way, one in TRUTH.items()}
        true = LawValues({3: law}, values, {})
        fit = fit_least_squares(simulate(logged, true, load_machine(), seed=seed), causes=[curve(*labels)])
        predicted = predict(fit, then)
        later = simulate(then, true, load_machine(), seed=10_000 + seed)
        shares.append(inside(predicted, later).mean())
    assert np.mean(shares) == pytest.approx(0.95, abs=4 * 0.12 / np.sqrt(campaigns))
    (remark,) = summarize_predictions(fit, then, predicted).flags
    assert "joint 3 has a function of each logged session" in remark


def test_counts_of_a_plan_follow_the_order_of_its_traverses_where_a_law_does(planned):
    plan = planned(CALIBRATION)
    last = float(len(plan.rows()) - 1)
    term = SmoothTerm(("session_order",), ((0.0, last),), ((1,),), (0.1,))
    law = ExtendedLaw(Prismatic(), (term,))
    values = {(3, way, None): np.r_[one, 0.1] for way, one in TRUTH.items()}
    log = simulate(plan, LawValues({3: law}, values, {}), load_machine(), seed=0)
    plain = simulate(plan, truth(), load_machine(), seed=0)
    expected = -0.1 * np.cos(np.pi * np.arange(last + 1) / last)
    predicted = predict(fit_least_squares(log, causes=[term]), plan)["steps"].to_numpy()
    for steps in (log.rows["steps"].to_numpy(), predicted):
        assert np.log(steps / plain.rows["steps"].to_numpy()) == pytest.approx(expected, abs=0.02)


def test_a_change_within_a_session_has_happened_before_a_session_to_come(planned):
    logged, then = planned(CALIBRATION, days(1)), planned(FRESH, "2012-03-20")
    jump = SessionJump(session="2012-03-05")
    law = ExtendedLaw(Prismatic(), (jump,))
    moment = np.median(simulate(logged, truth(), load_machine(), seed=0).rows["session_seconds"])
    values = {(3, way, None): np.r_[one, 0.05, moment] for way, one in TRUTH.items()}
    log = simulate(logged, LawValues({3: law}, values, {}), load_machine(), seed=0)
    fit = fit_least_squares(log, causes=[jump])
    later = simulate(then, truth(), load_machine(), seed=1).rows["steps"] / 1.05
    ratio = np.log(predict(fit, then)["steps"].to_numpy() / later.to_numpy())
    assert np.abs(ratio).max() < 0.02


@pytest.mark.nightly
@pytest.mark.parametrize("campaigns", [100])
def test_a_session_to_come_lies_where_the_campaign_leads_a_posterior_to_expect_it(planned, campaigns):
    """Sessions differ by 2 %: seven times what a count repeats to, and what tomorrow's interval must hold."""
    first, then = planned(CALIBRATION, days(6), '["+"]'), planned(FRESH, "2012-03-20", '["+"]')
    hits, widths = [], []
    for seed in range(campaigns):
        log = simulate(first, truth(day_to_day=0.02), load_machine(), seed=seed)
        predicted = predict(fit_bayes(log, seed=seed, progress=False), then)
        later = simulate(then, truth(day_to_day=0.02), load_machine(), seed=10_000 + seed)
        hits.append(inside(predicted, later)[seed % len(predicted)])
        widths.append(np.log(predicted["high"] / predicted["low"]).median())
        assert set(predicted["calibration"]) == {""}
    assert sum(hits) >= binom.ppf(0.001, campaigns, 0.95)
    assert 0.8 < np.median(widths) / (2 * 1.96 * 0.02) < 2.5


@pytest.mark.slow
def test_a_posterior_predicts_a_fitted_session_far_better_than_one_to_come(planned):
    log = simulate(planned(CALIBRATION, days(4), '["+"]'), truth(day_to_day=0.02), load_machine())
    posterior, then = fit_bayes(log, progress=False), planned(FRESH, "2012-03-20", '["+"]')
    known, to_come = (predict(posterior, then, session) for session in ("2012-03-06", None))
    width = [np.log(each["high"] / each["low"]).median() for each in (known, to_come)]
    assert width[1] > 3 * width[0]
    expected = fit_least_squares(log).predict(then.rows().assign(session="2012-03-06"))
    assert np.abs(np.log(known["steps"] / expected["steps"])).max() < 0.003


def test_counts_are_foretold_as_they_will_be_noted(planned):
    """A stop looked for every 100 steps: the very counts, not half a check less."""
    fit = fit_least_squares(simulate(planned(CALIBRATION, check_every=1, noise=0.0), truth(), load_machine()))
    then = planned(FRESH, check_every=100, noise=0.0)
    counts = simulate(then, truth(), load_machine()).rows["steps"].to_numpy()
    predicted = predict(fit, then)
    assert np.mean(predicted["steps"] == counts) > 0.9
    assert np.abs(predicted["steps"] - counts).max() <= 100


def test_the_latest_session_that_knows_everything_is_taken_unless_one_is_named(planned, tmp_path):
    first = simulate(planned(CALIBRATION, days(2)), truth(), load_machine())
    poor = simulate(planned("q2_deg = [-90]\ntheta_deg = [0]\n", "2012-03-07"), truth(), load_machine())
    rows = np.concatenate([first.rows.to_numpy(), poor.rows.to_numpy()])
    both = replace(first, rows=type(first.rows)(rows, columns=first.rows.columns).infer_objects())
    fit, then = fit_least_squares(both), planned(FRESH)
    assert set(predict(fit, then)["calibration"]) == {"2012-03-06"}
    named = predict(fit, then, "2012-03-05")
    expected = fit.predict(then.rows().assign(session="2012-03-05"))
    assert named["step_size"].to_numpy() == pytest.approx(expected["step_size"].to_numpy(), rel=1e-12)
    with pytest.raises(InputError, match=r"session 2012-03-07.*missing: a full traverse"):
        predict(fit, then, "2012-03-07")


def test_every_planned_traverse_gets_its_own_number(planned):
    """In whatever order, however often a plan comes back to a configuration."""
    plan = planned(FRESH, "2012-03-20, 2012-03-21")
    plan = replace(plan, order="random")
    fit = fit_least_squares(simulate(planned(CALIBRATION), truth(), load_machine()))
    rows, predicted = plan.rows(), predict(fit, plan)
    direct = fit.predict(rows.assign(session="2012-03-05"))
    assert (predicted.index == rows.index).all()
    assert predicted["step_size"].to_numpy() == pytest.approx(direct["step_size"].to_numpy(), rel=1e-12)


def test_what_cannot_be_foretold_is_refused(planned):
    log = simulate(planned(CALIBRATION, directions='["+"]'), truth(), load_machine())
    fit = fit_least_squares(log)
    with pytest.raises(InputError, match="joint 3 was not fitted in direction -"):
        predict(fit, planned(FRESH))
    with pytest.raises(InputError, match="session 'never' was not fitted; sessions fitted: 2012-03-05"):
        predict(fit, planned(FRESH, directions='["+"]'), "never")


def test_a_stall_is_refused(planned):
    """With a load coefficient larger than the step itself, nothing moves against full load."""
    fit = fit_least_squares(simulate(planned(CALIBRATION), truth(), load_machine()))
    steep = fit.joints[3].values.copy()
    steep[:, 2] = 1.2 * steep[:, 0]
    stalling = replace(fit, joints={3: replace(fit.joints[3], values=steep)})
    with pytest.raises(InputError, match=r"would stall in a planned traverse in direction [+]"):
        predict(stalling, planned("q2_deg = [0]\ntheta_deg = [0]\n"))


def test_without_replicates_there_are_counts_but_no_intervals(planned):
    plan = planned(
        "q2_deg = [-90]\ntheta_deg = [0]\n[[sweep]]\njoint = 3\nq2_deg = [0]\ntheta_deg = [-90, 0]\n"
    )
    fit = fit_least_squares(simulate(replace(plan, replicates=1), truth(), load_machine()))
    predicted = predict(fit, planned(FRESH))
    assert predicted["steps"].notna().all()
    assert predicted[["low", "high"]].isna().all(axis=None)
