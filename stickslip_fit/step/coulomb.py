"""Slip and stick of a slider with Coulomb friction, event by event: exact for a piecewise-quadratic foot.

While the foot's acceleration c is constant, so is the slider's: c if it sticks, -s a_f - G if it slips with
the sign s of its velocity relative to the foot, w. It sticks from w = 0 on if the friction that this needs,
c + G, is at most the break-away value. The only event within a piece is w = 0; after it, the slider sticks
through the rest of the piece or slips away from 0, so that a piece has two phases at most. The whole solution
is therefore a fixed number of array operations, for any number of parameter sets side by side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, check_count
from stickslip_fit.step.motion import FootMotion

CHUNK = 4096  # parameter sets whose arrays stay in the processor's cache
MAX_PIECES = 300_000  # of all periods; a minute at most


class _Slider(NamedTuple):
    position: Array
    relative: Array  # velocity, less the foot's


class _Phase(NamedTuple):
    """Constant slider acceleration from a state on."""

    duration: Array
    position: Array
    velocity: Array
    acceleration: Array
    slip: Array  # sign of the relative velocity, 0 where it sticks


@dataclass(frozen=True, eq=False)
class CoulombMotion:
    """Motion of one slider, phase by phase.

    Attributes
    ----------
    time : ndarray, shape (n + 1,)
        Of the events, s.
    position, velocity, acceleration : ndarray, shape (n,)
        Of the slider at the beginning of each phase; the acceleration is constant over it.
    slip : ndarray, shape (n,)
        Sign of the slider's velocity relative to the foot, 0 where it sticks.
    friction : ndarray, shape (n,)
        Friction force on the slider over its mass, m/s^2.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    slip: Array
    friction: Array

    def at(self, time: npt.ArrayLike) -> Array:
        """Slider position, m; before and after the motion it rests."""
        t = np.clip(np.asarray(time, dtype=float), self.time[0], self.time[-1])
        phase = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.position) - 1)
        passed = t - self.time[phase]
        return self.position[phase] + (self.velocity[phase] + self.acceleration[phase] * passed / 2) * passed


def coulomb_step(
    motion: FootMotion,
    friction_acceleration: npt.ArrayLike,
    load: npt.ArrayLike = 0.0,
    *,
    breakaway: npt.ArrayLike = 1.0,
    periods: int = 1,
) -> Array:
    """Compute the mean step over some periods, from rest to rest.

    Parameters
    ----------
    motion : FootMotion
        With or without axes for parameter sets.
    friction_acceleration, load : array_like
        a_f and G as in `step_size`, m/s^2; they broadcast with the sets of `motion`.
    breakaway : array_like
        Static over kinetic friction, at least 1.
    periods : int
        How many follow each other without a pause; after the last, the foot rests until the slider does.

    Returns
    -------
    ndarray
        Step size, m.

    Raises
    ------
    InputError
        If friction does not hold the load, or a value is outside its domain.

    Examples
    --------
    >>> from stickslip_fit.step import make_motion
    >>> float(round(1e9 * coulomb_step(make_motion("ramp", 3e-6, 1e-4), 100.0, 9.81), 6))
    821.327748
    """
    friction, g, ratio, count = _check(motion, friction_acceleration, load, breakaway, periods)
    sets = [np.broadcast_to(values, count).reshape(-1) for values in (friction, g, ratio)]
    pieces = [_side_by_side(values, count) for values in motion.arrays]
    steps = np.empty(sets[0].size)
    for begin in range(0, len(steps), CHUNK):
        part = slice(begin, begin + CHUNK)
        own = FootMotion(*(values[:, part] for values in pieces))
        steps[part] = _solve(own, sets[0][part], sets[1][part], sets[2][part], periods) / periods
    return steps.reshape(count)[()]


def coulomb_motion(
    motion: FootMotion,
    friction_acceleration: float,
    load: float = 0.0,
    *,
    breakaway: float = 1.0,
    periods: int = 1,
) -> CoulombMotion:
    """Solve the motion of one slider; parameters and errors as for `coulomb_step`, of one set.

    Examples
    --------
    It slips, sticks once it is as fast as the foot, and coasts after the flyback:

    >>> from stickslip_fit.step import make_motion
    >>> coulomb_motion(make_motion("ramp", 0.5e-6, 1e-4), 100.0).slip
    array([-1.,  0.,  1.])
    """
    friction, g, ratio, count = _check(motion, friction_acceleration, load, breakaway, periods)
    if count:
        raise InputError("give one parameter set; coulomb_step takes many")
    phases = [phase for phase in _phases(motion, friction, g, ratio, periods) if phase.duration > 0]
    duration, position, velocity, acceleration, slip = np.array(phases, dtype=float).reshape(-1, 5).T
    time = np.concatenate([[0.0], np.cumsum(duration)])
    return CoulombMotion(time, position, velocity, acceleration, slip, acceleration + g)


