"""The motion of the foot within one period: pieces of constant acceleration, by name or from a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, suggest

WaveformName = Literal["ramp", "parabola", "s-curve"]


@dataclass(frozen=True, eq=False)
class FootMotion:
    """Position of the foot over one period; before and after, it is where the last piece ends.

    Attributes
    ----------
    duration : ndarray, shape (n, ...)
        Of each piece, s; 0 for a jump. Further axes are parameter sets side by side.
    position, velocity : ndarray, shape (n, ...)
        At the beginning of each piece, m and m/s.
    acceleration : ndarray, shape (n, ...)
        Constant over each piece, m/s^2.
    """

    duration: Array
    position: Array
    velocity: Array
    acceleration: Array

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """Duration, position, velocity and acceleration."""
        return self.duration, self.position, self.velocity, self.acceleration

    @property
    def ends(self) -> Array:
        """Position at the end of each piece, m."""
        return self.position + (self.velocity + self.acceleration * self.duration / 2) * self.duration

    @property
    def period(self) -> Array:
        """Duration of all pieces, s."""
        return self.duration.sum(axis=0)

    def at(self, time: npt.ArrayLike) -> Array:
        """Position at times of one period, m; of one parameter set."""
        t = np.asarray(time, dtype=float)
        ends = np.cumsum(self.duration)
        piece = np.minimum(np.searchsorted(ends, t, side="right"), len(ends) - 1)
        passed = t - (ends[piece] - self.duration[piece])
        return self.position[piece] + (self.velocity[piece] + self.acceleration[piece] * passed / 2) * passed


def make_motion(
    name: WaveformName,
    amplitude: npt.ArrayLike,
    ramp_time: npt.ArrayLike,
    flyback_time: npt.ArrayLike = 0.0,
    rest_time: npt.ArrayLike = 0.0,
) -> FootMotion:
    """Make a motion that creeps forward, flies back at constant speed, and rests.

    Parameters
    ----------
    name : {'ramp', 'parabola', 's-curve'}
        Forward at constant speed; from rest at constant acceleration, as Zesch et al. (1995) and Breguet and
        Clavel (1998) drive; or accelerated over the first half and slowed to rest over the second.
    amplitude, ramp_time, flyback_time, rest_time : array_like
        m and s; arrays make one motion for each parameter set.

    Raises
    ------
    InputError
        For an unknown name, an amplitude or ramp time that is not above 0, or a negative time.

    Examples
    --------
    >>> motion = make_motion("parabola", 1e-6, 1e-4, 1e-5)
    >>> (1e9 * motion.at([0, 5e-5, 1e-4, 1.05e-4])).round(6)
    array([   0.,  250., 1000.,  500.])
    """
    if name not in get_args(WaveformName):
        names = get_args(WaveformName)
        raise InputError(f"{name!r} is no waveform; name one of {', '.join(names)}{suggest(name, names)}")
    d, t_1, t_f, t_r = np.broadcast_arrays(
        *(np.asarray(value, dtype=float) for value in (amplitude, ramp_time, flyback_time, rest_time))
    )
    if not (np.all(d > 0) and np.all(t_1 > 0) and np.all(t_f >= 0) and np.all(t_r >= 0)):
        raise InputError("amplitude and ramp time must be above 0, flyback and rest time 0 or more")
    zero, speed = np.zeros(d.shape), d / t_1
    forward = {
        "ramp": [(t_1, zero, speed, zero)],
        "parabola": [(t_1, zero, zero, 2 * speed / t_1)],
        "s-curve": [(t_1 / 2, zero, zero, 4 * speed / t_1), (t_1 / 2, d / 2, 2 * speed, -4 * speed / t_1)],
    }[name]
    with np.errstate(divide="ignore"):
        back = np.where(t_f > 0, -d / t_f, 0.0)
    pieces = [*forward, (t_f, d, back, zero), (t_r, zero, zero, zero)]
    return FootMotion(*(np.stack(values) for values in zip(*pieces, strict=True)))


def motion_from_table(times: npt.ArrayLike, positions: npt.ArrayLike) -> FootMotion:
    """Make a motion of straight pieces between the points of a table.

    Parameters
    ----------
    times : array_like, shape (n,)
        From 0 on, s; the same twice for a jump.
    positions : array_like, shape (n,)
        m; the last is the first, since the motion repeats.

    Raises
    ------
    InputError
        If the table is no such motion.

    Examples
    --------
    >>> motion_from_table([0, 1e-4, 1e-4, 2e-4], [0, 1e-6, 0, 0]).velocity
    array([0.01, 0.  , 0.  ])
    """
    t, x = (np.asarray(values, dtype=float) for values in (times, positions))
    if t.ndim != 1 or t.shape != x.shape or len(t) < 3 or not np.all(np.isfinite([t, x])):
        raise InputError("a waveform's table needs at least three finite times, and a position for each")
    if t[0] != 0 or np.any(np.diff(t) < 0) or t[-1] <= 0:
        raise InputError("a waveform's times must begin at 0 and not go back")
    if np.ptp(x) == 0 or not np.isclose(x[0], x[-1], rtol=0, atol=1e-9 * np.ptp(x)):
        raise InputError("a waveform must move, and end where it began: it repeats")
    duration = np.diff(t)
    speed = np.divide(np.diff(x), duration, out=np.zeros(len(duration)), where=duration > 0)
    return FootMotion(duration, x[:-1], speed, np.zeros(len(duration)))
