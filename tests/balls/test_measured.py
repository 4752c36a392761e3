"""Measured ball drops: free fall is wrong, quadratic drag is why, and knowing it predicts another drop.

The heights are those that the camera gives, and the camera errs: see `tests.balls.camera`. Even straightened
they keep errors of about 0.1 m that last for many frames, so that structure without a name is left beside
drag, and intervals, which take errors of frames for independent, are those of the frames alone. Straightened
by anything from 0.0078 to 0.0105 per metre, the first finding for four balls is quadratic drag; the green
basketball is at the edge. The other balls do not tell drag's law from errors of the camera's scale: nothing
is asked of them but the alarm. As filmed no ball tells, and whiffle balls seem to be under linear drag, which
a slant makes of a quadratic one.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from tests.balls.camera import bend, straightened
from tests.balls.causes import AnotherG
from tests.balls.fall import G
from tests.balls.measured import DATA, measured
from tests.balls.problem import make_problem
from tests.balls.table import drag_coefficient, judged

pytestmark = pytest.mark.skipif(not DATA.exists(), reason="the measured ball drops are not at hand")

TELL = ("volleyball", "whiffle-ball-1", "whiffle-ball-2", "yellow-whiffle-ball")


@pytest.fixture(scope="module")
def filmed():
    return dict(list(measured().groupby("ball")))


@pytest.fixture(scope="module")
def straight():
    frames = measured()
    return dict(list(straightened(frames, bend(frames)).groupby("ball")))


@pytest.fixture(scope="module")
def table(straight):
    return {ball: judged(straight[ball]) for ball in TELL}


def by_scipy(rows):
    """k of quadratic drag, height and velocity at release of each drop, by an adaptive integrator."""
    drops = [each[["seconds", "height"]].to_numpy(float).T for _, each in rows.groupby("session")]

    def off(x):
        k, *begin = x
        left = []
        for (seconds, height), y0 in zip(drops, np.reshape(begin, (-1, 2)), strict=True):
            fall = solve_ivp(
                lambda _, y: [y[1], -G - k * y[1] * abs(y[1])], (0, seconds[-1]), y0,
                t_eval=seconds, rtol=1e-8, atol=1e-8,
            )  # fmt: skip
            left.append(height - fall.y[0])
        return np.concatenate(left)

    start = [0.02, *(each for _, height in drops for each in (height[0], 0.0))]
    return least_squares(off, start, x_scale=[0.01, 1, 1, 1, 1]).x[0]


def test_the_camera_errs(filmed):
    """Nothing falls faster than in free fall, but the bowling ball's first drop seems to."""
    rows = filmed["bowling-ball"]
    problem, _ = make_problem(rows[rows["session"] == "drop 1"], [])
    found = problem.fit_extended([AnotherG()], np.zeros(1))
    assert found.values[0] > 3 * np.sqrt(found.covariance[0, 0])


@pytest.mark.parametrize("ball", TELL)
def test_quadratic_drag_is_named(table, ball):
    first, *others = table[ball].diagnosis.findings
    assert table[ball].diagnosis.p_value < 0.001
    assert (first.cause, first.equivalent) == ("quadratic-drag", ())
    assert [each.cause for each in others] == ["unknown"]
    assert others[0].effect.estimate < 0.1 * first.effect.estimate


@pytest.mark.parametrize("ball", TELL)
def test_drag_is_as_large_as_scipy_finds_it(table, straight, ball):
    found, expected = table[ball].k, by_scipy(straight[ball])
    assert found.estimate == pytest.approx(expected, rel=1e-3)
    assert found.low < expected < found.high
    assert found.high - found.low < 0.05 * expected


def test_drag_coefficients_are_those_of_rough_balls(table, straight):
    """Spheres of this Reynolds number have 0.4 to 0.5; holes make it more. Alike balls are alike."""
    whiffle = TELL[1:]
    found = [drag_coefficient(table[ball].k.estimate, straight[ball]) for ball in whiffle]
    assert all(0.4 < each < 0.8 for each in found)
    assert found[0] == pytest.approx(found[1], rel=0.05)


@pytest.mark.parametrize("ball", TELL)
def test_the_later_half_of_the_drop_held_out_is_predicted_better(table, ball):
    worth = table[ball].gain
    assert worth.extended < 0.15 * worth.baseline
    assert 0 < worth.low < worth.baseline - worth.extended < worth.high


@pytest.mark.nightly
def test_free_fall_is_wrong_for_every_ball(straight):
    for ball, rows in straight.items():
        assert judged(rows).diagnosis.verdict != "nothing wrong", ball
