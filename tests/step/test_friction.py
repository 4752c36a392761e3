"""Friction models: the published LuGre case as its figures show it, and each model's domain.

C. Canudas de Wit et al., IEEE Trans. Automatic Control 40:419 (1995): sigma0 = 1e5 N/m, sigma1 = sqrt(1e5)
N s/m, sigma2 = 0.4 N s/m, Fc = 1 N, Fs = 1.5 N, vs = 1 mm/s.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stickslip_fit.errors import InputError
from stickslip_fit.step import Dahl, Elastoplastic, LuGre, MaxwellSlip, spread_maxwell_slip

PUBLISHED = LuGre(1.0, 1.5, 1e-3, 1e5, float(np.sqrt(1e5)), 0.4)


def pull(force, time, samples=2000, model=PUBLISHED, mass=1.0, rtol=1e-7):
    """Position, velocity and friction of a mass under force(t, x)."""

    def rate(t, y):
        friction, change = model.evaluate(y[2:], y[1])
        return [y[1], (force(t, y[0]) - friction) / mass, *change]

    t = np.linspace(0, time, samples)
    y = solve_ivp(rate, (0, time), np.zeros(3), "LSODA", t, rtol=rtol, atol=1e-12, max_step=time / 200).y
    return t, y, np.array([model.evaluate(z, v)[0] for v, z in zip(y[1], y[2:].T, strict=True)])


def test_steady_sliding_is_the_stribeck_curve():
    for speed in (1e-4, 1e-3, 5e-3, 0.1):
        z = [(1 + 0.5 * np.exp(-((speed / 1e-3) ** 2))) / 1e5]
        friction, rate = PUBLISHED.evaluate(z, speed)
        assert rate[0] == pytest.approx(0, abs=1e-12)
        assert friction == pytest.approx(1 + 0.5 * np.exp(-((speed / 1e-3) ** 2)) + 0.4 * speed, rel=1e-9)


def test_presliding_is_a_spring_with_hysteresis():
    """Below break-away, 1.425 N: micrometres, and a remanent displacement when the force has gone."""
    peak = 1.425

    def force(t, x):
        return np.interp(t, [0, 10, 20, 30, 40], [0, peak, 0, -peak, 0])

    t, y, _ = pull(force, 40.0)
    assert np.abs(y[0]).max() < 100e-6
    top, remanent = np.interp([10, 20], t, y[0])
    assert top > peak / 1e5  # softer than the bristles alone
    assert 0.2 * top < remanent < top
    initial = np.interp(0.5, t, y[0]) / (peak * 0.05)
    assert initial == pytest.approx(1e-5, rel=0.05)  # stiffness sigma0


def test_a_mass_pulled_by_a_spring_sticks_and_slips():
    """1 kg, 2 N/m, its end pulled at 0.1 m/s: the spring builds up to Fs before every slip."""
    stiffness, speed = 2.0, 0.1
    t, y, friction = pull(lambda t, x: stiffness * (speed * t - x), 20.0, 8000)
    at_rest = np.abs(y[1]) < 1e-3
    assert 0.2 < at_rest[t > 5].mean() < 0.8
    slips = np.flatnonzero(np.diff(at_rest.astype(int)) == -1)
    assert len(slips) >= 2
    assert friction.max() == pytest.approx(1.5, abs=0.05)
    assert y[1].max() > 2 * speed
    first = np.interp(t[slips[0]], t, stiffness * (speed * t - y[0]))
    assert first == pytest.approx(1.5, abs=0.06)


def test_the_break_away_force_falls_as_the_force_rises_faster():
    """From near Fs at a slow rate towards Fc at 50 N/s, as the paper's figure shows."""
    forces = []
    for rate in (1.0, 5.0, 20.0, 50.0):
        _, y, friction = pull(lambda t, x, rate=rate: rate * t, 2.5 / rate, 4000)
        forces.append(friction[y[1] < 0.05].max())
    assert np.all(np.diff(forces) < 0)
    assert 1.35 < forces[0] < 1.5
    assert 1.0 < forces[-1] < 1.35


