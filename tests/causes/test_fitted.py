"""The extended law goes on living: fitted, listed, saved, loaded and predicted with."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import (
    CauseParameter,
    Drift,
    EndStopLatency,
    EndStopMisfire,
    FactorCause,
    LoadNonlinearity,
    PsiOffset,
    SessionJump,
    Temperature,
    ThermalWarmUp,
    WornSpot,
)
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import Result, fit_least_squares, load_result, with_causes
from stickslip_fit.estimation.result import ALL_JOINTS
from stickslip_fit.estimation.with_causes import initial_guess
from stickslip_fit.logs import Log, read_log

A, TAU, LATE = 0.04, 1500.0, 200.0
WARM_UP, LATENCY = ThermalWarmUp(), EndStopLatency()


def seconds(table: pd.DataFrame) -> np.ndarray:
    """Since each session's first traverse."""
    time = pd.to_datetime(table["time"])
    return (time - time.groupby(table["session"]).transform("min")).dt.total_seconds().to_numpy()


@pytest.fixture(scope="module")
def warm(campaign: Callable[..., pd.DataFrame], read_table) -> Log:
    """A drive that warms up, and a stop that is heard late: by hand, on an independent campaign."""
    table = campaign(check_every=1, sessions=("2012-03-05", "2012-03-06", "2012-03-09"))
    factor = 1 + A * (1 - np.exp(-seconds(table) / TAU))
    table["steps"] = np.round(table["steps"] / factor + LATE).astype(int)
    return read_table(table)


@pytest.fixture(scope="module")
def result(warm: Log) -> Result:
    return fit_least_squares(warm, causes=(WARM_UP, LATENCY))


def causes_of(result: Result) -> pd.DataFrame:
    table = result.si.parameters
    return table[table["joint"] == ALL_JOINTS].set_index("name")


@pytest.mark.parametrize(
    ("name", "truth"), [("thermal-warm-up.A", A), ("thermal-warm-up.tau", TAU), ("end-stop-latency.L", LATE)]
)
def test_the_causes_are_found_at_their_size(name, truth, result):
    row = causes_of(result).loc[name]
    assert abs(row["estimate"] - truth) < 3.5 * row["standard_error"]
    assert row["standard_error"] < 0.1 * truth
    assert row["low"] < row["estimate"] < row["high"]


def test_the_published_parameters_are_right_again_and_the_repeatability_too(warm, result):
    baseline = fit_least_squares(warm)
    for fit in result.joints.values():
        assert [each.value for each in fit.repeatability.values()] == pytest.approx([0.0027] * 2, rel=0.25)
    assert baseline.joints[3].repeatability["+"].value > 2 * result.joints[3].repeatability["+"].value
    table = result.si.parameters
    a = table[(table["name"] == "a") & (table["direction"] == "+")]
    assert np.all(np.abs(a["estimate"] - 976e-9) < 4 * a["standard_error"])


def test_a_cause_is_listed_once_for_the_whole_campaign(result):
    table = result.si.parameters
    subset = table[table["name"].str.contains(".", regex=False)]
    assert list(subset["name"]) == ["thermal-warm-up.A", "thermal-warm-up.tau", "end-stop-latency.L"]
    assert set(subset["joint"]) == {ALL_JOINTS}
    assert set(subset["direction"]) == {""}
    assert subset["session"].isna().all()
    text = str(result)
    assert text.count("thermal-warm-up.A") == 1
    assert re.search(r"thermal-warm-up\.A +(3\.9|4\.0)\d ± 0\.1\d %", text)


def test_every_joint_holds_the_same_values_of_the_causes_and_the_same_covariance(result):
    fits = list(result.joints.values())
    for fit in fits:
        np.testing.assert_array_equal(
            fit.values[:, -3:], np.tile(fits[0].values[0, -3:], (len(fit.values), 1))
        )
        np.testing.assert_allclose(
            fit.covariance[:, -3:, -3:], np.tile(fits[0].covariance[0, -3:, -3:], (len(fit.values), 1, 1))
        )


