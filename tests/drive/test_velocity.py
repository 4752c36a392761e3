"""From a tip velocity to joint velocities, against numpy's least squares with the machine's Jacobian."""

import numpy as np
import pytest

from stickslip_fit.drive.velocity import (
    DAMPED_WITHIN,
    axis_distance,
    damping_of,
    joint_velocity,
    tip_velocity,
)
from stickslip_fit.machine import jacobian, load_machine

MACHINE = load_machine()
RANGES = np.array([MACHINE.ranges[joint] for joint in (1, 2, 3)])


def draw(seed: int, count: int):
    rng = np.random.default_rng(seed)
    return rng.uniform(*RANGES.T, (count, 3)), rng.standard_normal((count, 3)) * 30e-6


def test_the_tip_moves_as_wanted_away_from_the_axis():
    for q, wanted in zip(*draw(1, 200), strict=True):
        if abs(axis_distance(MACHINE, q)) > DAMPED_WITHIN:
            assert jacobian(MACHINE, q) @ joint_velocity(MACHINE, q, wanted) == pytest.approx(
                wanted, abs=1e-15
            )


def test_near_the_axis_it_is_damped_least_squares():
    """min |J w - v|^2 + lambda^2 w1^2, solved as stacked equations; joints 2 and 3 need no damping."""
    rng = np.random.default_rng(2)
    for _ in range(100):
        q3, near = rng.uniform(0, 0.012), rng.uniform(-0.9, 0.9) * DAMPED_WITHIN
        q2 = np.arcsin((MACHINE.a1 - near) / (MACHINE.l2 + q3))
        q, wanted = np.array([rng.uniform(-2, 2), q2, q3]), rng.standard_normal(3) * 30e-6
        lam = np.sqrt(damping_of(axis_distance(MACHINE, q)))
        stacked = np.vstack([jacobian(MACHINE, q), [lam, 0.0, 0.0]])
        expected = np.linalg.lstsq(stacked, np.append(wanted, 0.0))[0]
        assert joint_velocity(MACHINE, q, wanted) == pytest.approx(expected, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(
    "degrees", np.concatenate([np.linspace(14.6, 19.5, 9), np.linspace(-199.5, -194.6, 9)])
)
def test_on_the_axis_no_joint_runs_away(degrees):
    """Where sin q2 = a1 / (l2 + q3), inside joint 2's range, sideways motion takes a bounded rate."""
    q2 = np.radians(degrees)
    q3 = MACHINE.a1 / np.sin(q2) - MACHINE.l2
    for off in (0.0, 1e-6, 1e-4, 2e-3):
        rates = joint_velocity(MACHINE, (0.3, q2, q3 + off), (40e-6, 40e-6, 10e-6))
        assert np.all(np.isfinite(rates))
        assert abs(rates[0]) < 0.03
    assert joint_velocity(MACHINE, (0.0, q2, q3), (0.0, 60e-6, 0.0))[0] == pytest.approx(0.0, abs=1e-9)


def test_joint_velocities_give_the_tip_the_jacobian_s_velocity():
    for q, rates in zip(*draw(3, 50), strict=True):
        assert tip_velocity(MACHINE, q, rates) == pytest.approx(jacobian(MACHINE, q) @ rates, abs=1e-15)
