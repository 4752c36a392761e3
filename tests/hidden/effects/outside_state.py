"""What no cause describes, in where a traverse is and what is read there: angles, products, directions."""

from collections.abc import Callable

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.physics import DEG, MM, Array, Place

Rng = np.random.Generator
Shape = Callable[[Place], Array]
Column = Callable[[Campaign, Rng], Array | None]

LARGEST = 0.05  # of a step size: what an overlooked influence of this kind may plausibly be


def of_place(shape: Shape, *joints: int) -> Maker:
    """The step size times 1 + A shape(place), of these joints or of all."""
    return of_both(lambda c, rng: np.ones(len(c)), shape, *joints)


def z(c: Campaign, name: str) -> Array | None:
    """A column in standard deviations from its mean; none where the lab has none or a constant."""
    values = c.columns.get(name)
    if values is None or not np.ptp(values):
        return None
    return np.asarray((values - values.mean()) / values.std())


def of_column(column: Column) -> Maker:
    """The step size times 1 + A column, a value for each traverse; none where the lab has no such column."""
    return of_both(column, lambda place: np.ones((1, 1)))


def of_both(column: Column, shape: Shape, *joints: int) -> Maker:
    """The step size times 1 + A column shape(place)."""

    def make(c: Campaign, rng: Rng) -> Effect | None:
        values = column(c, rng)
        if values is None:
            return None

        def factor(place: Place, size: float) -> Array | float:
            if joints and place.joint not in joints:
                return 1.0
            return 1 + size * place.of(values) * shape(place)

        return Effect(LARGEST, sized("A", "%", 100), factor=factor)

    return make


def reading(name: str) -> Column:
    """A column that the lab writes down, in standard deviations from its mean."""

    def column(c: Campaign, rng: Rng) -> Array | None:
        if name not in c.columns:
            return None
        values = c.columns[name]
        return np.asarray((values - values.mean()) / values.std())

    return column


def _load(place: Place) -> Array:
    return place.load


def _guide(place: Place) -> Array:
    """q3 from -1 at one end of the guide to 1 at the other."""
    return (place.q3 - 6 * MM) / (6 * MM)


def _forward(place: Place) -> Array:
    return place.forward


def _wave(c: Campaign, rng: Rng) -> Array:
    period, phase = rng.uniform(10, 40), rng.uniform(0, 2 * np.pi)
    return np.sin(2 * np.pi * 60 * c.hours / period + phase)


ANGLE: dict[str, Maker] = {
    "cos q1, joint 3": of_place(lambda p: np.cos(p.angles["q1"]), 3),
    "cubic in q2, joint 3": of_place(lambda p: ((p.angles["q2"] + 75 * DEG) / (105 * DEG)) ** 3, 3),
    "step in theta": of_place(lambda p: (p.angles["theta"] < -45 * DEG).astype(float)),
    "square of psi": of_place(lambda p: (p.angles["psi"] / (45 * DEG)) ** 2),
    "sin 2 q1, joint 2": of_place(lambda p: np.sin(2 * p.angles["q1"]), 2),
    "bump in q2, joint 3": of_place(lambda p: np.exp(-(((p.angles["q2"] + 60 * DEG) / (25 * DEG)) ** 2)), 3),
    "sin 4 q2, joint 1": of_place(lambda p: np.sin(4 * p.angles["q2"]), 1),
    "period of 5 mm in q3, joint 1": of_place(lambda p: np.sin(2 * np.pi * p.q3 / (5 * MM)), 1),
}

PRODUCT: dict[str, Maker] = {
    "load and hours": of_both(lambda c, rng: c.hours / c.hours.max(), _load),
    "q3 and sin theta, joint 2": of_place(lambda p: _guide(p) * np.sin(p.angles["theta"]), 2),
    "load and square of hours": of_both(lambda c, rng: (c.hours / c.hours.max()) ** 2, _load),
    "sin q1 and q3, joint 2": of_place(lambda p: np.sin(p.angles["q1"]) * _guide(p), 2),
    "temperature and load": of_both(reading("temperature_C"), _load),
    "supply and q3, joint 2": of_both(reading("supply_V"), _guide, 2),
    "step period and load": of_both(lambda c, rng: np.log(c.plan.step_period / 0.004), _load),
    "operator load and cos q2, joint 3": of_both(
        reading("operator_load"), lambda p: np.cos(p.angles["q2"]), 3
    ),
}

DIRECTION: dict[str, Maker] = {
    "saturating in sin theta, one way": of_place(
        lambda p: np.tanh(3 * np.sin(p.angles["theta"])) * (p.forward > 0)
    ),
    "cos 2 psi, one way": of_place(lambda p: np.cos(2 * p.angles["psi"]) * (p.forward < 0)),
    "periodic in time, opposite ways": of_both(_wave, _forward),
    "humidity, opposite ways": of_both(reading("humidity_pct"), _forward),
    "sin q1, opposite ways, joint 3": of_place(lambda p: np.sin(p.angles["q1"]) * p.forward, 3),
    "air pressure, opposite ways": of_both(reading("air_pressure_hPa"), _forward),
}
