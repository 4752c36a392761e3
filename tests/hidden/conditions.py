"""What a lab reads while it measures: room, supply and its own columns; and columns that act on nothing."""

from collections.abc import Mapping

import numpy as np

from tests.hidden.designs import Ints, Plan
from tests.hidden.physics import Array

DECOYS = ("walk", "noise", "trend", "session", "copy")


def conditions(plan: Plan, hours: Array, clock: Array, rng: np.random.Generator) -> dict[str, Array]:
    """The plan's columns, as they would be written down.

    `hours` is the time since the session began, `clock` the time of day in hours.
    """
    day = 2 * np.pi * (clock - rng.uniform(6, 12)) / 24

    def by_session(spread: float) -> Array:
        return spread * rng.standard_normal(int(plan.session.max()) + 1)[plan.session]

    def wander(spread: float, knot: float) -> Array:
        return spread * _wander(plan.session, hours, knot, rng)

    noise = rng.standard_normal(len(hours))
    known = {
        "temperature_C": 21.5 + by_session(1.0) + 1.5 * np.sin(day) + wander(0.4, 1.0) + 0.03 * noise,
        "humidity_pct": 42 + by_session(6.0) - 4 * np.sin(day + 0.7) + wander(2.0, 0.8),
        "supply_V": 48 + by_session(0.3) + wander(0.5, 0.5),
        "air_pressure_hPa": 1013 + by_session(6.0) + wander(2.0, 1.5),
        "operator_load": 50 + by_session(5.0) + wander(15.0, 0.4),
    }
    written = {name: np.round(known[name], 2) for name in known if name in plan.columns}
    if "step_period_ms" in plan.columns:
        written["step_period_ms"] = np.round(1e3 * plan.step_period, 3)
    if plan.payload is not None:
        written["payload_g"] = plan.payload
    return written


def decoy(
    kind: str, hours: Array, session: Ints, real: Mapping[str, Array], rng: np.random.Generator
) -> Array:
    """A column that acts on nothing: one of `DECOYS`."""
    noise = rng.standard_normal(len(hours))
    if kind == "walk":
        column = np.cumsum(noise)
    elif kind == "noise":
        column = noise
    elif kind == "trend":
        column = 3 * hours / hours.max() + 0.5 * noise
    elif kind == "session":
        column = rng.standard_normal(int(session.max()) + 1)[session]
    elif kind == "copy":
        name = str(rng.choice(sorted(real)))
        column = real[name] + (np.std(real[name]) or 1.0) * noise
    else:
        raise ValueError(f"there is no decoy {kind!r}; choose from {DECOYS}")
    return np.round(column, 4)


def _wander(session: Ints, hours: Array, knot: float, rng: np.random.Generator) -> Array:
    """Something that drifts about within each session, from one knot to the next, unit variance at a knot."""
    wandered = np.zeros(len(hours))
    for each in range(int(session.max()) + 1):
        subset = session == each
        knots = rng.standard_normal(int(hours[subset].max() / knot) + 2)
        wandered[subset] = np.interp(hours[subset], knot * np.arange(len(knots)), knots)
    return wandered