def _check(
    motion: FootMotion,
    friction_acceleration: npt.ArrayLike,
    load: npt.ArrayLike,
    breakaway: npt.ArrayLike,
    periods: int,
) -> tuple[Array, Array, Array, tuple[int, ...]]:
    check_count("periods", periods)
    most = MAX_PIECES // len(motion.duration)
    if periods > most:
        raise InputError(f"periods must be at most {most:,} for this motion, not {periods:,}")
    friction, g, ratio = (np.asarray(x, dtype=float) for x in (friction_acceleration, load, breakaway))
    if not (np.all(np.isfinite(friction)) and np.all(friction > 0) and np.all(ratio >= 1)):
        raise InputError("friction must be above 0, and static over kinetic friction at least 1")
    if not np.all(np.abs(g) < friction):
        raise InputError("friction does not hold the load, which is no smaller: the slider runs away")
    shape = np.broadcast_shapes(motion.duration.shape[1:], friction.shape, g.shape, ratio.shape)
    return friction, g, ratio, shape


def _side_by_side(values: Array, count: tuple[int, ...]) -> Array:
    """Values of each piece, shape (n, ...), for each of `count` parameter sets, shape (n, sets)."""
    axes = (1,) * (len(count) + 1 - values.ndim)
    spread = np.broadcast_to(values.reshape(len(values), *axes, *values.shape[1:]), (len(values), *count))
    return spread.reshape(len(values), -1)


def _solve(motion: FootMotion, friction: Array, load: Array, breakaway: Array, periods: int) -> Array:
    """Displacement over all periods and the rest after them."""
    displacement = np.zeros(friction.shape)
    for phase in _phases(motion, friction, load, breakaway, periods):
        displacement += (phase.velocity + phase.acceleration * phase.duration / 2) * phase.duration
    return displacement


def _phases(
    motion: FootMotion, friction: Array, load: Array, breakaway: Array, periods: int
) -> Iterator[_Phase]:
    slider = _Slider(np.zeros(np.broadcast_shapes(friction.shape, motion.duration.shape[1:])), np.zeros(()))
    limit = breakaway * friction
    rest = np.zeros(())
    last = rest  # the foot's velocity where the last piece ends
    for _ in range(periods):
        for index in range(len(motion.duration)):
            speed, change = motion.velocity[index], motion.acceleration[index]
            slider = slider._replace(relative=slider.relative + (last - speed))
            left, last = motion.duration[index], speed + change * motion.duration[index]
            if not np.any(left):
                continue
            for _ in range(2):
                phase, slider = _advance(slider, speed, change, left, friction, load, limit)
                yield phase
                left = left - phase.duration
                speed = speed + change * phase.duration
    slider = slider._replace(relative=slider.relative + last)
    slowing = friction + np.sign(slider.relative) * load
    phase, _ = _advance(slider, rest, rest, np.abs(slider.relative) / slowing, friction, load, limit)
    yield phase


def _advance(
    slider: _Slider, speed: Array, change: Array, left: Array, friction: Array, load: Array, limit: Array
) -> tuple[_Phase, _Slider]:
    """Until the piece ends, `left` from here, or the relative velocity is 0."""
    need = change + load
    sign = np.sign(slider.relative)
    sign = np.where((sign == 0) & (np.abs(need) > limit), -np.sign(need), sign)
    gain = np.where(sign == 0, 0.0, -sign * friction - need)
    meets = slider.relative * gain < 0
    until = np.divide(-slider.relative, gain, out=np.full(np.shape(meets), np.inf), where=meets)
    duration = np.minimum(until, left)
    velocity, acceleration = speed + slider.relative, gain + change
    relative = np.where(until <= left, 0.0, slider.relative + gain * duration)
    position = slider.position + (velocity + acceleration * duration / 2) * duration
    return _Phase(duration, slider.position, velocity, acceleration, sign), _Slider(position, relative)
