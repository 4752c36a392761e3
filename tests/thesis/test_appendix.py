"""The appendix, Eqs. 5.3 to 6.10 and joint 1 by interchange, beside the machine's own mechanics."""

import numpy as np
import pytest

from stickslip_fit.machine import (
    coriolis_matrix,
    forward,
    full_load,
    gravity_forces,
    inertia_matrix,
    load_machine,
    mean_load,
    published_load,
)
from tests.thesis.published import value

ARM = load_machine()
QUARTER = np.pi / 2
Q2 = np.radians(np.linspace(*value("range_q2"), 121))


def test_gravity_does_not_act_where_eq_6_9_puts_d():
    assert np.max(np.abs(published_load(2, 0.0, Q2, -QUARTER, 0.3))) < 1e-15


def test_eqs_5_3_and_6_5_hold_at_theta_zero_only():
    """They lack the cos(theta) of Eqs. 5.4 and 6.10, and would load the joint on its side."""
    by_5_3 = np.sin(0.0 - Q2)
    assert by_5_3 == pytest.approx(published_load(2, 0.0, Q2, 0.0, 0.0))
    for theta in (value("verified_theta_rotary"), -90.0):
        theta = np.radians(theta)
        assert by_5_3 * np.cos(theta) == pytest.approx(full_load(2, 0.0, Q2, theta, 0.0), abs=1e-15)
    assert np.abs(by_5_3).max() == pytest.approx(1.0)


def test_the_published_load_holds_at_q1_zero_only():
    q2, theta, psi = np.radians([-60.0, -40.0, 25.0])
    for joint in (2, 3):
        assert full_load(joint, 0.0, q2, theta, psi) == pytest.approx(
            published_load(joint, 1.0, q2, theta, psi)
        )
        assert abs(full_load(joint, 1.0, q2, theta, psi) - published_load(joint, 1.0, q2, theta, psi)) > 0.1


def test_interchange_is_not_enough_for_joint_1():
    """At theta = -90° joint 1's load is cos q1, not sin(zeta), and its torque depends on q2, too."""
    q1 = np.radians(np.linspace(-120.0, 120.0, 25))
    assert full_load(1, q1, -QUARTER, 0.0, 0.0) == pytest.approx(0.0, abs=1e-15)
    loaded = full_load(1, q1, -QUARTER, -QUARTER, 0.0)
    assert np.abs(loaded) == pytest.approx(np.abs(np.cos(q1)))

    def torque(q2, q3):
        return abs(gravity_forces(ARM, np.array([0.0, q2, q3]), -QUARTER, 0.0)[0])

    by_q3 = torque(-QUARTER, 0.012) / torque(-QUARTER, 0.0)
    by_q2 = torque(-QUARTER, 0.0) / torque(0.0, 0.0)
    assert by_q2 > by_q3 > 1.0


def test_eq_6_6_serves_joint_1_only_over_a_range_about_its_greatest_load():
    """The same mean load as joint 2's if the 240 degrees lie evenly about its greatest load."""
    of_joint_2 = mean_load(2, *np.radians(value("range_q2")), 0.0, np.nan, 0.0, 0.0)
    evenly = mean_load(1, *np.radians([-120.0, 120.0]), np.nan, -QUARTER, -QUARTER, 0.0)
    as_joint_2 = mean_load(1, *np.radians(value("range_q2")), np.nan, -QUARTER, -QUARTER, 0.0)
    assert abs(evenly) == pytest.approx(abs(of_joint_2))
    assert abs(as_joint_2) < 0.6 * abs(of_joint_2)


def test_eq_a_58_is_not_the_derivative_of_a_57():
    """A.57 is M11 times q1's rate (M12 is 0); its derivative has M11's own rate, which A.58 leaves out."""
    q, rate, acceleration = (
        np.array([0.3, -1.1, 0.006]),
        np.array([2.0, -1.5, 0.1]),
        np.array([3.0, 2.0, 0.4]),
    )
    step = 1e-6

    def momentum(t):
        return inertia_matrix(ARM, q + rate * t + acceleration * t**2 / 2) @ (rate + acceleration * t)

    derivative = (momentum(step) - momentum(-step)) / (2 * step)
    as_printed = inertia_matrix(ARM, q) @ acceleration
    assert derivative[2] == pytest.approx(as_printed[2], rel=1e-6)  # A.62
    for joint in (0, 1):  # A.58, A.60
        assert abs(as_printed[joint] / derivative[joint] - 1) > 0.05


def test_r_in_a_54_is_r3():
    """With R = 0 the kinetic energy of A.54 would not be that of the inertia matrix's m3 (l2 + q3 - r3)²."""
    q = np.array([0.0, -0.7, 0.005])
    further = np.array([0.0, 0.0, 0.002])
    mass, r3 = ARM.links[2].mass, ARM.links[2].com
    change = (inertia_matrix(ARM, q + further) - inertia_matrix(ARM, q))[1, 1]

    def by_a_54(r):
        return mass * ((ARM.l2 + q[2] + further[2] - r) ** 2 - (ARM.l2 + q[2] - r) ** 2)

    assert change == pytest.approx(by_a_54(r3), rel=1e-9)
    assert abs(by_a_54(0.0) / change - 1) > 0.3


def test_c322_has_the_other_sign():
    """A.95 and A.108 print +m3 (l2 + q3 - r3); Eq. A.20 gives -1/2 of M22's slope in q3."""
    q = np.array([0.2, -0.8, 0.004])
    rate = np.array([0.0, 1.0, 0.0])
    printed = ARM.links[2].mass * (ARM.l2 + q[2] - ARM.links[2].com)
    assert coriolis_matrix(ARM, q, rate)[2, 1] == pytest.approx(-printed)


def test_a_17_takes_the_moment_about_the_joint_s_own_axis():
    """It prints the origin O_i for joint i; Eqs. A.46 and A.48 have, rightly, O_(j-1) for joint j."""
    q, step = np.array([0.4, -0.9, 0.006]), 1e-6
    ahead, behind = (forward(ARM, q + side * step * np.eye(3)[0]) for side in (1, -1))
    column = (ahead - behind) / (2 * step)
    axis, tip = np.array([0.0, 0.0, 1.0]), forward(ARM, q)
    own, other = (
        np.cross(axis, tip),
        np.cross(axis, tip - ARM.a1 * np.array([np.cos(q[0]), np.sin(q[0]), 0.0])),
    )
    assert own == pytest.approx(column, abs=1e-8)
    assert np.abs(other - column).max() > 0.1 * np.abs(column).max()