def test_the_covariance_is_that_of_all_parameters_at_once(warm, result):
    """The block-arrow system against one dense matrix of the whole campaign."""
    rows, shared = warm.usable, 3
    blocks, weight, columns = [], np.empty(len(rows)), 0
    for joint, fit in result.joints.items():
        subset = np.flatnonzero(rows["joint"] == joint)
        some = rows.iloc[subset]
        group, own = fit.group_index(some), fit.values.shape[1] - shared
        slopes = fit.law.jacobian(some, fit.values[group])
        ways = [fit.repeatability[way].value for way in some["direction"]]
        weight[subset] = 1 / (np.array(ways) ** 2 + fit.law.response(some)[1])
        blocks.append((fit, subset, group, slopes, columns, own))
        columns += len(fit.groups) * own
    dense = np.zeros((len(rows), columns + shared))
    for _, subset, group, slopes, first, own in blocks:
        for k in range(own):
            dense[subset, first + group * own + k] = slopes[:, k]
        dense[subset, columns:] = slopes[:, own:]
    size = np.abs(dense).max(axis=0)
    scaled = dense / size
    covariance = np.linalg.inv(scaled.T @ (weight[:, None] * scaled)) / np.outer(size, size)
    for fit, _, _, _, first, own in blocks:
        for group in range(len(fit.groups)):
            place = np.r_[first + group * own + np.arange(own), columns + np.arange(shared)]
            error = np.sqrt(np.diagonal(covariance))[place]
            found = fit.covariance[group] / np.outer(error, error)
            np.testing.assert_allclose(
                found, covariance[np.ix_(place, place)] / np.outer(error, error), atol=2e-4
            )


def test_it_is_the_least_of_all_sums_of_squares(warm, result):
    """No other value of a cause's parameter does better, the rest refitted."""
    rows = warm.usable

    def cost(values):
        total = 0.0
        for joint, fit in result.joints.items():
            some = rows[rows["joint"] == joint]
            moved = fit.values.copy()
            moved[:, -3:] = values
            ways = np.array([fit.repeatability[way].value for way in some["direction"]])
            y, rounding = fit.law.response(some)
            left = y - fit.law.predict(some, moved[fit.group_index(some)])
            total += float(np.sum(left**2 / (ways**2 + rounding)))
        return total

    best = result.joints[3].values[0, -3:]
    for k in range(3):
        for sign in (-1, 1):
            assert cost(best * (1 + sign * 1e-3 * (np.arange(3) == k))) > cost(best)


def test_saved_and_loaded_it_is_the_same(result, warm, tmp_path):
    result.save(tmp_path / "fit.json")
    back = load_result(tmp_path / "fit.json")
    pd.testing.assert_frame_equal(back.si.parameters, result.si.parameters)
    pd.testing.assert_frame_equal(back.si.predict(warm.usable), result.si.predict(warm.usable))
    import json

    listed = json.loads((tmp_path / "fit.json").read_text())["parameters"]
    tau = next(each for each in listed if each["name"] == "thermal-warm-up.tau")
    assert (tau["joint"], tau["direction"], tau["session"]) == (None, None, None)
    assert tau["estimate"] == pytest.approx(TAU / 60, rel=0.2)


def test_predictions_follow_the_session_s_clock(result, warm):
    rows = warm.usable[warm.usable["joint"] == 3].iloc[[0]]
    cold, hot = (result.si.predict(rows.assign(session_seconds=t))["steps"].iloc[0] for t in (0.0, 4 * TAU))
    assert (cold - LATE) / (hot - LATE) == pytest.approx(1 + A * (1 - np.exp(-4)), rel=2e-3)


