import numpy as np
import pandas as pd
import pytest

from stickslip_fit.estimation._groups import group_rows
from stickslip_fit.estimation._optimize import minimize


def grouped(n, g):
    return group_rows(pd.DataFrame({"session": np.repeat(np.arange(g).astype(str), n), "direction": "+"}))


def exponential(x):
    def model(values):
        rate = np.exp(-values[:, 1] * x)
        return values[:, 0] * rate, np.stack([rate, -values[:, 0] * x * rate], axis=-1)

    return model


@pytest.fixture
def problem():
    rng = np.random.default_rng(1)
    groups, x = grouped(40, 50), np.tile(np.linspace(0, 3, 40), 50)
    truth = np.stack([rng.uniform(1, 5, 50), rng.uniform(0.3, 2, 50)], axis=-1)
    y = exponential(x)(truth[groups.of_row])[0] + 0.01 * rng.standard_normal(len(x))
    return groups, x, y


def test_steps_that_are_rounding_noise_end_the_search(problem):
    """No step is ever below a tolerance of 0, and yet every group is done in a few iterations."""
    groups, x, y = problem
    ones = np.ones((50, 2))
    found = minimize(exponential(x), y, np.ones(len(y)), groups, ones, ones, tolerance=0.0)
    assert found.converged.all()
    assert found.iterations < 60


@pytest.mark.parametrize("offset", [1e6, 1e8])
def test_a_response_far_from_zero_is_fitted_as_soon_as_one_about_zero(offset):
    """Its sum of squares has few digits, so that near the minimum no step seems to lower it."""
    rng, groups, x = np.random.default_rng(2), grouped(40, 1), np.linspace(0, 3, 40)
    y = 2.0 * np.exp(-1.3 * x) + 1e-5 * rng.standard_normal(40)
    inner = exponential(x)

    def lifted(values):
        response, slopes = inner(values[:, 1:])
        return values[:, 0] + response, np.column_stack([np.ones(40), slopes])

    about_zero, far = (
        minimize(lifted, shift + y, np.ones(40), groups, start, np.abs(start) + 1.0, tolerance=0.0, most=30)
        for shift, start in ((0.0, np.array([[0.0, 1.0, 1.0]])), (offset, np.array([[offset, 1.0, 1.0]])))
    )
    assert about_zero.converged.all()
    assert far.converged.all()
    standard_error = np.sqrt(np.linalg.inv(about_zero.curvature[0]).diagonal()) * 1e-5
    deviation = (far.values - about_zero.values)[0] - [offset, 0.0, 0.0]
    assert np.all(np.abs(deviation) < 1e-2 * standard_error + 4.0 * np.spacing(offset))


def test_a_group_is_not_disturbed_by_another_that_fails(problem):
    groups, x, y = problem
    ones = np.ones((50, 2))
    alone = minimize(exponential(x), y, np.ones(len(y)), groups, ones, ones)
    spoilt = np.where(groups.of_row == 7, np.nan, y)
    beside = minimize(exponential(x), spoilt, np.ones(len(y)), groups, ones, ones)
    others = np.arange(50) != 7
    assert not beside.converged[7]
    assert beside.converged[others].all()
    assert beside.values[others] == pytest.approx(alone.values[others], rel=1e-9)


def test_a_step_out_of_the_models_domain_is_not_taken(problem):
    groups, x, y = problem
    inner = exponential(x)

    def walled(values):
        response, slopes = inner(values)
        return np.where(values[:, 0] > 4.9, np.nan, response), slopes

    ones = np.ones((50, 2))
    found = minimize(walled, y, np.ones(len(y)), groups, ones, ones, most=200)
    assert np.isfinite(found.residual).all()
    assert found.values[:, 0].max() <= 4.9


def test_a_slow_group_does_not_make_the_others_work_on(problem):
    """A valley without end keeps one group busy; most rows are evaluated only while they move."""
    groups, x, y = problem
    y = np.where(groups.of_row == 7, np.tile(np.r_[1.0, np.zeros(39)], 50), y)
    ones, evaluated = np.ones((50, 2)), 0

    def counted(some):
        inner = exponential(x[some])

        def model(values):
            nonlocal evaluated
            evaluated += len(values)
            return inner(values)

        return model

    everything = np.arange(len(x))
    whole = minimize(counted(everything), y, np.ones(len(y)), groups, ones, ones, tolerance=0.0, most=400)
    without, evaluated = evaluated, 0
    found = minimize(
        counted(everything), y, np.ones(len(y)), groups, ones, ones, subset=counted, tolerance=0.0, most=400
    )
    assert found.iterations == whole.iterations > 20
    assert evaluated < 0.8 * without
    # A sum of products over other rows beside it may round its last bit otherwise on some processors.
    np.testing.assert_allclose(found.curvature, whole.curvature, rtol=1e-12)
    for name in ("values", "residual", "converged", "rank", "at_bound"):
        assert np.array_equal(getattr(found, name), getattr(whole, name))


def test_a_parameter_that_rounding_leaves_beside_its_bound_is_on_it():
    """A falling line whose slope may not be negative: its mean, in the first step."""
    x, start = np.linspace(10.0, 11.0, 20), np.array([[0.6, 1e-17]])

    def line(values):
        slopes = np.stack([np.ones_like(x), x], axis=1)
        return np.vecdot(values, slopes), slopes

    lower = np.array([-np.inf, 0.0])
    found = minimize(
        line, 11.0 - x, np.ones(20), grouped(20, 1), start, np.ones((1, 2)), lower=lower, damping=0.0
    )
    assert found.values == pytest.approx(np.array([[0.5, 0.0]]), abs=1e-12)
    assert found.at_bound.tolist() == [[False, True]]
    assert found.iterations == 2
