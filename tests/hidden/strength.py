"""How strongly an effect shows in a log, and the size it needs to show so strongly.

Strength is the square root of the noncentrality: sqrt(n) times the rms effect on log counts that is left
after the baseline has been recalibrated in each session and direction, over the repeatability. Where
repeatability differs between rows, recalibration is weighted by it and each row counts by its own,

    strength^2 = min over dp of sum ((effect - J dp) / repeatability)^2,

which is the same where it does not differ.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.effect import Effect, change
from tests.hidden.physics import Array, Place

CLOSE = 1e-3
_NOTHING = 1e-6
_STEP, _RANK = 1e-4, 1e-6


class Ruler:
    """Measures effects on one campaign."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign

    @cached_property
    def _weighted(self) -> Array:
        return recalibrations(self.campaign, 1 / self.campaign.repeatability)

    @cached_property
    def _even(self) -> Array:
        return recalibrations(self.campaign, np.ones(len(self.campaign)))

    def strength(self, effect: Effect, size: float) -> float:
        """Strength of an effect at a size; NaN where a joint would come to a halt."""
        return float(
            np.linalg.norm(_off(self._weighted, self._change(effect, size) / self.campaign.repeatability))
        )

    def rms(self, effect: Effect, size: float) -> float:
        """Rms over all rows, with equal weight, of what recalibration leaves of an effect on log counts."""
        change = self._change(effect, size)
        return self.rms_left(change) if effect.absorbed else float(np.sqrt(np.mean(change**2)))

    def rms_left(self, change: Array) -> float:
        """Rms over all rows, with equal weight, of what recalibration leaves of changes, (n,)."""
        return float(np.sqrt(np.mean(_off(self._even, change) ** 2)))

    def size(self, effect: Effect, strength: float) -> float | None:
        """Size at which an effect has a strength; None where there is no such size."""
        # Secant steps between logarithms: one is enough for an effect that is proportional to its size.
        x, slope, last = float(np.log(0.01 * effect.largest)), 1.0, None
        for _ in range(30):
            reached = self.strength(effect, float(np.exp(x)))
            if np.isnan(reached) and last is not None:
                x = (x + last[0]) / 2
                continue
            if not reached > _NOTHING:
                return None
            short = float(np.log(strength / reached))
            if abs(short) < CLOSE:
                return float(np.exp(x))
            if last is not None:
                slope = float(np.clip((last[1] - short) / (x - last[0]), 0.3, 3.0))
            last = (x, short)
            x += float(np.clip(short / slope, -6.0, 6.0))
        return None

    def _change(self, effect: Effect, size: float) -> Array:
        return change(self.campaign, effect, size)


def recalibrations(campaign: Campaign, weights: Array) -> Array:
    """Orthonormal directions, shape (n, p), in which recalibration moves the weighted log counts."""
    directions = []
    for place in campaign.places:
        jacobian = _jacobian(place) * weights[place.rows, None]
        group = 2 * campaign.plan.session[place.rows] + (campaign.plan.forward[place.rows] > 0)
        for each in np.unique(group):
            subset = np.flatnonzero(group == each)
            block = np.zeros((len(campaign), min(len(subset), jacobian.shape[1])))
            block[place.rows[subset]] = _span(jacobian[subset])
            directions.append(block)
    return np.concatenate(directions, axis=1)


def _jacobian(place: Place) -> Array:
    """Change of each log count with each parameter, in shares of the parameter, by central differences."""

    def log_counts(name: str, share: float) -> Array:
        moved = replace(place, values={**place.values, name: place.values[name] * (1 + share)})
        return np.log(moved.counts(moved.step_size()))

    slopes = [(log_counts(name, _STEP) - log_counts(name, -_STEP)) / (2 * _STEP) for name in place.values]
    return np.stack(slopes, axis=1)


def _span(columns: Array) -> Array:
    """Orthonormal basis of what columns span, zeros where they span less than their number."""
    length = np.linalg.norm(columns, axis=0)
    basis, spread, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    return basis * (spread > _RANK * spread[:1])


def _off(directions: Array, vector: Array) -> Array:
    return vector - directions @ (directions.T @ vector)