@pytest.fixture(scope="module")
def knocked(campaign: Callable[..., pd.DataFrame], read_table) -> tuple[Log, pd.Timestamp]:
    table = campaign(check_every=1)
    second = table.index[table["session"] == "2012-03-06"]
    at = second[len(second) // 3]
    table.loc[at : second[-1], "steps"] = np.round(table.loc[at : second[-1], "steps"] / 1.02).astype(int)
    return read_table(table), pd.Timestamp(table.loc[at, "time"])


def test_a_knock_is_found_in_its_session_at_its_moment(knocked):
    log, at = knocked
    table = causes_of(fit_least_squares(log, causes=(SessionJump(),)))
    size = table.loc["session-jump.A[2012-03-06]"]
    assert abs(size["estimate"] - 0.02) < 3.5 * size["standard_error"]
    moment = table.loc["session-jump.moment[2012-03-06]"]
    assert moment["flags"] == ("chosen",)
    assert np.isnan(moment["standard_error"])
    times = pd.to_datetime(log.rows.loc[log.rows["session"] == "2012-03-06", "time"])
    chosen = times.min() + pd.Timedelta(seconds=moment["estimate"])
    # As good as halfway between the knock and the traverse before, at the resolution of the trials.
    assert abs((chosen - at).total_seconds()) < 2000


@pytest.mark.slow
def test_a_version_of_its_own_keeps_its_session(knocked):
    log, _ = knocked
    table = causes_of(fit_least_squares(log, causes=(SessionJump(session="2012-03-05"),)))
    assert [name.split("[")[1] for name in table.index] == ["2012-03-05]"] * 2
    size = table.loc["session-jump.A[2012-03-05]"]
    assert abs(size["estimate"]) < 0.004


@pytest.mark.parametrize(
    ("causes", "options", "reason"),
    [
        ((Temperature(),), {}, "temperature cannot be fitted: the log has no ambient temperature"),
        ((WornSpot(),), {}, "runs the whole guide"),
        ((EndStopMisfire(),), {}, "heavy tails"),
        (("drift",), {}, "'drift' is no cause; a cause is a value"),
        ((Drift,), {}, "Drift'> is no cause; a cause is a value"),
        ((Drift(),), {"shared": ("b",)}, "b cannot be the same in all sessions while causes are fitted"),
        ((Drift(),), {"bounds": {"drift.q": (0.0, 1.0)}}, "no parameter|has a parameter 'drift.q'"),
    ],
)
def test_what_cannot_be_fitted_is_refused(causes, options, reason, warm):
    with pytest.raises(InputError, match=reason):
        fit_least_squares(warm, causes=causes, **options)


def test_a_start_under_which_a_joint_stalls_is_left_for_one_without_effect(warm, result, monkeypatch):
    def guess(*arguments):
        chosen, start = initial_guess(*arguments)
        return chosen, np.where(np.arange(len(start)) == 0, -5.0, start)

    monkeypatch.setattr(with_causes, "initial_guess", guess)
    found = causes_of(fit_least_squares(warm, causes=(WARM_UP, LATENCY)))["estimate"]
    np.testing.assert_allclose(found, causes_of(result)["estimate"], rtol=1e-4)


def test_a_bound_holds_a_cause_s_parameter_back(warm):
    bounds = {"thermal-warm-up.tau": (60.0, 900.0)}
    found = fit_least_squares(warm, causes=(WARM_UP, LATENCY), bounds=bounds)
    tau = causes_of(found).loc["thermal-warm-up.tau"]
    assert tau["estimate"] == 900.0
    assert tau["flags"] == ("at_bound",)
    assert (tau["low"], tau["high"] > 60.0) == (pytest.approx(tau["low"]), True)
    assert "held back by its bound at 15" in " ".join(flag.message for flag in found.flags)


def test_parameters_per_joint_and_direction_have_rows_of_their_own(warm):
    table = causes_of(fit_least_squares(warm, causes=(LoadNonlinearity(),)))
    assert list(table.index) == [f"load-nonlinearity.k[{joint}{way}]" for joint in (1, 2, 3) for way in "+-"]


def test_where_nothing_is_hidden_no_effect_is_found(campaign, read_table):
    log = read_table(campaign())
    table = causes_of(fit_least_squares(log, causes=(PsiOffset(), Drift())))
    assert np.all(np.abs(table["estimate"]) < 3.5 * table["standard_error"])


@dataclass(frozen=True)
class Humming(FactorCause):
    """A cause of one's own: the mains hum of a lab, in antiphase every other minute."""

    name = "humming"
    phrase = "the mains hums"
    physics = "Somebody else's transformer."
    shows_best = "two traverses a minute apart"
    columns = ("session_seconds",)
    parameters = (CauseParameter("k", "%", "change of the step size"),)
    null_values = (0.0,)
    scale = (0.01,)

    def largest_plausible(self):
        return (np.array([0.1]),)

    def factor(self, state, values):
        return 1.0 + values[0] * (-1.0) ** (state.column("session_seconds") // 60)


@pytest.mark.slow
def test_a_cause_of_one_s_own_is_fitted_saved_and_loaded_like_any_other(campaign, read_table, tmp_path):
    table = campaign(check_every=1)
    table["steps"] = np.round(table["steps"] / (1 + 0.01 * (-1.0) ** (seconds(table) // 60))).astype(int)
    log = read_table(table)
    found = fit_least_squares(log, causes=(Humming(),))
    row = causes_of(found).loc["humming.k"]
    assert abs(row["estimate"] - 0.01) < 3.5 * row["standard_error"]
    found.save(tmp_path / "fit.json")
    with pytest.raises(InputError, match=r"'humming'.*not in the library"):
        load_result(tmp_path / "fit.json")
    back = load_result(tmp_path / "fit.json", causes=(Humming(),))
    pd.testing.assert_frame_equal(back.si.predict(log.usable), found.si.predict(log.usable))


@pytest.mark.slow
def test_a_search_comes_to_rest_though_the_time_constant_of_nothing_is_next_to_unknown():
    log = read_log(Path(__file__).parents[2] / "data" / "reference" / "campaign.csv")
    found = fit_least_squares(log, causes=(WARM_UP, LATENCY))
    assert not [flag for flag in found.flags if flag.flag == "not_converged"]
    table = causes_of(found)
    assert table.loc["thermal-warm-up.tau", "standard_error"] > table.loc["thermal-warm-up.tau", "estimate"]
    assert (
        abs(table.loc["thermal-warm-up.A", "estimate"]) < 2 * table.loc["thermal-warm-up.A", "standard_error"]
    )
