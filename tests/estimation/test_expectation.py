from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, ttest_ind

from stickslip_fit.estimation import fit_closed_form, fit_least_squares
from stickslip_fit.estimation.prediction import control_chart, format_latest_control, latest_control
from tests.conftest import CALIBRATION_3


@pytest.fixture
def fit(read_table):
    return lambda table: fit_least_squares(read_table(table))


@pytest.fixture
def drifting(campaign):
    """Ten sessions whose step sizes change by 2 % from one to the next, and how the last one is off."""

    def make(last: float, seed: int = 1) -> pd.DataFrame:
        days = tuple(f"2012-03-{day:02d}" for day in range(1, 11))
        table = campaign(sessions=days, settings=CALIBRATION_3)
        factor = np.exp(0.02 * np.random.default_rng(seed).standard_normal(10))
        factor[-1] *= last
        table["steps"] = (
            table["steps"] / table["session"].map(dict(zip(days, factor, strict=True))) // 5 * 5
        ).astype(int)
        return table

    return make


def test_a_usual_day_is_as_expected(drifting, fit):
    found = latest_control(fit(drifting(1.0)))
    assert len(found) == 6
    assert not found["surprising"].any()
    assert (
        format_latest_control(found)
        == "Session 2012-03-10 lies where the sessions before it lead one to expect."
    )


def test_a_drive_that_lost_a_quarter_of_its_step_is_told(drifting, fit):
    found = latest_control(fit(drifting(0.75)))
    told = format_latest_control(found)
    assert set(found.loc[found["surprising"], "name"]) == {"a", "c"}
    assert "joint 3 + a: " in told
    assert "nm" in told


@pytest.mark.slow
@pytest.mark.parametrize("campaigns", [8, pytest.param(300, marks=pytest.mark.nightly)])
def test_the_stated_rate_of_surprises_holds(drifting, fit, campaigns):
    """Usual days only: a surprise anywhere in about 1 of 100; parameters move together, so fewer."""
    logs = (fit(drifting(1.0, seed)) for seed in range(campaigns))
    surprised = sum(latest_control(log)["surprising"].any() for log in logs)
    assert surprised <= binom.ppf(0.999, campaigns, 0.01)


def test_three_sessions_are_too_few(campaign, fit):
    days = ("2012-03-01", "2012-03-02", "2012-03-03")
    found = latest_control(fit(campaign(sessions=days, settings=CALIBRATION_3)))
    assert found.empty
    assert "takes 3 earlier ones" in format_latest_control(found)


def test_a_surprise_is_what_a_t_test_of_one_against_all_before_finds(drifting, fit):
    """The limit is where the test's p reaches 1 % over the session's six parameters."""
    chart = control_chart(fit(drifting(0.93)))
    checked = 0
    for _, history in chart.groupby(["direction", "name"]):
        estimates = history["estimate"].to_numpy()
        for k, row in enumerate(history.itertuples()):
            if k < 3:
                assert np.isnan(row.expected_low)
                assert not row.surprising
                continue
            at_limit = [
                ttest_ind(estimates[:k], [end]).pvalue for end in (row.expected_low, row.expected_high)
            ]
            assert at_limit == pytest.approx([0.01 / 6] * 2)
            assert row.surprising == (ttest_ind(estimates[:k], [row.estimate]).pvalue < 0.01 / 6)
            checked += 1
    assert checked == 6 * 7
    assert 0 < chart["surprising"].sum() < checked


@pytest.mark.slow
def test_earlier_limits_are_those_that_were_seen_then(drifting, read_table):
    """No session's limits know of a later one."""
    log = read_table(drifting(1.0))
    chart = control_chart(fit_closed_form(log))
    for session in log.sessions[3:]:
        then = latest_control(fit_closed_form(log.select(log.rows["session"] <= session)))
        now = chart[chart["session"] == session].reset_index(drop=True)
        limits = ["name", "direction", "expected_low", "expected_high", "surprising"]
        pd.testing.assert_frame_equal(now[limits], then[limits])


def test_one_usual_session_in_a_hundred_has_a_point_outside(drifting, fit):
    """Over 1,500 sessions whose parameters change independently."""
    result = fit(drifting(1.0))
    sessions, rng = 1500, np.random.default_rng(5)
    names = np.repeat([f"day {number:04d}" for number in range(sessions)], 2)
    groups = pd.DataFrame({"session": names.astype(object), "direction": ["+", "-"] * sessions})
    size = (len(groups), 3)
    usual = replace(
        result.joints[3],
        groups=groups,
        values=rng.normal([970e-9, 0.3, 430e-9], [10e-9, 0.01, 10e-9], size),
        known=np.ones(size, dtype=bool),
        covariance=np.full((*size, 3), np.nan),
        interval=np.full((*size, 2), np.nan),
    )
    chart = control_chart(replace(result, joints={3: usual}))
    outside = chart.groupby("session", sort=False)["surprising"].any().sum()
    assert binom.ppf(0.001, sessions, 0.01) <= outside <= binom.ppf(0.999, sessions, 0.01)


def test_what_all_sessions_share_has_no_chart(drifting, read_table):
    chart = control_chart(fit_least_squares(read_table(drifting(1.0)), shared=["b"]))
    assert set(chart["name"]) == {"a", "c"}
    assert chart["expected_low"].notna().sum() == 4 * 7
