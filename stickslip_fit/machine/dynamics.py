"""Inertia, Coriolis and gravity terms of D(q) qdd + C(q, qd) qd + G(q) = tau (thesis A.64 to A.114).

Joints 1, 2 and 3 move the arm in mutually perpendicular directions, so D is diagonal. Link conventions
are those of mm3a.toml.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.machine.kinematics import full_load
from stickslip_fit.machine.machine import Machine
from stickslip_fit.units import JOINTS

STANDARD_GRAVITY = 9.80665


def inertia_matrix(machine: Machine, q: npt.ArrayLike) -> Array:
    """The inertia matrix D at joint positions `q` (rad, rad, m), shape (..., 3) -> (..., 3, 3).

    kg m^2 for the rotary joints, kg for the prismatic one.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> float(inertia_matrix(load_machine(), [0.0, 0.0, 0.0])[2, 2])
    0.005
    """
    machine.require_geometry("the arm's inertia")
    _, q2, q3 = np.moveaxis(np.asarray(q, float), -1, 0)
    upper, fore, hand = machine.links
    sine, cosine, out = np.sin(q2), np.cos(q2), _hand_distance(machine, q3)
    inertia = np.zeros((*q2.shape, 3, 3))
    inertia[..., 0, 0] = (
        upper.mass * (machine.a1 - upper.com) ** 2
        + upper.inertia[1]
        + fore.mass * (machine.a1 - fore.com * sine) ** 2
        + hand.mass * (machine.a1 - out * sine) ** 2
        + (fore.inertia[0] + hand.inertia[0]) * sine**2
        + (fore.inertia[2] + hand.inertia[2]) * cosine**2
    )
    inertia[..., 1, 1] = fore.mass * fore.com**2 + fore.inertia[1] + hand.mass * out**2 + hand.inertia[1]
    inertia[..., 2, 2] = hand.mass
    return inertia


def coriolis_matrix(machine: Machine, q: npt.ArrayLike, qdot: npt.ArrayLike) -> Array:
    """The matrix C of Coriolis and centrifugal terms, from the Christoffel symbols of D (thesis A.108).

    C[k, j] = sum over i of c_ijk qd_i with c_ijk = (dD_kj/dq_i + dD_ki/dq_j - dD_ij/dq_k) / 2. The
    thesis prints c_322 (A.95), and with it C[3, 2], with the wrong sign: C[3, 2] is
    -m3 (l2 + q3 - r3) qd2, the centrifugal force that throws the hand outward.

    Parameters
    ----------
    machine : Machine
    q, qdot : array_like, shape (..., 3)
        Joint positions (rad, rad, m) and their rates (rad/s, rad/s, m/s); they broadcast.

    Returns
    -------
    array, shape (..., 3, 3)
        dD/dt - 2 C is skew-symmetric.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> float(coriolis_matrix(load_machine(), [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])[2, 1])
    -0.0001125
    """
    machine.require_geometry("Coriolis terms")
    q, qdot = np.broadcast_arrays(np.asarray(q, float), np.asarray(qdot, float))
    _, q2, q3 = np.moveaxis(q, -1, 0)
    rate1, rate2, rate3 = np.moveaxis(qdot, -1, 0)
    base_by_q2, base_by_q3, elbow_by_q3 = _half_inertia_derivatives(machine, q2, q3)
    coriolis = np.zeros((*q2.shape, 3, 3))
    coriolis[..., 0, 0] = base_by_q2 * rate2 + base_by_q3 * rate3
    coriolis[..., 0, 1] = base_by_q2 * rate1
    coriolis[..., 0, 2] = base_by_q3 * rate1
    coriolis[..., 1, 0] = -base_by_q2 * rate1
    coriolis[..., 1, 1] = elbow_by_q3 * rate3
    coriolis[..., 1, 2] = elbow_by_q3 * rate2
    coriolis[..., 2, 0] = -base_by_q3 * rate1
    coriolis[..., 2, 1] = -elbow_by_q3 * rate2
    return coriolis


def gravity_scale(machine: Machine, q: npt.ArrayLike, g: float = STANDARD_GRAVITY) -> Array:
    """The gravity force on each joint per unit of its load u, N m, N m and N.

    It is the force that the joint would feel with the base turned so that u = 1. For joint 1 it is
    below zero where the arm is bent so far back that its weight lies beyond joint 1's axis.

    Parameters
    ----------
    machine : Machine
    q : array_like, shape (..., 3)
        Joint positions, rad, rad, m.
    g : float, optional
        m/s^2.

    Returns
    -------
    array, shape (..., 3)

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> float(gravity_scale(load_machine(), [0.0, 0.0, 0.0], g=10.0)[2])
    0.05
    """
    machine.require_geometry("the gravity load")
    _, q2, q3 = np.moveaxis(np.asarray(q, float), -1, 0)
    upper, fore, hand = machine.links
    elbow = fore.mass * fore.com + hand.mass * _hand_distance(machine, q3)
    base = upper.mass * (machine.a1 - upper.com) + (fore.mass + hand.mass) * machine.a1 - elbow * np.sin(q2)
    return g * np.stack([base, elbow, np.full_like(elbow, hand.mass)], axis=-1)


def gravity_forces(
    machine: Machine, q: npt.ArrayLike, theta: npt.ArrayLike, psi: npt.ArrayLike, g: float = STANDARD_GRAVITY
) -> Array:
    """The joint forces that balance gravity, G = dV/dq: `gravity_scale` times `full_load`.

    Parameters
    ----------
    machine : Machine
    q : array_like, shape (..., 3)
        Joint positions, rad, rad, m.
    theta, psi : array_like, shape (...)
        Orientation of the base, R = Rx(theta) Ry(psi), rad.
    g : float, optional
        m/s^2.

    Returns
    -------
    array, shape (..., 3)
        N m, N m, N; above 0 where moving in `+` lifts the arm (thesis A.111 to A.113).

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> float(gravity_forces(load_machine(), [0.0, 0.0, 0.0], theta=0.0, psi=0.0, g=10.0)[2])
    0.05
    """
    machine.require_geometry("the gravity load")
    q1, q2, _ = np.moveaxis(np.asarray(q, float), -1, 0)
    loads = np.broadcast_arrays(*(full_load(joint, q1, q2, theta, psi) for joint in JOINTS))
    return gravity_scale(machine, q, g) * np.stack(loads, axis=-1)


def _half_inertia_derivatives(machine: Machine, q2: Array, q3: Array) -> tuple[Array, Array, Array]:
    """Half of dD11/dq2, dD11/dq3 and dD22/dq3; the other derivatives of D are 0."""
    _, fore, hand = machine.links
    sine, cosine, out = np.sin(q2), np.cos(q2), _hand_distance(machine, q3)
    base_by_q2 = cosine * (
        -fore.mass * fore.com * (machine.a1 - fore.com * sine)
        - hand.mass * out * (machine.a1 - out * sine)
        + (fore.inertia[0] + hand.inertia[0] - fore.inertia[2] - hand.inertia[2]) * sine
    )
    base_by_q3 = -hand.mass * sine * (machine.a1 - out * sine)
    return base_by_q2, base_by_q3, hand.mass * out


def _hand_distance(machine: Machine, q3: Array) -> Array:
    """Link 3's centre of mass from joint 2's axis, l2 + q3 - r3."""
    return machine.l2 + q3 - machine.links[2].com
