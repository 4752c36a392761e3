"""The closed forms of a step: continuity, symmetry, the printed values of a and c, derivatives."""

import numpy as np
import pytest

from stickslip_fit.step import (
    back_slip,
    drive_ratio,
    is_friction_limited,
    settling_time,
    step_size,
)

GRAVITY = 9.81


def draws(seed: int, size: int) -> tuple[np.ndarray, ...]:
    """Friction, ramp time, amplitude, load, flyback time: all regimes, with and without back-slip."""
    rng = np.random.default_rng(seed)
    friction = rng.uniform(20, 200, size)
    ramp_time = rng.uniform(5e-5, 4e-4, size)
    amplitude = friction * ramp_time**2 * np.exp(rng.uniform(-2.5, 1.5, size))
    load = friction * rng.uniform(-0.9, 0.9, size)
    flyback_time = ramp_time * rng.choice([0, 0.05, 0.3, 1, 3], size)
    return friction, ramp_time, amplitude, load, flyback_time


def test_without_load_the_step_is_the_amplitude_or_what_friction_allows():
    assert step_size(80.0, 1e-4, 0.5e-6) == pytest.approx(0.5e-6, rel=1e-14)
    assert step_size(80.0, 1e-4, 5e-6) == pytest.approx(80e-8, rel=1e-14)


def test_regimes_meet_where_lambda_is_one_less_r():
    r = np.linspace(-0.9, 0.9, 19)
    ramp_time, friction = 1e-4, 60.0
    amplitude = (1 - r) * friction * ramp_time**2
    for factor in (1 - 1e-12, 1 + 1e-12):
        step = step_size(friction, ramp_time, factor * amplitude, r * friction)
        np.testing.assert_allclose(step, amplitude / (1 + r), rtol=1e-10)
        limited = is_friction_limited(friction, ramp_time, factor * amplitude, r * friction)
        assert np.all(limited == (factor > 1))


def test_the_load_response_is_odd_where_the_slider_catches_up_and_bends_where_it_does_not():
    load = np.array([-GRAVITY, GRAVITY])
    reached = step_size(100.0, 1e-4, 0.3e-6, load) - 0.3e-6
    assert reached.sum() == pytest.approx(0, abs=1e-22)
    assert reached[0] > 0
    limited = step_size(100.0, 1e-4, 5e-6, load) - 1e-6
    # (1 - r) / (1 + r) + (1 + r) / (1 - r) - 2 = 4 r^2 / (1 - r^2)
    r = 0.0981
    assert limited.sum() == pytest.approx(1e-6 * 4 * r**2 / (1 - r**2), rel=1e-9)


def test_a_and_c_give_friction_and_ramp_time_where_friction_limits():
    """a = a_f T1^2 and c = 2 g T1^2 of the thesis's positive direction, Fig. 4.13."""
    a, c = 972e-9, 375.55e-9
    ramp_time = np.sqrt(c / (2 * GRAVITY))
    friction = a / ramp_time**2
    assert friction / GRAVITY == pytest.approx(2 * a / c, rel=1e-12)
    step = step_size(friction, ramp_time, 3e-6, np.array([-1e-4, 0, 1e-4]))
    assert step[1] == pytest.approx(a, rel=1e-12)
    assert -(step[2] - step[0]) / 2e-4 * GRAVITY == pytest.approx(c, rel=1e-6)


def test_the_step_grows_with_mass_where_the_flyback_is_slow():
    force, mass = 4e-3, np.array([60e-6, 80e-6, 100e-6])
    friction = force / mass
    assert not is_friction_limited(friction, 4e-4, 1e-6).any()
    assert np.all(np.diff(step_size(friction, 4e-4, 1e-6, 0.0, 1e-4)) > 0)
    assert np.all(back_slip(friction, 4e-4, 1e-6, 0.0, 0.0) == 0)


def test_a_flyback_as_slow_as_the_ramp_still_moves_because_the_foot_rests_at_one_end_only():
    """Without load the slider slips by speed change squared: -U^2 / 2, (2 U)^2 / 2, -U^2 / 2, over a_f."""
    friction, ramp_time, *_ = draws(2, 200)
    amplitude = friction * ramp_time**2 * 0.2
    step = step_size(friction, ramp_time, amplitude, 0.0, ramp_time)
    np.testing.assert_allclose(step / amplitude, 0.2, rtol=1e-12)


def test_the_slider_rests_after_the_settling_time():
    assert settling_time(50.0, 1e-4, 1e-7, 10.0) == pytest.approx(1e-3 / 60)
    # The flyback outlasts the coast, and drags the slider along at its own speed.
    assert settling_time(50.0, 4e-4, 1e-6, 0.0, 2e-3) == pytest.approx(2e-3 + 5e-4 / 50)


def test_outside_the_domain_there_is_no_step():
    for arguments in (
        (50.0, 1e-4, 1e-6, 50.0),
        (50.0, 1e-4, 1e-6, -60.0),
        (-50.0, 1e-4, 1e-6, 0.0),
        (50.0, 0.0, 1e-6, 0.0),
        (50.0, 1e-4, 0.0, 0.0),
        (50.0, 1e-4, 1e-6, 0.0, -1e-5),
    ):
        assert np.isnan(step_size(*arguments))
        assert arguments[4:] or not is_friction_limited(*arguments)
    assert np.isnan(drive_ratio(-1.0, 1e-4, 1e-6))
