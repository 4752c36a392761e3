"""The block-arrow system on its own: what it costs, and that its solution is that of a dense system."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

from stickslip_fit.estimation._block_arrow import share_by_direction, share_with_all, solve_block_arrow
from stickslip_fit.estimation._groups import Groups, group_rows
from stickslip_fit.laws import Prismatic


def test_the_border_converges_as_fast_as_newton_does():
    """Were the blocks' answer to a change of the border forgotten, a hundred steps would be needed."""
    rng, sessions, each = np.random.default_rng(0), 6, 20
    rows = pd.DataFrame(
        {
            "session": np.repeat([f"day {k}" for k in range(sessions)], each),
            "direction": "+",
            "q2": rng.uniform(-2.3, 0.2, sessions * each),
            "theta": rng.uniform(-1.5, 1.5, sessions * each),
            "psi": rng.uniform(-1, 1, sessions * each),
            "start": 0.0,
            "stop": 0.012,
        }
    )
    law, groups, mean_step = Prismatic(), group_rows(rows), np.full(sessions, 900e-9)
    truth = np.array([970e-9, 0.3, 430e-9]) * np.linspace(0.98, 1.02, sessions)[:, None]
    truth[:, 1] = 0.3
    y = law.predict(rows, truth[groups.of_row]) + 0.003 * rng.standard_normal(len(rows))
    found = solve_block_arrow(
        law.model(rows), y, np.ones(len(y)), groups, share_by_direction(("a", "b", "c"), ("b",), groups),
        law.start_values(mean_step), law.scales(mean_step),
    )  # fmt: skip
    assert found.converged.all()
    assert found.iterations < 8
    assert np.ptp(found.values[:, 1]) == 0.0


def test_a_search_that_creeps_towards_the_end_of_the_domain_is_given_up():
    """sqrt(1 - k) x cannot be -x: the least squares are at k = 1, beyond which there is nothing."""
    x = np.tile(np.linspace(-1.0, 1.0, 20), 2)
    groups = Groups(pd.DataFrame({"group": range(2)}), np.repeat([0, 1], 20))

    def model(values):
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(1.0 - values[:, 1])
            return values[:, 0] + root * x, np.stack([np.ones(40), -x / (2 * root)], axis=1)

    def search(**options):
        sharing = share_with_all(np.array([False, True]), groups)
        return solve_block_arrow(
            model, 0.1 - x, np.ones(40), groups, sharing, np.zeros((2, 2)), np.ones((2, 2)),
            tolerance=0.0, most=400, **options,
        )  # fmt: skip

    whole, given_up = search(), search(least_fall=0.01)
    assert (whole.iterations, given_up.iterations < 100) == (400, True)
    assert not given_up.converged.any()
    assert np.sum(given_up.residual**2) < 1.01 * np.sum(whole.residual**2)


@pytest.mark.parametrize("bound", [np.inf, 0.8])
def test_the_minimum_is_that_of_a_dense_solver(bound):
    """Growth y = a exp(k x) + c with one rate for all groups, free or held by a bound, against scipy."""
    rng = np.random.default_rng(3)
    of_row = np.repeat(np.arange(4), [5, 9, 7, 20])
    groups = Groups(pd.DataFrame({"group": range(4)}), of_row)
    x, weight = rng.uniform(0, 2, len(of_row)), rng.uniform(0.5, 2, len(of_row))
    y = np.array([1.0, 2.0, 0.5, 1.5])[of_row] * np.exp(0.9 * x) + of_row + 0.1 * rng.standard_normal(len(x))

    def model(values):
        grown = np.exp(values[:, 1] * x)
        slopes = np.stack([grown, values[:, 0] * x * grown, np.ones_like(x)], axis=-1)
        return values[:, 0] * grown + values[:, 2], slopes

    start, scales = np.tile([1.0, 0.1, 0.0], (4, 1)), np.ones((4, 3))
    sharing = share_with_all(np.array([False, True, False]), groups)
    upper = np.array([np.inf, bound, np.inf])
    found = solve_block_arrow(model, y, weight, groups, sharing, start, scales, upper=upper)

    def residual(p):
        return np.sqrt(weight) * (model(np.stack([p[:4], np.full(4, p[8]), p[4:8]], axis=-1)[of_row])[0] - y)

    limits = (-np.inf, np.r_[np.full(8, np.inf), bound])
    dense = least_squares(
        residual, np.r_[np.ones(4), np.zeros(4), 0.1], bounds=limits, xtol=1e-15, ftol=1e-15, gtol=1e-14
    )
    assert found.converged.all()
    assert found.at_bound[:, 1].all() == np.isfinite(bound)
    assert found.values[:, [0, 2]].T.ravel() == pytest.approx(dense.x[:8], rel=1e-6, abs=1e-6)
    assert found.values[:, 1] == pytest.approx(dense.x[8], rel=1e-6)
    assert found.rank.sum() == 9
    if np.isinf(bound):
        covariance = np.linalg.inv(dense.jac.T @ dense.jac)
        assert np.linalg.inv(found.curvature[0])[0, 0] == pytest.approx(covariance[8, 8], rel=1e-4)


def make_linear(rng, groups, p):
    """Random slopes of a linear model, and the model, which has no value where its first parameter is 5."""
    slopes = rng.standard_normal((len(groups.of_row), p))

    def model(values):
        inside = np.where(values[:, :1] == 5.0, np.nan, slopes)
        return np.vecdot(inside, values), inside

    return slopes, model


