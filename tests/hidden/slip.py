"""One step of a slider on a foot, from friction alone: event by event with Coulomb's, in small times with
LuGre's.

The foot moves at a constant speed in each of a few phases: out by the throw within the ramp time, back within
the flyback time, then it stands. Friction drives the slider by at most `friction` (an acceleration: force
over mass, or torque over inertia) and the load holds it back by `pull`. All arguments broadcast; SI.

LuGre: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, IEEE Trans. Automatic Control 40:419, 1995.
The bristles' damping fades with speed (H. Olsson, thesis, Lund, 1996); else they throw the slider back in the
flyback.
"""

from dataclasses import dataclass

import numpy as np

from tests.hidden.physics import Array

TINY = 1e-12


def coulomb_step(friction: Array, pull: Array, throw: Array, ramp: Array, flyback: Array) -> Array:
    """How far a step goes; NaN where friction does not hold the load."""
    friction, pull, throw, ramp, flyback = np.broadcast_arrays(friction, pull, throw, ramp, flyback)
    place, speed = np.zeros(friction.shape), np.zeros(friction.shape)
    rest = 1e6 * (ramp + flyback)  # long enough for any slider to stop
    for lasts, foot in ((ramp, throw / ramp), (flyback, -throw / flyback), (rest, 0 * throw)):
        pushed = np.where(foot > speed, friction - pull, -friction - pull)
        together = np.minimum(np.where(foot == speed, 0.0, (foot - speed) / pushed), lasts)
        place = place + speed * together + pushed * together**2 / 2 + foot * (lasts - together)
        speed = np.where(together < lasts, foot, speed + pushed * together)
    return np.where(np.abs(pull) < friction, place, np.nan)


@dataclass(frozen=True)
class Bristles:
    """LuGre's constants, in terms that do not depend on the size of a slider.

    Attributes
    ----------
    bend : float
        Deflection at which they slide, as a share of the throw.
    damping : float
        Of the slider on them, as a share of critical.
    static : float
        Static over sliding friction.
    stribeck : float
        Speed at which static friction has gone, as a share of the ramp's.
    viscous : float
        Friction that grows with speed: share of sliding friction gained at the ramp's speed.
    """

    bend: float = 0.003
    damping: float = 0.5
    static: float = 1.0
    stribeck: float = 0.1
    viscous: float = 0.0


def lugre_step(
    friction: Array,
    pull: Array,
    throw: Array,
    ramp: Array,
    flyback: Array,
    bristles: Bristles,
    *,
    pieces: int = 500,
) -> Array:
    """How far the second of two steps goes, so that what bends at rest bends in both.

    `pieces` is how many times a ramp is cut into. With the relative speed v held within one, the deflection z
    follows dz/dt = v - |v| z / z_sliding exactly, and the slider takes up the mean of it and all that damping
    gives.
    """
    shape = np.broadcast_shapes(*(np.shape(each) for each in (friction, pull, throw, ramp, flyback)))
    friction, pull, throw, ramp, flyback = (
        np.broadcast_to(each, shape).ravel() for each in (friction, pull, throw, ramp, flyback)
    )
    bend = bristles.bend * throw
    stiffness = friction / bend
    damping = 2 * bristles.damping * np.sqrt(stiffness)
    drive = throw / ramp
    fall, rise = -1 / (bristles.stribeck * drive) ** 2, (bristles.static - 1) * bend
    viscous = bristles.viscous * friction / drive
    # Slider, speed and deflection at rest under the load.
    place, speed, z = np.zeros(len(throw)), np.zeros(len(throw)), pull / stiffness
    settling = 3 * ramp * np.maximum(1.0, drive / friction / ramp).clip(max=2) + 30 / damping
    first = place
    for _ in range(2):
        first = place
        for lasts, foot, cuts in (
            (ramp, drive, pieces),
            (flyback, -throw / flyback, pieces // 4),
            (settling, 0 * throw, 4 * pieces),
        ):
            dt = lasts / cuts
            for _ in range(cuts):
                v = foot - speed
                near = np.exp(fall * v * v)
                sliding = bend + rise * near
                rate = np.abs(v) * dt / sliding + TINY  # at rest, too, the mean is z
                aim = np.copysign(sliding, v)
                change = (z - aim) * np.expm1(-rate)
                push = stiffness * (aim - change / rate) + viscous * v - pull
                faster = speed + push * dt + damping * near * change
                place = place + (speed + faster) * (dt / 2)
                speed, z = faster, z + change
    return (place - first).reshape(shape)
