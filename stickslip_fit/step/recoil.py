"""What a recoiling base costs of the step, in closed form.

The base (mass M) carries the foot (mass m_f, which follows its waveform) and stands on a spring. Friction on
the slider (mass m) acts on the base with the opposite sign, and so does the foot's own momentum. With

    mu = m / (M + m_f),   phi = m_f / (M + m_f),   theta = omega T1,   omega^2 = spring / (M + m_f),

the sliding velocity is that on a fixed base less the base's velocity db/dt. Between events b is harmonic:
friction pushes the base by F, 0 or -F, each jump of the foot's speed by U = D / T1 kicks it, and the flyback
shifts it by phi D. At both ends of a slip the sliding velocity is 0. So, to first order in mu and phi, the
times of the events do not matter, and the slider's way along the base is shorter by

- friction-limited, lambda > 1: b(2 T1);
- catching up at t_c = lambda T1: b(t_c) + b(T1 + t_c) - b(T1) - t_c db/dt(T1).

Without mount no approximation is needed. Relative to the centre of base and foot, the slider obeys the
equation of a fixed base with a_f (1 + mu) in place of a_f and (1 - phi) D in place of D, for any waveform.
The step is (1 + mu) a_f T1^2, longer, if friction limits it, and (1 - phi) D if the slider catches up.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array

SLOW = 1e-4  # of theta; below it, the base is free


def recoil_share(
    friction_acceleration: npt.ArrayLike,
    ramp_time: npt.ArrayLike,
    amplitude: npt.ArrayLike,
    mass: npt.ArrayLike,
    foot_mass: npt.ArrayLike,
    base_mass: npt.ArrayLike,
    resonance: npt.ArrayLike = 0.0,
) -> Array:
    r"""Compute the share of the step that is lost to the recoil of the base, b in step = (1 - b) step_fixed.

    For a ramp with instant flyback, from rest, without load and damping, to first order in the base's motion.
    With lambda, theta, mu and phi as above and c = lambda theta it is

    .. math::

        b = \mu \frac{-2 \cos\theta (1 - \cos\theta)}{\theta^2}
            + \phi \lambda \left[\cos\theta + \frac{\sin\theta}{\theta} (1 - 2 \cos\theta)\right]

    if friction limits the step (lambda > 1), and if the slider catches up

    .. math::

        b = \mu \frac{c [\sin\theta - \sin(\theta - c)] - 2 \cos\theta (1 - \cos c)}{\lambda \theta^2}
            + \phi \left[\cos c + \frac{\sin\theta + c \cos\theta - \sin(\theta + c)}{\theta}\right] .

    Parameters
    ----------
    friction_acceleration, ramp_time, amplitude : array_like
        a_f, m/s^2, T1, s, and D, m, as in `step_size`.
    mass, foot_mass, base_mass : array_like
        m, m_f and M, kg; a foot without mass has 0.
    resonance : array_like
        Of the base alone on its mount, Hz; 0 for a base that nothing holds.

    Returns
    -------
    ndarray
        b, of the arguments' broadcast shape; negative where recoil makes the step longer; nan outside the
        domain. It is a good approximation while mu and phi lambda (1 + theta^2), the acceleration of the base
        over that by friction, are well below 1.

    Examples
    --------
    A slider of 5 g on a free base of 40 g gains an eighth where friction limits the step. With a foot of 1 g
    it loses a fortieth of the travel where it catches up:

    >>> recoil_share(50.0, 1.4e-4, [2.4e-6, 0.4e-6], 5e-3, [0.0, 1e-3], [40e-3, 39e-3]).round(6)
    array([-0.125,  0.025])
    """
    a_f, t_1, d, m, m_f, m_b, f = (
        np.asarray(x, dtype=float)
        for x in (friction_acceleration, ramp_time, amplitude, mass, foot_mass, base_mass, resonance)
    )
    usable = (a_f > 0) & (t_1 > 0) & (d > 0) & (m > 0) & (m_f >= 0) & (m_b > 0) & (f >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        whole, ratio = m_b + m_f, d / (a_f * t_1**2)
        theta = np.maximum(2 * np.pi * f * np.sqrt(m_b / whole) * t_1, SLOW)
        c = theta * np.minimum(ratio, 1.0)
        friction = -4 * np.cos(theta) * np.sin(c / 2) ** 2
        caught = 2 * c * np.cos(theta - c / 2) * np.sin(c / 2)
        by_friction = np.where(ratio > 1, friction, (friction + caught) / ratio) / theta**2
        limited = ratio * (np.cos(theta) + np.sin(theta) * (1 - 2 * np.cos(theta)) / theta)
        reached = np.cos(c) + (np.sin(theta) + c * np.cos(theta) - np.sin(theta + c)) / theta
        share = (m * by_friction + m_f * np.where(ratio > 1, limited, reached)) / whole
    return np.where(usable, share, np.nan)