@pytest.mark.parametrize("held", [False, True])
def test_more_shared_parameters_than_rows_of_any_group_in_two_sets(held):
    """Each direction's 12 shared parameters beside 2 own ones of each of its 4 groups, against lstsq."""
    rng = np.random.default_rng(7)
    table = pd.DataFrame({"session": list("aabbccdd"), "direction": list("+-" * 4)})
    groups, shared = Groups(table, rng.permutation(np.repeat(np.arange(8), 9))), 2 + np.arange(12)
    slopes, model = make_linear(rng, groups, 14)
    names = tuple(f"p{k}" for k in range(14))
    sharing = share_by_direction(names, names[2:], groups)
    y, weight = rng.standard_normal(72), rng.uniform(0.5, 2.0, 72)
    scales = np.tile(rng.uniform(0.1, 10.0, 14), (8, 1))
    lower = np.full(14, -np.inf)
    lower[5] = 1.0 if held else -np.inf
    found = solve_block_arrow(
        model, y, weight, groups, sharing, np.tile(np.maximum(lower, 0.1), (8, 1)), scales, lower=lower
    )
    assert found.converged.all()
    for way, sign in enumerate("+-"):
        own = np.flatnonzero(table["direction"] == sign)
        rows = np.isin(groups.of_row, own)
        blocks = [slopes[rows, :2] * (groups.of_row[rows] == group)[:, None] for group in own]
        design = np.concatenate([*blocks, slopes[np.ix_(rows, shared)]], axis=1)
        root = np.sqrt(weight[rows])
        free = np.ones(20, dtype=bool)
        free[11] = not held  # the bound is the least with which the data would go below it
        target = y[rows] - (slopes[rows, 5] * 1.0 if held else 0.0)
        solution = np.linalg.lstsq(design[:, free] * root[:, None], target * root)[0]
        whole = np.ones(20)
        whole[free] = solution
        assert found.values[own[0], shared] == pytest.approx(whole[8:], abs=1e-9)
        assert found.values[own][:, :2].ravel() == pytest.approx(whole[:8], abs=1e-9)
        information = design.T @ (weight[rows, None] * design)
        inverse = np.linalg.inv(information)[8:, 8:]
        assert np.linalg.inv(found.curvature[way]) == pytest.approx(inverse, rel=1e-6, abs=1e-12)
    assert found.rank.sum() == 40


@pytest.mark.parametrize("n", [6, 30])
def test_parameters_with_priors_be_they_more_than_rows_or_fewer(n):
    """20 shared ones beside 2 own ones of each of 4 groups, against ridge regression by a dense matrix."""
    rng = np.random.default_rng(9)
    groups = Groups(pd.DataFrame({"group": range(4)}), np.tile(np.arange(4), n // 2 + 1))
    rows, names = len(groups.of_row), np.arange(22)
    slopes, model = make_linear(rng, groups, 22)
    y, weight, precision = rng.standard_normal(rows), rng.uniform(1.0, 9.0, rows), rng.uniform(0.5, 50.0, 20)
    scales = np.tile(rng.uniform(0.1, 10.0, 22), (4, 1))
    found = solve_block_arrow(
        model, y, weight, groups, share_with_all(names >= 2, groups), np.zeros((4, 22)), scales,
        precision=precision,
    )  # fmt: skip
    blocks = [slopes[:, :2] * (groups.of_row == group)[:, None] for group in range(4)]
    design = np.concatenate([*blocks, slopes[:, 2:]], axis=1)
    information = design.T @ (weight[:, None] * design) + np.diag(np.r_[np.zeros(8), precision])
    whole = np.linalg.solve(information, design.T @ (weight * y))
    assert found.converged.all()
    assert found.values[:, 2:] == pytest.approx(np.tile(whole[8:], (4, 1)), abs=1e-9)
    assert found.values[:, :2].ravel() == pytest.approx(whole[:8], abs=1e-8)
    covariance = np.linalg.inv(information)[8:, 8:]
    assert np.linalg.inv(found.curvature[0]) == pytest.approx(covariance, rel=1e-6, abs=1e-12)
    assert found.rank.sum() == 28


def test_a_group_where_the_model_has_no_value_costs_infinitely_much():
    rng = np.random.default_rng(8)
    groups = Groups(pd.DataFrame({"group": range(2)}), np.repeat([0, 1], 10))
    _, model = make_linear(rng, groups, 3)
    sharing = share_with_all(np.array([False, False, True]), groups)
    start = np.array([[1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    found = solve_block_arrow(
        model, rng.standard_normal(20), np.ones(20), groups, sharing, start, np.ones((2, 3))
    )
    assert not found.converged.any()
    assert found.values.tolist() == start.tolist()


@pytest.mark.parametrize(("settled_fall", "iterations"), [(0.0, range(100, 2000)), (0.9999, range(50))])
def test_a_sum_of_squares_that_hardly_falls_ends_the_search_where_that_is_asked_for(settled_fall, iterations):
    """Along a curved valley (H. Rosenbrock, Comput. J. 3:175, 1960), its steepness the own parameter."""
    groups = Groups(pd.DataFrame({"session": ["a"], "direction": ["+"]}), np.zeros(2, dtype=int))
    sharing = share_by_direction(("own", "common"), ("common",), groups)

    def valley(values):
        own, common = values[0]
        slopes = np.array([[-2e3 * own, 1e3], [-1.0, 0.0]])
        return np.array([1e3 * (common - own**2), -own]), slopes

    data = valley, np.array([0.0, -1.0]), np.ones(2), groups, sharing
    found = solve_block_arrow(
        *data, np.array([[-1.2, 1.0]]), np.ones((1, 2)), settled_fall=settled_fall, offset_tol=0.0
    )
    assert found.converged.all()
    assert found.iterations in iterations
    assert (found.values == pytest.approx(np.ones((1, 2)), abs=1e-6)) == (not settled_fall)
