"""What single parts of the machine do: arm, cable, bearing and guide."""

from collections.abc import Callable

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.physics import DEG, FULL, MM, STROKE, Array, Place

Rng = np.random.Generator


def _inertia(skew: float) -> Maker:
    """Inertia growing with the square of the reach, as far as a line in q3 has not taken it up."""

    def term(place: Place, size: float) -> Array | float:
        if place.joint != 2:
            return 0.0
        return size * place.q3 * (place.q3 - STROKE) * (1 + skew * (place.q3 / STROKE - 0.5))

    return lambda c, rng: Effect(0.15e-6 / MM**2, sized("k", "µrad/mm^2", 1e6 * MM**2), term=term)


inertia = _inertia(0.0)
inertia_skewed = _inertia(0.4)


def _cable(stiffening: float) -> Maker:
    def term(place: Place, size: float) -> Array | float:
        if place.joint == 3:
            return 0.0
        low, high = FULL[place.joint]
        x = place.own - (low + high) / 2
        return size * place.forward * x * (1 + stiffening * (x / (high - low)) ** 2)

    return lambda c, rng: Effect(0.05e-6 / DEG, sized("k", "µrad/deg", 1e6 * DEG), term=term)


cable = _cable(0.0)
cable_stiffening = _cable(1.5)


def _runout(second: float) -> Maker:
    """An eccentric bearing, with a share of its second harmonic."""

    def make(c: Campaign, rng: Rng) -> Effect:
        phi, twist = rng.uniform(-np.pi, np.pi, 2)

        def factor(place: Place, size: float) -> Array | float:
            if place.joint == 3:
                return 1.0
            q = place.own
            return 1 + size * (np.cos(q - phi) + second * np.cos(2 * q - twist))

        said = sized("A", "%", 100, ("phi", "deg", phi / DEG))
        return Effect(0.05, said, factor=factor, either_sign=False)

    return make


runout = _runout(0.0)
runout_two_lobed = _runout(0.2)


def _guide(shape: Callable[[Array], Array]) -> Maker:
    """A factor along the guide, of the distance from its middle."""

    def factor(place: Place, size: float) -> Array | float:
        return 1 + size * shape(place.q3 - STROKE / 2) if place.joint == 3 else 1.0

    return lambda c, rng: Effect(0.01 / MM, sized("k", "%/mm", 100 * MM), factor=factor)


guide = _guide(lambda x: x)
guide_curved = _guide(lambda x: x + 0.3 * x**2 / STROKE)


def _spot(shape: Callable[[Array], Array]) -> Maker:
    """A worn stretch of guide, of the distance from it in its own widths."""

    def make(c: Campaign, rng: Rng) -> Effect:
        x0, w = rng.uniform(1, 11) * MM, np.exp(rng.uniform(np.log(0.1), np.log(1.0))) * MM

        def factor(place: Place, size: float) -> Array | float:
            return 1 + size * shape((place.q3 - x0) / w) if place.joint == 3 else 1.0

        return Effect(0.5, sized("A", "%", 100, ("x0", "mm", x0 / MM), ("w", "mm", w / MM)), factor=factor)

    return make


spot = _spot(lambda z: np.exp(-(z**2) / 2))
spot_lorentzian = _spot(lambda z: 1 / (1 + z**2))
