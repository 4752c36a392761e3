"""What the end stop does to a count, whatever the step size."""

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, Maker, sized
from tests.hidden.physics import Array

Rng = np.random.Generator


def _added(steps: Array, largest: float, either_sign: bool) -> Effect:
    def count(c: Campaign, counts: Array, size: float) -> Array:
        return counts + size * steps

    return Effect(largest, sized("L", "steps", 1), count=count, either_sign=either_sign)


def latency(c: Campaign, rng: Rng) -> Effect:
    return _added(np.ones(len(c)), 200.0, either_sign=True)


def latency_of_two_stops(c: Campaign, rng: Rng) -> Effect:
    """The outer stop is heard a little later than the inner."""
    return _added(1 + 0.2 * c.plan.forward.astype(np.float64), 200.0, either_sign=True)


def _turned(c: Campaign) -> Array:
    forward = c.plan.forward.astype(float)
    return (c.previous(forward, first=0.0) * forward < 0).astype(float)


def reversal(c: Campaign, rng: Rng) -> Effect:
    return _added(_turned(c), 100.0, either_sign=False)


def reversal_as_a_length(c: Campaign, rng: Rng) -> Effect:
    """A play of so much length or angle, which takes more steps where they are short."""
    pace: Array = np.zeros(len(c))
    for place in c.places:
        per_length = c.counts[place.rows] / place.weights.sum(axis=1)
        pace[place.rows] = per_length / per_length.mean()
    steps: Array = _turned(c) * pace
    return _added(steps, 100.0, either_sign=False)


def _misfire(imagined: float) -> Maker:
    """A few counts off by six repeatabilities or more; the size is how many the smallest is off by."""

    def make(c: Campaign, rng: Rng) -> Effect:
        few = max(1, round(np.exp(rng.uniform(-1.0, np.log(0.02 * len(c))))))
        rows = rng.permutation(len(c))[:few]
        off = np.zeros(len(c))
        off[rows] = rng.uniform(1.0, 1.4, len(rows)) * np.where(rng.random(len(rows)) < imagined, -1, 1)

        def count(c: Campaign, counts: Array, size: float) -> Array:
            return counts * np.exp(size * off * c.repeatability)

        typical = 100 * float(np.sqrt(np.mean((off * c.repeatability)[rows] ** 2)))
        said = sized("typical size", "%", typical, ("share", "%", 100 * len(rows) / len(c)))
        return Effect(30.0, said, count=count, either_sign=False, smallest=6.0, absorbed=False)

    return make


misfire = _misfire(0.3)
misfire_missed_only = _misfire(0.0)
