"""StepTable, on a step that has a closed form, with the kink where the regime changes."""

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.simulation import step_table
from stickslip_fit.simulation.step_table import StepTable
from stickslip_fit.step import step_size

PROMISED = 1e-4


def closed_form(points):
    load, mass, friction, voltage, ramp = np.moveaxis(points, -1, 0)
    return step_size(friction / mass, ramp, 30e-9 * voltage, load)


def is_held(points):
    return np.abs(points[:, 0]) * points[:, 1] < points[:, 2]


def points_about(n, *varied):
    rng = np.random.default_rng(3)
    points = np.tile([0.0, 5e-3, 0.25, 32.0, 1.4e-4], (n, 1))
    points[:, 0] = rng.uniform(-9.8, 9.8, n)
    for k in varied:
        points[:, k] *= 1 + 0.08 * rng.random(n)
    return points


@pytest.mark.slow
@pytest.mark.parametrize(("n", "varied", "most"), [(5_000, (), 120), (10_000, (2,), 3_000)])
def test_interpolated_steps_are_within_a_hundredth_of_a_per_cent(n, varied, most):
    points = points_about(n, *varied)
    table = StepTable(lambda point: float(closed_form(point)), is_held)
    found, true = table.steps(points), closed_form(points)
    limited = points[:, 3] * 30e-9 > (points[:, 2] / points[:, 1] - points[:, 0]) * points[:, 4] ** 2
    assert 0.2 < limited.mean() < 0.8
    assert np.abs(found / true - 1).max() < PROMISED
    assert len(table.solved) < most
    solved = len(table.solved)
    np.testing.assert_allclose(table.steps(points), found, rtol=1e-12)
    assert len(table.solved) == solved


def test_a_few_points_are_solved_themselves():
    points = points_about(6, 1, 2, 3)
    table = StepTable(lambda point: float(closed_form(point)), is_held)
    assert np.array_equal(table.steps(points), closed_form(points))
    assert len(table.solved) == 6


def test_where_friction_does_not_hold_there_is_no_step():
    points = points_about(2_000)
    points[:, 0] *= 6
    table = StepTable(lambda point: float(closed_form(point)), is_held)
    found, true = table.steps(points), closed_form(points)
    assert np.isnan(found).any()
    assert np.array_equal(np.isnan(found), np.isnan(true))
    held = ~np.isnan(true)
    scale = np.abs(true[held]).max()
    assert np.abs(found[held] - true[held]).max() < PROMISED * scale


def test_too_many_points_are_refused(monkeypatch):
    monkeypatch.setattr(step_table, "MAX_SOLVED", 50)
    table = StepTable(lambda point: float(closed_form(point)), is_held)
    with pytest.raises(InputError, match=r"more than 50 steps .* let fewer quantities vary"):
        table.steps(points_about(5_000, 2))
