"""How the thesis gets d from a change of joint 2's mean step: Eq. 6.6 and the algorithm before it."""

from math import pi, sin

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from stickslip_fit.estimation import (
    iterate_load_coefficient,
    load_coefficient_from_quadratic,
    solve_load_coefficient,
)
from stickslip_fit.machine import published_load
from tests.thesis.published import value

FIRST, LAST = np.radians(value("range_q2"))
TURN = FIRST - LAST
LIMIT = value("mean_step_change_limit") * 1e-6
CHANGES = np.array([LIMIT, -LIMIT])
GAMMA0 = value("gamma0") * 1e-6
SPAN = value("gamma0_span") * 1e-6


def mean_step(gamma0, d, first=FIRST, last=LAST):
    steps, _ = quad(lambda q: 1.0 / (gamma0 + d * np.sin(-q)), last, first, epsabs=0, epsrel=1e-13)
    return (first - last) / steps


def exact_d(gamma0, delta):
    return brentq(lambda d: mean_step(gamma0, d) - gamma0 - delta, -0.9 * gamma0, 0.9 * gamma0, xtol=1e-18)


def quadratic(delta, unit):
    square, slope, offset = value("d_quadratic_coefficients")
    x = delta / unit
    return square * x**2 + slope * x + offset


def listing(gamma0, delta, d, passes, counted_more=0):
    """The printed algorithm, line by line: the error of each pass, and d after it.

    The mean is taken over the steps made; with `counted_more` = 1 over j as the listing leaves it, one more.
    """
    errors, path = [], []
    for _ in range(passes):
        zeta, total, j = -pi / 6, 0.0, 0
        while zeta <= 7 * pi / 6:
            step = gamma0 + d * sin(zeta)
            total, zeta, j = total + step, zeta + step, j + 1
        simulated = total / (j + counted_more)
        sine = (simulated - gamma0) / d  # the listing goes through arcsin and back
        d = delta / sine
        errors.append(gamma0 + delta - simulated)
        path.append(d)
    return np.abs(errors), np.array(path)


def test_eq_6_6_is_right_with_x_in_hundredths_of_a_radian():
    assert value("gamma0") == value("gamma0_span").mean()
    assert load_coefficient_from_quadratic(CHANGES) == pytest.approx(quadratic(CHANGES, 0.01))
    assert quadratic(CHANGES, 0.01) * 1e6 == pytest.approx(value("d_from_quadratic"), abs=0.05)


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_eq_6_6_is_nonsense_with_x_in_radians_or_microradians(unit):
    """In rad the printed d of 19 µrad is out of reach, in µrad it is many turns."""
    d = quadratic(LIMIT, unit)
    assert not 0.1 * GAMMA0 < d < GAMMA0


def test_eq_6_6_gives_a_load_where_there_is_none():
    assert quadratic(0.0, 0.01) * 1e6 == pytest.approx(value("quadratic_at_no_change"), abs=0.0005)
    assert exact_d(GAMMA0, 0.0) == pytest.approx(0.0, abs=1e-15)


def test_exact_solving_at_the_printed_changes():
    both = np.ones(2)
    counts, phase = TURN / (GAMMA0 + CHANGES), -np.pi / 2 * both
    ours = solve_load_coefficient(counts, GAMMA0 * both, both, phase, FIRST * both, LAST * both)
    assert ours * 1e6 == pytest.approx(value("d_exact"), abs=0.005)
    assert ours == pytest.approx([exact_d(GAMMA0, delta) for delta in CHANGES], rel=1e-12)


def test_first_order_factor_between_d_and_the_mean_step():
    tiny = 1e-9
    factor = tiny / (mean_step(GAMMA0, tiny) - GAMMA0)
    assert factor == pytest.approx(4 * np.pi / (3 * np.sqrt(3)), rel=1e-4)
    assert factor == pytest.approx(value("d_over_change_first_order"), abs=5e-4)


def test_one_quadratic_for_every_gamma0_is_off_by_more_than_a_microradian():
    errors = {
        (gamma0, delta): abs(quadratic(delta, 0.01) - exact_d(gamma0, delta))
        for gamma0 in np.linspace(*SPAN, 5)
        for delta in np.linspace(-LIMIT, LIMIT, 5)
    }
    worst = max(errors, key=errors.get)
    assert worst == pytest.approx((SPAN[1], LIMIT))
    assert errors[worst] * 1e6 == pytest.approx(value("quadratic_worst_error"), abs=0.05)


def test_d_depends_on_the_mean_step_by_more_than_the_thesis_says():
    spreads = [1e6 * np.ptp([exact_d(gamma0, delta) for gamma0 in SPAN]) for delta in CHANGES]
    assert spreads == pytest.approx(value("spread_of_d"), abs=0.05)
    assert spreads[0] > 2 * value("claimed_spread_of_d") > 2 * spreads[1]


