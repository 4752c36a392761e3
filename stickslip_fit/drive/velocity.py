"""Joint velocities for a velocity of the tip: the inverse of the Jacobian, damped near its singular places.

In cylinder coordinates about joint 1's axis the Jacobian falls apart. Joint 1 moves the tip sideways, by its
distance r = a1 - L sin q2 from the axis, with L = l2 + q3; joint 2 moves it by L and joint 3 by 1 in two
perpendicular directions of the arm's plane. So r, L and 1 are its singular values, and with L > 0 only r can
vanish: at sin q2 = a1 / L the tip is on the axis, where joint 1 cannot move it. There damped least squares
replaces 1 / r by r / (r^2 + lambda^2), with lambda growing as r falls below a bound (Y. Nakamura and H.
Hanafusa, J. Dyn. Syst. Meas. Control 108:163, 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

from stickslip_fit.machine import Machine

Triple = tuple[float, float, float]
DAMPED_WITHIN = 5e-3  # m from joint 1's axis: there 60 µm/s take joint 1 as many steps as it can make
DAMPING = 2.5e-3  # m, on the axis


def damping_of(distance: float) -> float:
    """lambda^2, m^2, at a signed distance of the tip from joint 1's axis, m."""
    share = 1.0 - (distance / DAMPED_WITHIN) ** 2
    return DAMPING**2 * share if share > 0 else 0.0


def axis_distance(machine: Machine, q: Sequence[float]) -> float:
    """Signed distance of the tip from joint 1's axis, m; negative where the arm is bent back over it."""
    return machine.a1 - (machine.l2 + q[2]) * sin(q[1])


def joint_velocity(machine: Machine, q: Sequence[float], velocity: Sequence[float]) -> Triple:
    """Velocities of the joints (rad/s, rad/s, m/s) that move the tip by `velocity`, base frame, m/s.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> sideways = joint_velocity(load_machine(), (0.0, -1.5707963, 0.0), (0.0, 50e-6, 0.0))
    >>> [round(1e6 * one) for one in sideways]
    [1000, 0, 0]
    """
    s1, c1, s2, c2 = sin(q[0]), cos(q[0]), sin(q[1]), cos(q[1])
    x, y, z = velocity
    length, distance = machine.l2 + q[2], axis_distance(machine, q)
    outward, sideways = x * c1 + y * s1, y * c1 - x * s1
    return (
        sideways * distance / (distance**2 + damping_of(distance)),
        (-outward * c2 - z * s2) / length,
        z * c2 - outward * s2,
    )


def tip_velocity(machine: Machine, q: Sequence[float], rates: Sequence[float]) -> Triple:
    """The tip's velocity, base frame, m/s, that joint velocities (rad/s, rad/s, m/s) give it."""
    s1, c1, s2, c2 = sin(q[0]), cos(q[0]), sin(q[1]), cos(q[1])
    length = machine.l2 + q[2]
    sideways = rates[0] * axis_distance(machine, q)
    outward = -length * c2 * rates[1] - s2 * rates[2]
    return c1 * outward - s1 * sideways, s1 * outward + c1 * sideways, -length * s2 * rates[1] + c2 * rates[2]
