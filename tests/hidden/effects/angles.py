"""Where things stand other than the law has them: mounting, zeros, gravity's lever, compliance."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, Said, say, sized
from tests.hidden.physics import DEG, Array, Place, full_load

Rng = np.random.Generator
_DELTA = sized("delta", "deg", 1 / DEG)


def _offset(angle: str, lever: Callable[[Array], Array | float]) -> Maker:
    """An angle that is off by size times a lever that may depend on the angle itself."""

    def state(place: Place, size: float) -> Place:
        there = place.angles[angle]
        return place.at(**{angle: there + size * lever(there)})

    return lambda c, rng: Effect(5 * DEG, _DELTA, state=state)


def _same(angle: Array) -> float:
    return 1.0


theta_offset = _offset("theta", _same)
theta_offset_sagging = _offset("theta", lambda theta: 0.85 + 0.3 * np.cos(theta))
psi_offset = _offset("psi", _same)
psi_offset_sagging = _offset("psi", lambda psi: 0.85 + 0.3 * np.cos(psi))
q2_offset = _offset("q2", _same)
q2_offset_eccentric = _offset("q2", lambda q2: 1 + 0.2 * np.sin(q2 + 40 * DEG))


def _gravity(scale: float) -> Maker:
    """The load with q1 in its place, as seen by a joint 1 that turns so much further than it says."""

    def state(place: Place, size: float) -> Place:
        if place.joint == 1:
            return place
        angles = {**place.angles, "q1": scale * place.angles["q1"]}
        return replace(place, load=(1 - size) * place.load + size * full_load(place.joint, **angles))

    return lambda c, rng: Effect(1.0, sized("k", "1", 1), state=state, either_sign=False)


q1_gravity = _gravity(1.0)
q1_gravity_scaled = _gravity(1.08)


def _recoil(shape: Callable[[Array, Array, float], Array]) -> Callable[[Place, float], Place]:
    """The guide's recoil as a function of q2, the published recoil and size."""

    def state(place: Place, size: float) -> Place:
        if place.joint != 3:
            return place
        return replace(place, recoil=shape(place.angles["q2"], place.recoil, size))

    return state


def recoil_axis(c: Campaign, rng: Rng) -> Effect:
    turned = _recoil(lambda q2, recoil, phi: np.abs(np.cos(q2 - phi)))
    return Effect(15 * DEG, sized("phi", "deg", 1 / DEG), state=turned)


def recoil_axis_spread(c: Campaign, rng: Rng) -> Effect:
    """Two bodies comply, one in a direction further off than the other's."""

    def turned(q2: Array, recoil: Array, phi: float) -> Array:
        return 0.5 * np.abs(np.cos(q2 - 0.6 * phi)) + 0.5 * np.abs(np.cos(q2 - 1.4 * phi))

    return Effect(15 * DEG, sized("phi", "deg", 1 / DEG), state=_recoil(turned))


def recoil_shape(c: Campaign, rng: Rng) -> Effect:
    """The size is log p: p = 2 is as plausible as p = 1/2."""

    def said(size: float) -> Said:
        return say(("p", "1", np.exp(size)))

    return Effect(np.log(2), said, state=_recoil(lambda q2, recoil, size: recoil ** np.exp(size)))


def recoil_shape_ellipse(c: Campaign, rng: Rng) -> Effect:
    """The end of a compliance ellipse, 1 along the axis; the size is the logarithm of its flatness."""

    def flat(q2: Array, recoil: Array, size: float) -> Array:
        return recoil / np.sqrt(recoil**2 + np.exp(2 * size) * (1 - recoil**2))

    return Effect(np.log(2), sized("log flatness", "1", 1), state=_recoil(flat))
