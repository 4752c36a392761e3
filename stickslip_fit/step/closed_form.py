"""The step of a slider with Coulomb friction on a foot that moves by a ramp and a flyback, in closed form.

A slider of mass m rests on a foot, held by friction of at most F. The foot moves forward by D at the constant
speed U = D / T1, then back by D within the flyback time t_f, then rests until the slider does. With the
friction acceleration a_f = F / m and a load that decelerates the slider by G (for gravity along the motion
G = g u, positive against it), the slider accelerates by B = a_f - G while the foot is faster, and decelerates
by A = a_f + G while it is slower. Two numbers decide what happens, r = G / a_f and

    lambda = D / (a_f T1^2),    the foot's mean acceleration over the friction acceleration.

- lambda < 1 - r: the slider reaches the foot's speed before the ramp ends, at the time U / B, having fallen
  behind by U^2 / (2 B); it coasts by U^2 / (2 A) after the flyback. Without flyback time,
  step = D - U^2 G / (A B) = D [1 - lambda r / (1 - r^2)].
- lambda > 1 - r, friction-limited: it never does. It is at B T1^2 / 2 when the ramp ends, and coasts by
  (B T1)^2 / (2 A): step = a_f T1^2 B / A = a_f T1^2 (1 - r) / (1 + r).

Both are D / (1 + r) where they meet; the slope against the load is not the same, hence a kink. With v the
slider's speed at the end of the ramp, min(U, B T1), a flyback of t_f > v / A drags it backwards: it loses
(A t_f - v)^2 a_f / (A B) while it does not reach the foot's speed W = D / t_f, and
W^2 a_f / (A B) + D - W (v + W) / A if it does.

The same for a rotary joint with angles in place of lengths. All functions take arrays that broadcast, and
return nan outside the domain |r| < 1, a_f, T1, D > 0, t_f >= 0: with |r| >= 1 friction cannot hold the load.
`stickslip_fit.step.coulomb` solves the same motion event by event, for any motion of the foot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array, BoolArray


class RelativeStep(NamedTuple):
    """Step size over a_f T1^2, and its derivatives, each an array."""

    step: Array
    by_ratio: Array
    by_share: Array


class _Motion(NamedTuple):
    """What all formulas are made of; broadcast arrays, nan outside the domain."""

    friction: Array  # a_f
    ramp_time: Array  # T1
    amplitude: Array  # D
    load: Array  # G
    flyback_time: Array  # t_f
    slowing: Array  # A
    gaining: Array  # B
    foot_speed: Array  # U
    ratio: Array  # lambda
    is_limited: BoolArray

    @property
    def speed(self) -> Array:
        """The slider's speed at the end of the ramp, v."""
        return np.where(self.is_limited, self.gaining * self.ramp_time, self.foot_speed)

    @property
    def excess(self) -> Array:
        """The slider's backward speed at the end of the flyback if it never reaches the foot's, A t_f - v."""
        return self.slowing * self.flyback_time - self.speed

    @property
    def return_speed(self) -> Array:
        """The foot's speed during the flyback, W; infinite where it takes no time."""
        with np.errstate(divide="ignore"):
            return self.amplitude / self.flyback_time


def drive_ratio(
    friction_acceleration: npt.ArrayLike, ramp_time: npt.ArrayLike, amplitude: npt.ArrayLike
) -> Array:
    """Compute lambda = D / (a_f T1^2): how fast the ramp is for the friction; parameters as for `step_size`.

    Examples
    --------
    >>> float(drive_ratio(50.0, 1e-4, 1e-6))
    2.0
    """
    return _motion(friction_acceleration, ramp_time, amplitude, 0.0, 0.0).ratio


def is_friction_limited(
    friction_acceleration: npt.ArrayLike,
    ramp_time: npt.ArrayLike,
    amplitude: npt.ArrayLike,
    load: npt.ArrayLike = 0.0,
) -> BoolArray:
    """Whether the slider is slower than the foot all through the ramp, lambda > 1 - r.

    False outside the domain. Parameters as for `step_size`.

    Examples
    --------
    >>> is_friction_limited(50.0, 1e-4, 0.4e-6, [0.0, 9.81, 19.62])
    array([False, False,  True])
    """
    return _motion(friction_acceleration, ramp_time, amplitude, load, 0.0).is_limited


def relative_step(ratio: npt.ArrayLike, share: npt.ArrayLike) -> RelativeStep:
    """Compute the step with instant flyback over a_f T1^2, from which all others follow.

    Parameters
    ----------
    ratio : array_like
        lambda.
    share : array_like
        r = G / a_f: load against the motion over friction.

    Returns
    -------
    RelativeStep
        The step and its derivatives by `ratio` and by `share`; nan unless |r| < 1. Where the regimes meet,
        the derivatives are those of the smaller lambda.

    Examples
    --------
    >>> [round(float(value), 3) for value in relative_step(0.5, 0.1)]
    [0.475, 0.899, -0.258]
    """
    ratio, held = np.asarray(ratio, dtype=float), np.asarray(share, dtype=float)
    held = np.where(np.abs(held) < 1, held, np.nan)
    with np.errstate(invalid="ignore"):
        rest, squared, more = 1 - held, held**2, 1 + held
        is_limited, slowed = ratio > rest, ratio / (1 - squared)
        lost = slowed * held
        return RelativeStep(
            np.where(is_limited, rest / more, ratio * (1 - lost)),
            np.where(is_limited, 0 * held, 1 - 2 * lost),
            np.where(is_limited, -2 / more**2, -(slowed**2) * (1 + squared)),
        )


