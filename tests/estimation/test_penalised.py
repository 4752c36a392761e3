"""Causes whose coefficients have a prior, in a fit of a log: ridge regression by hand, and there and back."""

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes import AlongTravel
from stickslip_fit.estimation._arrow_products import ParameterSharing
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.estimation._problem import Problem
from stickslip_fit.machine import load_machine

MACHINE = '[[joint]]\nkind = "rotary"\nname = "turn"\nrange_deg = [0, 100]\n'
SIGMA, N = 0.02, 120


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """Short traverses of one joint in one direction, along which its profile is nearly constant."""
    folder, rng = tmp_path_factory.mktemp("stage"), np.random.default_rng(5)
    low = rng.uniform(0, 95, N)
    low[:2], middle = (0.0, 95.0), low + 2.5
    gamma = np.radians(0.01) * (1 + 0.05 * np.sin(middle / 12) + 0.02 * np.cos(middle / 5))
    steps = np.round(np.radians(5.0) / gamma * np.exp(SIGMA * rng.standard_normal(N))).astype(int)
    table = pd.DataFrame(
        {"session": "a", "joint": 1, "direction": "+", "steps": steps, "check_every": 1}
        | {"from_deg": low, "to_deg": low + 5.0}
    )
    table.to_csv(folder / "log.csv", index=False)
    (folder / "stage.toml").write_text(f'name = "stage"\n{MACHINE}', encoding="utf-8")
    return ssf.read_log(folder / "log.csv", machine=load_machine(folder / "stage.toml"))


def ridge(log, version):
    """Level and coefficients, their covariance and the noise, by the normal equations."""
    rows = log.rows
    ends = rows[["start", "stop"]].to_numpy(float)
    ((_, low, high),) = version.travel
    inside = np.linspace(ends[:, 0], ends[:, 1], 41, axis=1)
    k = np.arange(1, len(version.sds) + 1)
    means = np.trapezoid(np.cos(np.pi * k * (inside[:, :, None] - low) / (high - low)), axis=1) / 40
    y = np.log(np.abs(np.diff(ends)[:, 0]) / rows["steps"].to_numpy(float))
    sd = np.array([parameter.prior_sd for parameter in version.parameters])
    sigma2, values = SIGMA**2, np.zeros(1 + len(k))
    for _ in range(30):
        slopes = np.column_stack([np.ones(N), means])
        residual = y - slopes @ values
        curvature = slopes.T @ slopes / sigma2
        prior = np.append(0.0, 1.0 / sd**2)
        values += np.linalg.solve(curvature + np.diag(prior), slopes.T @ residual / sigma2 - prior * values)
        covariance = np.linalg.inv(curvature + np.diag(prior))
        sigma2 = np.sum(residual**2) / (N - np.trace(curvature @ covariance))
    return values, covariance, np.sqrt(sigma2)


@pytest.mark.parametrize("amplitude", [0.5, 5.0, 50.0])
def test_a_fit_is_that_of_ridge_regression_with_its_noise_and_its_intervals(stage, amplitude):
    rows = stage.rows
    (version, _), *_ = AlongTravel().bind(rows, stage.machine).with_amplitude(amplitude).trials(rows)
    fit = ssf.fit(stage, causes=[version]).joints[1]
    values, covariance, sigma = ridge(stage, version)
    error = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(fit.values[0, 1:], values[1:], atol=0.05 * error[1:].max())
    np.testing.assert_allclose(np.sqrt(np.diagonal(fit.covariance[0]))[1:], error[1:], rtol=0.05)
    assert fit.repeatability["+"].value == pytest.approx(sigma, rel=0.03)


def test_a_fit_finds_length_and_amplitude_by_itself_and_is_constant_beyond_the_travel(stage, tmp_path):
    result = ssf.fit(stage, causes=[AlongTravel()])
    fit = result.joints[1]
    (cause,) = fit.law.causes
    assert cause.amplitude is not None
    assert not cause.directions
    position = np.radians(np.array([[10.0, 50.0, 80.0, 100.0, 140.0, 170.0]]))
    row = {"start": np.zeros(1), "stop": np.ones(1)} | {name: np.zeros(1) for name in fit.law.columns}
    step = fit.law.step_size(row, position, fit.values[:1])[0]
    true = 1 + 0.05 * np.sin(np.degrees(position[0]) / 12) + 0.02 * np.cos(np.degrees(position[0]) / 5)
    np.testing.assert_allclose(step[:3] / step[0], true[:3] / true[0], atol=0.02)
    assert step[3] == step[4] == step[5]
    result.save(tmp_path / "law.json")
    back = ssf.load_result(tmp_path / "law.json").joints[1]
    assert back.law.causes == fit.law.causes
    np.testing.assert_array_equal(back.law.step_size(row, position, back.values[:1])[0], step)


@pytest.mark.parametrize("number", [20, 60, 300])
def test_each_group_loses_the_degrees_of_freedom_that_its_leverage_takes(number):
    """`number` coefficients with priors, and a level of each of 12 groups of 20 rows; by the hat matrix."""
    rng, g, each = np.random.default_rng(3), 12, 20
    of_group, n = np.repeat(np.arange(g), each), g * each
    slopes = np.column_stack([np.ones(n), rng.standard_normal((n, number))])
    prior_sd = 0.3 / np.sqrt(np.arange(1.0, number + 1.0))
    y = rng.standard_normal(n) + slopes[:, 1:] @ (prior_sd * rng.standard_normal(number))
    table = pd.DataFrame({"session": np.arange(g).astype(str), "direction": "+"})
    one_set = Groups(pd.DataFrame({"set": [0]}), np.zeros(g, dtype=np.intp))
    shape = (g, 1 + number)
    problem = Problem(
        Groups(table, of_group),
        ParameterSharing(np.arange(1 + number) > 0, one_set),
        y,
        lambda of_row: (np.sum(slopes * of_row, axis=1), slopes),
        np.zeros(shape),
        np.ones(shape),
        np.full(shape, -np.inf),
        np.full(shape, np.inf),
        prior_sd=prior_sd,
    )
    rank = problem.minimize(np.ones(n), problem.start).rank
    design = np.column_stack([np.eye(g)[of_group], slopes[:, 1:]])
    precision = np.diag(np.concatenate([np.zeros(g), 1.0 / prior_sd**2]))
    hat = design @ np.linalg.solve(design.T @ design + precision, design.T)
    taken = np.bincount(of_group, np.diag(hat))
    assert rank.sum() == pytest.approx(taken.sum(), abs=1.0)
    np.testing.assert_allclose(rank, taken, atol=2.0)
