"""The event-driven solver against the closed forms, a time-stepped integration, and its own limits."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stickslip_fit.errors import InputError
from stickslip_fit.step import (
    FootMotion,
    coulomb_motion,
    coulomb_step,
    is_friction_limited,
    make_motion,
    motion_from_table,
    step_size,
)
from tests.step.test_closed_form import draws


def test_it_equals_the_closed_forms():
    friction, ramp_time, amplitude, load, flyback_time = draws(5, 100_000)
    limited = is_friction_limited(friction, ramp_time, amplitude, load)
    assert 0.2 < limited.mean() < 0.8
    solved = coulomb_step(make_motion("ramp", amplitude, ramp_time, flyback_time), friction, load)
    closed = step_size(friction, ramp_time, amplitude, load, flyback_time)
    assert np.max(np.abs(solved - closed) / amplitude) < 1e-9
    assert np.ptp(np.sign(closed)) == 2  # a slow flyback may even drive it backwards


def test_periods_that_leave_time_to_rest_are_all_alike_and_hurried_ones_are_not():
    motion = make_motion("ramp", 3e-6, 1e-4, 0.0, 1.2e-4)
    alone = coulomb_step(motion, 100.0, 9.81)
    assert coulomb_step(motion, 100.0, 9.81, periods=7) == pytest.approx(alone, rel=1e-12)
    hurried = coulomb_step(make_motion("ramp", 3e-6, 1e-4, 0.0, 2e-5), 100.0, 9.81, periods=7)
    assert hurried > 1.05 * alone  # it does not stop, so that the ramp catches it moving


@pytest.mark.parametrize("name", ["parabola", "s-curve"])
def test_other_waveforms_agree_with_a_smooth_friction_law(name):
    """A steep tanh in place of the sign: an integration that shares nothing with events."""
    motion = make_motion(name, 2e-6, 1e-4, 2e-5)
    friction, load = 300.0, 20.0
    exact = coulomb_step(motion, friction, load)

    y = np.zeros(2)
    for duration, _, speed, change in zip(
        motion.duration[:3], motion.position, motion.velocity, motion.acceleration, strict=False
    ):
        foot = (speed, change)

        def rate(t, y, foot=foot):
            return [y[1], -friction * np.tanh((y[1] - foot[0] - foot[1] * t) / 1e-6) - load]

        if duration:
            y = solve_ivp(rate, (0, duration), y, "LSODA", rtol=1e-9, atol=1e-14).y[:, -1]
    rest = solve_ivp(
        lambda t, y: [y[1], -friction * np.tanh(y[1] / 1e-6) - load],
        (0, 1e-3),
        y,
        "LSODA",
        rtol=1e-9,
        atol=1e-14,
    )
    creep = 1e-6 * np.arctanh(load / friction) * 1e-3  # of the smooth law under load
    assert rest.y[0, -1] + creep == pytest.approx(exact, abs=2e-3 * 2e-6)


def test_a_parabola_starts_the_slider_without_slip():
    """Below a_f no friction is exceeded on the way up: the slider has all of D, and coasts from 2 D / T1."""
    d, t, friction = 1e-6, 2e-4, 100.0
    solved = coulomb_motion(make_motion("parabola", d, t), friction)
    assert list(solved.slip) == [0.0, 1.0]
    assert solved.at(1.0) == pytest.approx(d + (2 * d / t) ** 2 / (2 * friction), rel=1e-12)
    assert coulomb_step(make_motion("parabola", d, t), friction) == pytest.approx(solved.at(1.0), rel=1e-12)


def test_static_friction_above_kinetic_holds_a_slider_that_kinetic_friction_would_not():
    motion = make_motion("parabola", 1e-6, 1e-4)  # 200 m/s^2
    weak, held = (coulomb_step(motion, 150.0, breakaway=ratio) for ratio in (1.0, 1.4))
    assert held == pytest.approx(1e-6 + 0.02**2 / 300, rel=1e-12)
    assert weak < 0.9 * held


def test_friction_is_what_the_motion_needs():
    solved = coulomb_motion(make_motion("s-curve", 2e-6, 1e-4, 2e-5, 1e-4), 100.0, 30.0, periods=2)
    assert np.all(np.abs(solved.friction) <= 100.0 * (1 + 1e-12))
    slips = solved.slip != 0
    np.testing.assert_allclose(solved.friction[slips], -100.0 * solved.slip[slips], rtol=1e-12)
    ends = solved.velocity + solved.acceleration * np.diff(solved.time)
    np.testing.assert_allclose(ends[:-1], solved.velocity[1:], atol=1e-12)  # no jump of the slider's speed
    assert ends[-1] == pytest.approx(0, abs=1e-12)


def test_a_table_is_the_waveform_that_it_tabulates():
    tabulated = motion_from_table([0, 1e-4, 1.05e-4, 3e-4], [0, 1e-6, 0, 0])
    named = make_motion("ramp", 1e-6, 1e-4, 5e-6, 1.95e-4)
    assert coulomb_step(tabulated, 60.0, 9.81) == pytest.approx(coulomb_step(named, 60.0, 9.81), rel=1e-12)
    t = np.linspace(0, 3e-4, 50)
    np.testing.assert_allclose(tabulated.at(t), named.at(t), atol=1e-18)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"load": 100.0}, "runs away"),
        ({"load": -100.0}, "runs away"),
        ({"friction": 0.0}, "above 0"),
        ({"breakaway": 0.9}, "at least 1"),
        ({"periods": 0}, "periods"),
        ({"periods": 10**9}, "at most 100,000 for this motion"),
    ],
)
def test_what_has_no_step_is_refused(change, message):
    values = {"friction": 100.0, "load": 0.0, "breakaway": 1.0, "periods": 1} | change
    with pytest.raises(InputError, match=message):
        coulomb_step(make_motion("ramp", 1e-6, 1e-4), values.pop("friction"), values.pop("load"), **values)


@pytest.mark.parametrize(
    ("times", "positions", "message"),
    [
        ([0, 1], [0, 0], "three"),
        ([0, 1, 2], [0, 1, np.nan], "finite"),
        ([1, 2, 3], [0, 1, 0], "begin at 0"),
        ([0, 2, 1], [0, 1, 0], "not go back"),
        ([0, 1, 2], [0, 0, 0], "must move"),
        ([0, 1, 2], [0, 1, 1], "repeats"),
    ],
)
def test_a_table_that_is_no_waveform_is_refused(times, positions, message):
    with pytest.raises(InputError, match=message):
        motion_from_table(times, positions)


def test_an_unknown_waveform_is_refused():
    with pytest.raises(InputError, match="did you mean parabola"):
        make_motion("parabolic", 1e-6, 1e-4)
    with pytest.raises(InputError, match="above 0"):
        make_motion("ramp", -1e-6, 1e-4)


def test_many_pieces_end_in_a_fixed_number_of_phases():
    """Noise as a waveform: the number of events is bounded by twice the pieces, whatever the motion."""
    rng = np.random.default_rng(1)
    pieces = 2000
    positions = np.concatenate([[0], rng.normal(0, 1e-7, pieces - 1), [0]])
    motion = motion_from_table(np.arange(pieces + 1) * 1e-6, positions)
    assert isinstance(motion, FootMotion)
    solved = coulomb_motion(motion, 100.0, 5.0)
    assert len(solved.position) <= 2 * pieces + 1
    assert np.isfinite(solved.at(1.0))