def relative_size(ratio: npt.ArrayLike, share: npt.ArrayLike) -> Array:
    """Compute the step of `relative_step` alone, from the same parameters.

    Examples
    --------
    >>> float(relative_size(0.5, 0.1) - relative_step(0.5, 0.1).step)
    0.0
    """
    ratio, held = np.asarray(ratio, dtype=float), np.asarray(share, dtype=float)
    held = np.where(np.abs(held) < 1, held, np.nan)
    with np.errstate(invalid="ignore"):
        rest = 1 - held
        limited, free = rest / (1 + held), ratio * (1 - ratio / (1 - held**2) * held)
        return np.where(ratio > rest, limited, free)


def step_size(
    friction_acceleration: npt.ArrayLike,
    ramp_time: npt.ArrayLike,
    amplitude: npt.ArrayLike,
    load: npt.ArrayLike = 0.0,
    flyback_time: npt.ArrayLike = 0.0,
) -> Array:
    """Compute the step from rest to rest.

    Parameters
    ----------
    friction_acceleration : array_like
        a_f, m/s^2 (rad/s^2 for a rotary joint): friction force over mass.
    ramp_time : array_like
        T1, s.
    amplitude : array_like
        D, m (rad).
    load : array_like
        G, m/s^2 (rad/s^2): deceleration by the load, positive against the motion.
    flyback_time : array_like
        t_f, s.

    Returns
    -------
    ndarray
        Step size in the direction of the ramp, m (rad); the arguments' broadcast shape.

    Examples
    --------
    Catching up, then friction-limited, without load and with 1 g against the motion:

    >>> (1e9 * step_size(100.0, 1e-4, [[0.5e-6], [3e-6]], [0.0, 9.81])).round(3)
    array([[ 500.   ,  475.237],
           [1000.   ,  821.328]])
    """
    m = _motion(friction_acceleration, ramp_time, amplitude, load, flyback_time)
    return m.friction * m.ramp_time**2 * relative_step(m.ratio, m.load / m.friction).step - _back_slip(m)


def back_slip(
    friction_acceleration: npt.ArrayLike,
    ramp_time: npt.ArrayLike,
    amplitude: npt.ArrayLike,
    load: npt.ArrayLike = 0.0,
    flyback_time: npt.ArrayLike = 0.0,
) -> Array:
    """Compute what a flyback that takes time costs of the step; parameters as for `step_size`.

    Returns
    -------
    ndarray
        Loss, m (rad), at least 0. It shrinks as the mass grows, so that the step grows with the mass.

    Examples
    --------
    >>> (1e9 * back_slip([50.0, 25.0], 4e-4, 1e-6, 0.0, 8e-5)).round(3)
    array([45.,  0.])
    """
    return _back_slip(_motion(friction_acceleration, ramp_time, amplitude, load, flyback_time))


def settling_time(
    friction_acceleration: npt.ArrayLike,
    ramp_time: npt.ArrayLike,
    amplitude: npt.ArrayLike,
    load: npt.ArrayLike = 0.0,
    flyback_time: npt.ArrayLike = 0.0,
) -> Array:
    """Compute the time from the end of the ramp until slider and foot rest; parameters as for `step_size`.

    The formulas hold for steps that follow each other no faster than this.

    Returns
    -------
    ndarray
        Time, s.

    Examples
    --------
    >>> float(settling_time(50.0, 1e-4, 1e-6))
    0.0001
    """
    m = _motion(friction_acceleration, ramp_time, amplitude, load, flyback_time)
    backward = np.clip(m.excess, 0, m.return_speed)
    coast = np.maximum(m.speed / m.slowing, m.flyback_time)
    return np.where(m.excess > 0, m.flyback_time + backward / m.gaining, coast)


def _motion(
    friction: npt.ArrayLike,
    ramp_time: npt.ArrayLike,
    amplitude: npt.ArrayLike,
    load: npt.ArrayLike,
    flyback_time: npt.ArrayLike,
) -> _Motion:
    a_f, t_1, d, g, t_f = (
        np.array(value)
        for value in np.broadcast_arrays(
            *(np.asarray(x, dtype=float) for x in (friction, ramp_time, amplitude, load, flyback_time))
        )
    )
    outside = ~((a_f > 0) & (t_1 > 0) & (d > 0) & (np.abs(g) < a_f) & (t_f >= 0))
    for values in (a_f, t_1, d, g, t_f):
        values[outside] = np.nan
    ratio = d / (a_f * t_1**2)
    return _Motion(a_f, t_1, d, g, t_f, a_f + g, a_f - g, d / t_1, ratio, ratio > 1 - g / a_f)


def _back_slip(m: _Motion) -> Array:
    excess = np.clip(m.excess, 0, m.return_speed)
    loss = excess**2 * m.friction / (m.slowing * m.gaining)
    # Once it moves with the foot, the slider follows it through the rest of the flyback.
    rest = m.flyback_time - (m.speed + excess) / m.slowing
    with np.errstate(invalid="ignore"):
        followed = np.where(m.excess > m.return_speed, m.return_speed * rest, 0.0)
    return loss + followed
