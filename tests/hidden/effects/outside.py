"""What no cause describes: periodic disturbances, harmonics, curvature within sessions, memory."""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from tests.hidden.campaign import Campaign
from tests.hidden.designs import Ints
from tests.hidden.effect import Effect, Maker, by_row, say, sized
from tests.hidden.physics import Array, Place

Rng = np.random.Generator


def periodic_in_time(c: Campaign, rng: Rng) -> Effect:
    """Something in the room that comes and goes every 7 to 60 min, whatever the session."""
    period, phase = np.exp(rng.uniform(np.log(7), np.log(60))), rng.uniform(0, 2 * np.pi)
    minutes = (c.time - c.time[0]).astype(float) / 60
    wave = np.sin(2 * np.pi * minutes / period + phase)
    return Effect(0.02, sized("A", "%", 100, ("period", "min", period)), factor=by_row(wave))


def periodic_in_traverses(c: Campaign, rng: Rng) -> Effect:
    """Something that comes back every few traverses, 5 to 40."""
    period, phase = np.exp(rng.uniform(np.log(5), np.log(40))), rng.uniform(0, 2 * np.pi)
    wave = np.sin(2 * np.pi * np.arange(len(c)) / period + phase)
    return Effect(0.02, sized("A", "%", 100, ("period", "traverses", period)), factor=by_row(wave))


def _harmonic(shape: Callable[[Array], Array]) -> Maker:
    def factor(place: Place, size: float) -> Array | float:
        return 1 + size * shape(place.angles["q2"]) if place.joint == 3 else 1.0

    return lambda c, rng: Effect(0.05, sized("A", "%", 100), factor=factor)


harmonic_third = _harmonic(lambda q2: np.cos(3 * q2))
harmonic_second = _harmonic(lambda q2: np.sin(2 * q2))


def _through_session(c: Campaign) -> Array:
    """How much of its session is over, 0 to 1."""
    length = np.zeros(int(c.plan.session.max()) + 1)
    np.maximum.at(length, c.plan.session, c.hours)
    return c.hours / length[c.plan.session]


def curvature_parabola(c: Campaign, rng: Rng) -> Effect:
    x, middle = _through_session(c), rng.uniform(0.4, 0.6)
    return Effect(0.05, sized("A", "%", 100), factor=by_row(1 - ((x - middle) / 0.5) ** 2))


def curvature_bump(c: Campaign, rng: Rng) -> Effect:
    x, middle, width = _through_session(c), rng.uniform(0.35, 0.65), rng.uniform(0.08, 0.16)
    return Effect(0.05, sized("A", "%", 100), factor=by_row(np.exp(-(((x - middle) / width) ** 2) / 2)))


def _rho(size: float) -> float:
    return float(size / np.hypot(1, size))


def _memory(chains: Callable[[Campaign], Ints]) -> Maker:
    """Noise of which a share rho of each traverse's is carried on to the next of its chain.

    The new part of each departure keeps the repeatability; the size is that of the part carried on to it,
    rho / sqrt(1 - rho^2), so that it grows as strength does.
    """

    def make(c: Campaign, rng: Rng) -> Effect:
        chain = chains(c)

        def count(c: Campaign, counts: Array, size: float) -> Array:
            carried = np.zeros(len(c))
            for each in np.unique(chain):
                subset = np.flatnonzero(chain == each)
                new = c.innovations[subset]
                # A session's first departure is as large as any other.
                inflow = np.concatenate([new[:1] * np.hypot(1, size), new[1:]])
                carried[subset] = lfilter([1.0], [1.0, -_rho(size)], inflow) - new
            return counts * np.exp(c.repeatability * carried)

        return Effect(4 / 3, lambda size: say(("rho", "1", _rho(size))), count=count, either_sign=False)

    return make


memory = _memory(lambda c: c.plan.session)
memory_of_each_joint = _memory(lambda c: np.asarray(4 * c.plan.session + c.plan.joint))
