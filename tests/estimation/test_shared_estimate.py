"""Fits with more coefficients than traverses: their covariances, kept by parts, against dense matrices."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares, load_result, result, saved_result
from stickslip_fit.estimation.noise import row_variance
from stickslip_fit.estimation.shared_estimate import SharedCovariance
from stickslip_fit.logs import read_log
from stickslip_fit.machine import load_machine

N_WAVES = 30
MACHINE = """
name = "two stages"
[[joint]]
kind = "rotary"
name = "turn"
range_deg = [0, 360]
[[joint]]
kind = "rotary"
name = "tilt"
range_deg = [0, 360]
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Short traverses of two joints on two days; a session and direction of the second has only one."""
    folder, rng, rows = tmp_path_factory.mktemp("stages"), np.random.default_rng(2), []
    for session in "ab":
        for joint in (1, 2):
            for way in "+-":
                for _ in range(1 if (session, joint, way) == ("b", 2, "-") else 9):
                    low = rng.uniform(0, 340)
                    count = 4000 * np.exp(0.004 * rng.standard_normal() + 0.05 * np.sin(low / 40 + joint))
                    ends = (low, low + 20) if way == "+" else (low + 20, low)
                    rows.append((session, joint, way, round(count), 1, *ends))
    names = ["session", "joint", "direction", "steps", "check_every", "from_deg", "to_deg"]
    table = pd.DataFrame(rows, columns=names).round(3)
    table.assign(q1_deg=0.0, q2_deg=0.0).to_csv(folder / "log.csv", index=False)
    (folder / "stages.toml").write_text(MACHINE, encoding="utf-8")
    return read_log(folder / "log.csv", machine=load_machine(folder / "stages.toml"))


@pytest.fixture(scope="module")
def fit(log):
    """With a function of the position for each session, around one that both share: 90 coefficients."""
    limits, orders = ((0.0, 2 * np.pi),), tuple((k,) for k in range(1, N_WAVES + 1))
    sds = tuple(0.05 / k for k in range(1, N_WAVES + 1))
    term = SmoothTerm(("position",), limits, orders, sds, sessions=("a", "b"), common=0.5)
    return fit_least_squares(log, causes=[term])


def dense_information(log, fit):
    """Of all groups' own parameters, one after the other, and the coefficients; and the groups' places."""
    slopes, weights, places = [], [], {}
    first = sum(len(one.groups) * (one.values.shape[1] - 3 * N_WAVES) for one in fit.joints.values())
    width, begin = first + 3 * N_WAVES, 0
    for joint, one in fit.joints.items():
        rows = log.usable[log.usable["joint"] == joint]
        group, own = one.group_index(rows), one.values.shape[1] - 3 * N_WAVES
        _, rounding = one.law.response(rows)
        jacobian = one.law.model(rows)(one.values[group])[1]
        whole = np.zeros((len(rows), width))
        whole[:, first:] = jacobian[:, own:]
        for k in range(len(one.groups)):
            places[joint, k] = np.r_[begin : begin + own, first:width]
            whole[group == k, begin : begin + own] = jacobian[group == k, :own]
            begin += own
        slopes.append(whole)
        weights.append(1.0 / row_variance(rows, rounding, one.repeatability))
    jacobian, weight = np.concatenate(slopes), np.concatenate(weights)
    sds = [one.prior_sd for one in fit.joints[1].law.cause_parameters]
    prior = np.concatenate([np.zeros(first), 1.0 / np.square(sds)])
    return jacobian.T @ (weight[:, None] * jacobian) + np.diag(prior), places


def test_covariances_are_those_of_the_dense_system(log, fit):
    information, places = dense_information(log, fit)
    assert len(log.usable) < 3 * N_WAVES
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    for joint, one in fit.joints.items():
        assert isinstance(one.covariance, SharedCovariance)
        for group in range(len(one.groups)):
            expected = inverse[np.ix_(places[joint, group], places[joint, group])]
            sd = np.sqrt(np.diag(expected))
            scaled = (one.covariance[group] - expected) / np.outer(sd, sd)
            assert np.abs(scaled).max() < 1e-5
            assert one.covariance.variances[group] == pytest.approx(sd**2, rel=1e-5)
        assert one.known.all()


def test_a_saved_law_comes_back_by_its_parts(log, fit, tmp_path, monkeypatch):
    for module in (result, saved_result):
        monkeypatch.setattr(module, "MAX_WHOLE", 50)
    fit.save(tmp_path / "law.json")
    back = load_result(tmp_path / "law.json")
    for joint, one in fit.joints.items():
        found = back.joints[joint].covariance
        assert isinstance(found, SharedCovariance)
        sd = np.sqrt(one.covariance.variances)
        error = (np.asarray(found) - np.asarray(one.covariance)) / sd[:, :, None] / sd[:, None, :]
        assert np.abs(error).max() < 1e-8
    pd.testing.assert_frame_equal(back.predict(log.usable), fit.predict(log.usable), rtol=1e-4)


def test_a_session_to_come_is_the_same_by_parts_and_by_whole_matrices(fit):
    for one in fit.joints.values():
        whole = replace(one, covariance=np.asarray(one.covariance)).for_session_to_come()
        parts = one.for_session_to_come()
        np.testing.assert_allclose(np.asarray(parts.covariance), whole.covariance, rtol=1e-12)
        np.testing.assert_array_equal(parts.values, whole.values)


@pytest.mark.parametrize("part", ["own", "across", "shared"])
def test_what_is_no_covariance_is_refused(fit, tmp_path, monkeypatch, part):
    for module in (result, saved_result):
        monkeypatch.setattr(module, "MAX_WHOLE", 50)
    one = fit.joints[1]
    changed = getattr(one.covariance, part).copy()
    changed[..., 0, 0] *= -1.0 if part != "across" else 1e3
    broken = replace(one.covariance, **{part: changed})
    fits = {
        joint: replace(each, covariance=broken if joint == 1 else each.covariance)
        for joint, each in fit.joints.items()
    }
    replace(fit, joints=fits).save(tmp_path / "law.json")
    with pytest.raises(InputError, match="damaged"):
        load_result(tmp_path / "law.json")
