import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import SessionJump, ThermalWarmUp
from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_closed_form, fit_least_squares, load_result
from stickslip_fit.estimation.noise import t_quantile
from tests.conftest import CALIBRATION_3


@pytest.fixture(scope="module")
def log(campaign, read_table):
    return read_table(campaign())


@pytest.mark.slow
@pytest.mark.parametrize("estimator", [fit_closed_form, fit_least_squares])
def test_a_result_comes_back_as_it_was(log, tmp_path, estimator):
    result = estimator(log, command="stickslip-fit fit")
    result.save(tmp_path / "result.json")
    back = load_result(tmp_path / "result.json")
    pd.testing.assert_frame_equal(back.parameters, result.parameters)
    pd.testing.assert_frame_equal(back.residuals, result.residuals, check_index_type=False)
    pd.testing.assert_frame_equal(back.predict(log.usable), result.predict(log.usable))
    assert back.provenance == result.provenance
    assert back.flags == result.flags
    assert back.machine == result.machine


def test_the_file_lists_parameters_in_peoples_units(log, tmp_path):
    fit_least_squares(log).save(tmp_path / "result.json")
    listed = json.loads((tmp_path / "result.json").read_text("utf-8"))["parameters"]
    first = next(item for item in listed if item["name"] == "a" and item["direction"] == "+")
    assert set(first) == {
        "name", "joint", "direction", "session", "unit", "estimate", "standard_error", "low", "high", "flags",
    }  # fmt: skip
    assert (first["joint"], first["unit"]) == (3, "nm")
    assert first["low"] < 976 < first["high"]
    slopes = [item for item in listed if item["name"] == "gamma0_per_mm"]
    assert all(item["unit"] == "µrad/mm" and -0.1 < item["estimate"] < 0 for item in slopes)


@pytest.fixture(scope="module")
def smooth(log):
    """A fit with a smooth function of 40 coefficients."""
    hours = float(log.usable["session_seconds"].max())
    orders = tuple((k,) for k in range(1, 41))
    term = SmoothTerm(("session_seconds",), ((0.0, hours),), orders, (0.01,) * 40)
    return fit_least_squares(log, causes=[term])


def test_what_all_groups_know_of_causes_is_saved_once(log, smooth, tmp_path):
    smooth.save(tmp_path / "law.json")
    content = json.loads((tmp_path / "law.json").read_text("utf-8"))
    saved = sum(np.size(joint["covariance"]) for joint in content["joints"])
    saved += sum(map(len, content["cause_covariance"]))
    assert saved < 0.2 * sum(fit.covariance.size for fit in smooth.joints.values())
    back = load_result(tmp_path / "law.json")
    for joint, fit in smooth.joints.items():
        sd = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
        error = (back.joints[joint].covariance - fit.covariance) / sd[:, :, None] / sd[:, None, :]
        assert np.abs(error).max() < 1e-6
    pd.testing.assert_frame_equal(back.predict(log.usable), smooth.predict(log.usable), rtol=1e-6)


def test_a_law_whose_groups_do_not_all_have_error_bars_comes_back(smooth, tmp_path):
    """As where one direction has hardly more traverses than parameters."""
    joint, fit = next(iter(smooth.joints.items()))
    covariance = fit.covariance.copy()
    covariance[0] = np.nan
    fits = smooth.joints | {joint: replace(fit, covariance=covariance)}
    replace(smooth, joints=fits).save(tmp_path / "law.json")
    back = load_result(tmp_path / "law.json").joints[joint].covariance
    assert np.isnan(back[0]).all()
    assert np.isfinite(back[1:]).all()


@pytest.fixture(scope="module")
def jumped(campaign, read_table):
    """A fit with a jump and a warm-up, the directions having different degrees of freedom."""
    table = campaign(settings=CALIBRATION_3)
    return fit_least_squares(
        read_table(table.drop(index=table.index[table["direction"] == "-"][:3])),
        causes=[SessionJump(session="2012-03-06"), ThermalWarmUp()],
    )