def test_the_printed_d_come_from_changes_within_the_printed_limit():
    """Eq. 6.6 turned round; with x in rad, no change smaller than the step itself gives any of them."""
    square, slope, offset = value("d_quadratic_coefficients")

    def change(d, unit):
        return unit * (-slope + np.sqrt(slope**2 - 4 * square * (offset - 1e-6 * d))) / (2 * square)

    for d, by_quadratic, by_integral in (
        (value("d_inside"), value("change_inside"), value("change_inside_exact")),
        (value("d_outside"), value("change_outside"), value("change_outside_exact")),
    ):
        assert 1e6 * change(d, 0.01) == pytest.approx(by_quadratic, abs=0.005)
        assert [1e6 * (mean_step(GAMMA0, 1e-6 * each) - GAMMA0) for each in d] == pytest.approx(
            by_integral, abs=0.005
        )
        assert np.all(np.abs([by_quadratic, by_integral]) <= value("mean_step_change_limit"))
        assert np.all(np.abs(change(d, 1.0)) > GAMMA0)


def test_the_text_runs_zeta_over_the_range_of_q2():
    """The listing's zeta is joint 2's at psi = 0; the text's has the same mean load with the other sign."""
    listed = np.mean(
        np.sin(
            np.linspace(
                *np.radians([value("iteration_starts_zeta_at"), value("iteration_ends_zeta_at")]), 100_001
            )
        )
    )
    by_text = np.mean(np.sin(np.linspace(*np.radians(value("zeta_in_the_text")), 100_001)))
    by_range = np.mean(published_load(2, 0.0, np.linspace(FIRST, LAST, 100_001), 0.0, 0.0))
    assert listed == pytest.approx(by_range, rel=1e-9)
    assert by_text == pytest.approx(-by_range, rel=1e-9)


def test_the_iteration_converges_only_linearly():
    gamma0 = np.full(2, GAMMA0)
    exact = np.array([exact_d(GAMMA0, step) for step in CHANGES])
    path = iterate_load_coefficient(
        TURN / (gamma0 + CHANGES), gamma0, np.full(2, FIRST), np.full(2, LAST), iterations=5
    )
    error = np.abs(path - exact)
    rates = error[1:] / error[:-1]
    assert [rates.min(), rates.max()] == pytest.approx(value("iteration_rate"), abs=0.005)


@pytest.mark.parametrize("counted_more", [0, 1])
def test_the_listing_ends_short_of_the_printed_error(counted_more):
    """At the largest change it is off by 30 times as much, wherever it starts; a small one is right."""
    passes = value("iterations")
    factor = value("d_over_change_first_order")
    last = [listing(GAMMA0, delta, factor * delta, passes, counted_more)[0][-1] for delta in CHANGES]
    assert last == pytest.approx([value("iteration_error_after_five_passes")] * 2, rel=0.25)
    for first in (LIMIT, 2e-5):
        assert listing(GAMMA0, LIMIT, first, passes)[0][-1] > 30 * value("iteration_error")
    assert listing(GAMMA0, 1e-6, factor * 1e-6, passes)[0][-1] < value("iteration_error")


def test_the_listing_never_ends_where_a_step_more_or_less_decides():
    """Whole steps: at 115 µrad the error stays above 1e-11 rad for good."""
    errors, path = listing(SPAN[1], LIMIT, LIMIT, 12)
    assert errors[5:].min() > value("iteration_error")
    assert abs(path[-1] - exact_d(SPAN[1], LIMIT)) < 1e-8  # a hundredth of a microradian: no harm


def test_the_walk_of_the_listing_is_the_integral():
    """Its five passes and the integral agree to the whole steps of the walk."""
    for delta in CHANGES:
        _, path = listing(GAMMA0, delta, value("d_over_change_first_order") * delta, 9)
        assert path[-1] == pytest.approx(exact_d(GAMMA0, delta), abs=5e-9)


def test_two_directions_give_two_lengths_to_one_arm():
    """If d were the torque of the arm's weight times one number, it would vanish at one q3."""
    inside, outside = value("d_inside"), value("d_outside")
    assert outside / inside == pytest.approx(value("d_ratio"), abs=0.005)
    zero = -inside * value("interpolation_length") / (outside - inside)
    assert zero == pytest.approx(value("weightless_q3"), abs=0.05)


def test_solving_is_exact_across_the_branch_of_the_half_angle():
    """tan(zeta / 2) jumps at 180 degrees, which joint 2's traverse crosses."""
    first, last = np.radians(-170.0), np.radians(-195.0)
    steps, _ = quad(lambda q: 1.0 / (95e-6 + 20e-6 * np.sin(-q)), last, first, epsabs=0, epsrel=1e-13)
    found = solve_load_coefficient(
        np.array([steps]),
        np.array([95e-6]),
        np.ones(1),
        np.array([-np.pi / 2]),
        np.array([first]),
        np.array([last]),
    )
    assert found[0] == pytest.approx(20e-6, rel=1e-11)
