"""What acts through a column that the lab wrote down."""

from collections.abc import Callable

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, by_row, sized
from tests.hidden.physics import Array

Rng = np.random.Generator
LAB_COLUMNS = ("air_pressure_hPa", "operator_load")


def _reading(column: str, largest: float, unit: str, shape: Callable[[Array], Array]) -> Maker:
    """A maker of an effect of a column's departure from its mean."""

    def make(c: Campaign, rng: Rng) -> Effect | None:
        if column not in c.columns:
            return None
        departure = c.columns[column] - c.columns[column].mean()
        return Effect(largest, sized("k", unit, 100), factor=by_row(shape(departure)))

    return make


def _straight(x: Array) -> Array:
    return x


def _curved(x: Array) -> Array:
    return x + 0.25 * x**2 / (np.std(x) or 1.0)


def _saturating(x: Array) -> Array:
    limit = 2 * (np.std(x) or 1.0)
    return limit * np.tanh(x / limit)


temperature = _reading("temperature_C", 0.01, "%/K", _straight)
temperature_curved = _reading("temperature_C", 0.01, "%/K", _curved)
humidity = _reading("humidity_pct", 0.002, "%/%", _straight)
humidity_saturating = _reading("humidity_pct", 0.002, "%/%", _saturating)
supply = _reading("supply_V", 0.02, "%/V", _straight)
supply_curved = _reading("supply_V", 0.02, "%/V", _curved)


def _rate(largest: float, shape: Callable[[Array], Array]) -> Maker:
    def make(c: Campaign, rng: Rng) -> Effect | None:
        if "step_period_ms" not in c.columns:
            return None
        period = c.columns["step_period_ms"]
        return Effect(largest, sized("k", "%", 100), factor=by_row(shape(np.log(period / np.median(period)))))

    return make


step_rate = _rate(0.05, _straight)
step_rate_power = _rate(0.05, lambda x: np.expm1(0.6 * x) / 0.6)


def _covariate(shape: Callable[[Array, float], Array]) -> Maker:
    def make(c: Campaign, rng: Rng) -> Effect | None:
        subset = [name for name in LAB_COLUMNS if name in c.columns]
        if not subset:
            return None
        name = str(rng.choice(subset))
        z = (c.columns[name] - c.columns[name].mean()) / c.columns[name].std()
        said = sized("per standard deviation", "%", 100)
        return Effect(0.02, said, factor=by_row(shape(z, rng.uniform(-1, 1))), cause=f"covariate:{name}")

    return make


covariate_straight = _covariate(lambda z, where: z)
covariate_threshold = _covariate(lambda z, where: np.tanh(2 * (z - where)))
covariate_hump = _covariate(lambda z, where: np.exp(-((z - where) ** 2)))