def test_what_all_groups_share_has_one_interval(jumped, tmp_path):
    (fit,) = jumped.joints.values()
    dfs = [level.df for level in fit.repeatability.values()]
    assert len({*dfs}) == 2
    causes = slice(-len(fit.cause_parameters), None)
    interval, variance = fit.interval[:, causes], np.diagonal(fit.covariance, axis1=1, axis2=2)[:, causes]
    np.testing.assert_allclose(interval, np.broadcast_to(interval[0], interval.shape), rtol=1e-9)
    jump, moment, warm_up, _ = (interval[0, :, 1] - fit.values[0, causes]) / np.sqrt(
        np.where(variance[0] > 0, variance[0], np.nan)
    )
    assert np.isnan(moment)  # it has no error bar, in no group
    assert not variance[:, 1].any()
    for reach in (jump, warm_up):
        assert t_quantile(sum(dfs)) <= reach < t_quantile(min(dfs))
    jumped.save(tmp_path / "law.json")
    pd.testing.assert_frame_equal(load_result(tmp_path / "law.json").parameters, jumped.parameters)


def test_a_law_with_rounding_for_the_variance_of_a_moment_is_read(jumped, tmp_path):
    """As in files of earlier versions, which also gave shared parameters each direction's interval."""
    ((joint, fit),) = jumped.joints.items()
    covariance, interval = fit.covariance.copy(), fit.interval.copy()
    moment = covariance.shape[1] - len(fit.cause_parameters) + 1
    covariance[:, moment, moment] = 1e-27 * np.arange(len(covariance))
    interval[1::2, -1] += [-1.0, 1.0]
    saved = replace(jumped, joints={joint: replace(fit, covariance=covariance, interval=interval)})
    saved.save(tmp_path / "law.json")
    pd.testing.assert_frame_equal(load_result(tmp_path / "law.json").parameters, saved.parameters)


def test_an_unknown_number_is_null(campaign, tmp_path, read_table):
    table = campaign(("2012-03-05",), ({"joint": 3, "q2_deg": -90.0},))
    fit_least_squares(read_table(table)).save(tmp_path / "result.json")
    text = (tmp_path / "result.json").read_text("utf-8")
    assert "NaN" not in text
    unknown = [item for item in json.loads(text)["parameters"] if item["name"] == "c"]
    assert all(item["estimate"] is None and item["flags"] == ["not_identified"] for item in unknown)
    assert not load_result(tmp_path / "result.json").joints[3].known.all()


@pytest.mark.parametrize(
    ("content", "message"),
    [("{", "no JSON"), ("[]", "no saved result"), ('{"schema": "stickslip-fit/result/1"}', "damaged")],
)
def test_a_file_that_is_no_result_is_refused(tmp_path, content, message):
    (tmp_path / "bad.json").write_text(content)
    with pytest.raises(InputError, match=message):
        load_result(tmp_path / "bad.json")


def test_a_failed_write_leaves_what_was_there(log, tmp_path):
    path = tmp_path / "result.json"
    path.write_text("precious")
    result = fit_least_squares(log)
    broken = type(result)(**{**vars(result), "method": object()})
    with pytest.raises(TypeError):
        broken.save(path)
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


def test_predicting_for_a_session_that_was_not_fitted_is_refused(log):
    rows = log.usable.iloc[:3].assign(session="1999-01-01")
    with pytest.raises(InputError, match=r"1999-01-01.*sessions fitted: 2012-03-05, 2012-03-06"):
        fit_least_squares(log).predict(rows)


def test_prediction_keeps_the_order_of_rows(log):
    result = fit_least_squares(log)
    shuffled = log.usable.sample(frac=1.0, random_state=np.random.default_rng(1))
    found = result.predict(shuffled)
    pd.testing.assert_frame_equal(found.loc[log.usable.index], result.predict(log.usable))
