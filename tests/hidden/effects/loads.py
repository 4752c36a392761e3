"""What the law gets wrong about load."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, Said, by_row, say, sized, sized_since
from tests.hidden.physics import Array, Place

Rng = np.random.Generator


def _side(power: float) -> Maker:
    """Friction from the load across the guide."""

    def factor(place: Place, size: float) -> Array | float:
        if place.joint != 3:
            return 1.0
        return 1 - size * np.clip(1 - place.load**2, 0, None) ** power

    return lambda c, rng: Effect(0.10, sized("k", "%", 100), factor=factor, either_sign=False)


side_load = _side(0.5)
side_load_blunt = _side(0.65)


def _bend(f: Callable[[Array], Array]) -> Maker:
    """A response to load that bends, differently for each joint and direction."""

    def make(c: Campaign, rng: Rng) -> Effect:
        shares = rng.uniform(0.5, 1.0, (4, 2)) * rng.choice([-1.0, 1.0], (4, 2))

        def term(place: Place, size: float) -> Array:
            share = shares[place.joint, (place.forward > 0).astype(int)]
            return size * share * place.unloaded * f(place.load)

        def said(size: float) -> Said:
            return [
                {
                    **say(("k", "%", 100 * size * shares[joint, way]))[0],
                    "joint": joint,
                    "direction": "-+"[way],
                }
                for joint in (1, 2, 3)
                for way in (0, 1)
            ]

        return Effect(0.10, said, term=term)

    return make


nonlinearity = _bend(lambda u: u**2)
nonlinearity_odd = _bend(lambda u: u**3)
nonlinearity_tanh = _bend(lambda u: np.tanh(3 * u))
nonlinearity_exponential = _bend(lambda u: np.expm1(1.2 * u))


def hysteresis(c: Campaign, rng: Rng) -> Effect:
    return Effect(0.03, sized("k", "%", 100), factor=by_row(c.previous(c.load)))


def hysteresis_fading(c: Campaign, rng: Rng) -> Effect:
    """The traverse before that one is remembered too, less."""
    one = c.previous(c.load)
    return Effect(0.03, sized("k", "%", 100), factor=by_row(one + rng.uniform(0.2, 0.4) * c.previous(one)))


def _heavier(place: Place, more: Array) -> Place:
    return replace(place, load=place.load * (1 + place.of(more)))


def _after(c: Campaign, rng: Rng) -> tuple[Array, Callable[[float], Said]]:
    first = int(rng.uniform(0.2, 0.8) * len(c))
    return (np.arange(len(c)) >= first).astype(float), sized_since("k", c, first)


def payload(c: Campaign, rng: Rng) -> Effect:
    """Something was mounted or taken off, and nobody wrote it down."""
    after, said = _after(c, rng)
    return Effect(0.30, said, state=lambda place, size: _heavier(place, size * after))


def payload_rubbing(c: Campaign, rng: Rng) -> Effect:
    """Unrecorded; a heavier tip also presses a little harder everywhere."""
    after, said = _after(c, rng)
    return Effect(
        0.30,
        said,
        state=lambda place, size: _heavier(place, size * after),
        factor=lambda place, size: 1 - 0.03 * size * place.of(after),
    )


def _recorded(curvature: float) -> Maker:
    def make(c: Campaign, rng: Rng) -> Effect | None:
        if "payload_g" not in c.columns:
            return None
        mass = c.columns["payload_g"] * (1 + curvature * c.columns["payload_g"] / 20)
        said = sized("k", "%/g", 100)
        return Effect(0.02, said, state=lambda place, size: _heavier(place, size * mass), either_sign=False)

    return make


payload_recorded = _recorded(0.0)
payload_recorded_bending = _recorded(-0.15)
