"""What changes as time passes and steps are driven."""

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, by_row, sized, sized_since
from tests.hidden.physics import Array

Rng = np.random.Generator


def _tau(rng: Rng) -> float:
    """A settling time in hours, 5 to 60 min."""
    return float(np.exp(rng.uniform(np.log(5), np.log(60)))) / 60


def warm_up(c: Campaign, rng: Rng) -> Effect:
    tau = _tau(rng)
    return Effect(
        0.10, sized("A", "%", 100, ("tau", "min", 60 * tau)), factor=by_row(-np.expm1(-c.hours / tau))
    )


def warm_up_of_two_bodies(c: Campaign, rng: Rng) -> Effect:
    """Drive and housing warm up, each in its own time."""
    tau, share = _tau(rng), rng.uniform(0.5, 0.8)
    rise = -share * np.expm1(-c.hours / tau) - (1 - share) * np.expm1(-c.hours / (4 * tau))
    return Effect(0.10, sized("A", "%", 100, ("tau", "min", 60 * tau)), factor=by_row(rise))


def drift(c: Campaign, rng: Rng) -> Effect:
    return Effect(0.05, sized("k", "%/h", 100), factor=by_row(c.hours))


def drift_curved(c: Campaign, rng: Rng) -> Effect:
    power, whole = rng.uniform(1.15, 1.4), c.hours.max()
    return Effect(0.05, sized("k", "%/h", 100), factor=by_row(whole * (c.hours / whole) ** power))


def drift_by_use(c: Campaign, rng: Rng) -> Effect:
    """Creep that goes on only while the joints are driven, by steps of any joint in the session."""
    driven = np.cumsum(c.counts) - c.counts
    session = c.plan.session
    driven = driven - driven[np.searchsorted(session, session)]
    return Effect(0.05, sized("k", "%/h", 100), factor=by_row(driven * c.hours.max() / driven.max()))


def _jump(c: Campaign, rng: Rng, smear: float) -> Effect:
    session = int(rng.integers(int(c.plan.session.max()) + 1))
    subset = np.flatnonzero(c.plan.session == session)
    first = subset[int(rng.uniform(0.2, 0.8) * len(subset))]
    after = np.zeros(len(c))
    after[first : subset[-1] + 1] = 1.0
    after[first] = 1 - smear
    return Effect(0.05, sized_since("A", c, first), factor=by_row(after))


def jump(c: Campaign, rng: Rng) -> Effect:
    return _jump(c, rng, 0.0)


def jump_smeared(c: Campaign, rng: Rng) -> Effect:
    """It takes two traverses to settle."""
    return _jump(c, rng, 0.5)


def _worn_in(rng: Rng) -> float:
    return float(np.exp(rng.uniform(np.log(1e4), np.log(1e6))))


def wear(c: Campaign, rng: Rng) -> Effect:
    n0 = _worn_in(rng)
    return Effect(
        0.03, sized("k", "%", 100, ("n0", "steps", n0)), factor=by_row(np.log1p(c.steps_before / n0))
    )


def wear_power(c: Campaign, rng: Rng) -> Effect:
    n0, power = _worn_in(rng), rng.uniform(0.15, 0.35)
    worn: Array = ((1 + c.steps_before / n0) ** power - 1) / power
    return Effect(0.03, sized("k", "%", 100, ("n0", "steps", n0)), factor=by_row(worn))