def test_friction_lags_behind_velocity():
    """Friction is larger while a velocity of one sign rises than while it falls; the more, the faster."""
    widths = []
    for omega in (1.0, 10.0, 25.0):

        def velocity(t, omega=omega):
            return 1.5e-3 * (1 - 0.9 * np.cos(omega * t))

        def rate(t, z, velocity=velocity):
            return PUBLISHED.evaluate(z, velocity(t))[1]

        t = np.linspace(0, 4 * np.pi / omega, 4001)
        z = solve_ivp(rate, (0, t[-1]), [0.0], "LSODA", t, rtol=1e-9, atol=1e-13).y[0]
        friction = np.array([PUBLISHED.evaluate([a], velocity(b))[0] for a, b in zip(z, t, strict=True)])
        rising, falling = (np.interp((share + 1) * 2 * np.pi / omega, t, friction) for share in (0.25, 0.75))
        widths.append(rising - falling)
    assert widths[0] > 0
    assert np.all(np.diff(widths) > 0)


def test_dahl_with_exponent_one_is_lugre_without_damping_and_stribeck_effect():
    dahl, lugre = Dahl(0.7, 1e6), LuGre(0.7, 0.7, 1e-3, 1e6)
    for z in np.linspace(-7e-7, 7e-7, 9):
        for w in (-2e-3, 0.0, 1e-4):
            expected, rates = lugre.evaluate([z], w)
            friction, rate = dahl.evaluate([z], w)
            assert friction == pytest.approx(expected, rel=1e-12, abs=1e-18)
            assert rate == pytest.approx(rates, rel=1e-12, abs=1e-18)


def test_elastoplastic_is_elastic_below_break_away_and_lugre_in_steady_sliding():
    model = Elastoplastic(1.0, 1.2, 1e-3, 1e6, 0.0, 0.0, 0.4e-6)
    assert model.evaluate([0.39e-6], 1e-4)[1][0] == 1e-4
    assert model.evaluate([-0.9e-6], 1e-4)[1][0] == 1e-4  # a deflection that is relieved
    partly = model.evaluate([0.8e-6], 1e-4)[1][0]
    assert 0 < partly < 1e-4
    steady = (1 + 0.2 * np.exp(-0.01)) / 1e6
    assert model.evaluate([steady], 1e-4)[1][0] == pytest.approx(0, abs=1e-16)


def test_maxwell_slip_follows_masing_and_saturates():
    """Reversed from a maximum, the curve is the first one at twice the size: what Maxwell elements are."""
    model = spread_maxwell_slip(1.0, 1e6, 12)
    assert model.limit == pytest.approx(1.0)

    def curve(deflections, z):
        forces = []
        for move in np.diff(deflections, prepend=deflections[0]):
            z += move
            limit = np.array(model.limits) / np.array(model.stiffnesses)
            z = np.clip(z, -limit, limit)
            forces.append(model.evaluate(z, 0.0)[0])
        return np.array(forces), z

    first, z = curve(np.linspace(0, 1.2e-6, 400), np.zeros(12))
    back, _ = curve(np.linspace(1.2e-6, -1.2e-6, 400), z)
    np.testing.assert_allclose(first[-1] - back, 2 * first, atol=0.01)
    clipped = np.array(model.limits) / np.array(model.stiffnesses)
    force, rates = model.evaluate(clipped * 1.0000001, 1e-3)
    assert force == pytest.approx(1.0, rel=1e-6)
    assert not rates.any()
    assert np.all(model.evaluate(clipped * 1.0000001, -1e-3)[1] == -1e-3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Elastoplastic(1.0, 1.0, 1e-3, 1e6, breakaway_deflection=1.01e-6), "the steady deflection"),
        (lambda: Elastoplastic(1.0, 1.0, 1e-3, 1e6), "above 0"),
        (lambda: LuGre(1.0, 0.9, 1e-3, 1e6), "no smaller"),
        (lambda: LuGre(0.0, 0.9, 1e-3, 1e6), "kinetic must be above 0"),
        (lambda: LuGre(1.0, 1.0, 1e-3, float("nan")), "stiffness must be above 0"),
        (lambda: LuGre(1.0, 1.0, 1e-3, 1e6, -1.0), "damping"),
        (lambda: Dahl(1.0, 1e6, 0.1), "exponent"),
        (lambda: MaxwellSlip((1e6,), (1.0, 2.0)), "elements"),
        (lambda: MaxwellSlip((1e6,), (-1.0,)), "above 0"),
        (lambda: spread_maxwell_slip(1.0, 1e6, 0), "elements"),
    ],
)
def test_a_model_outside_its_domain_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
