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
_REFITS, _DAMPING = 60, 1e-6


class Ruler:
    """Measures effects on one campaign."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign

    @cached_property
    def _weighted(self) -> Array:
        return recalibrations(self.campaign, 1 / self.campaign.repeatability)

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
        """Rms over all rows, with equal weight, of what the baseline fitted anew leaves of changes, (n,).

        It bends with the law: another payload in a whole session leaves nothing, however large.
        """
        return float(np.sqrt(np.mean(_refit(self.campaign, change) ** 2)))

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


def _refit(campaign: Campaign, change: Array) -> Array:
    """What parameters of each session and direction leave of changes of log counts, (n,): least squares.

    By Levenberg and Marquardt's steps, each group with a damping of its own: undamped ones take the
    parameters of few rows to where the law bends, and may end there.
    """
    left = np.empty(len(campaign))
    for place in campaign.places:
        rows = place.rows
        group = 2 * campaign.plan.session[rows] + (campaign.plan.forward[rows] > 0)
        _, group = np.unique(group, return_inverse=True)
        before, moved, now = _log_counts(place), place, change[rows]
        damping = np.zeros(group.max() + 1)
        for _ in range(_REFITS):
            jacobian, shares = _jacobian(moved), np.zeros((len(rows), len(place.values)))
            for each, damped in enumerate(damping):
                subset = group == each
                shares[subset] = _damped_step(jacobian[subset], now[subset], damped)
            stepped = _scaled(moved, 1 + shares)
            after = change[rows] - _log_counts(stepped) + before
            better = np.bincount(group, after**2) <= np.bincount(group, now**2)  # not where a joint halts
            moved = _scaled(moved, 1 + shares * better[group, None])
            now = np.where(better[group], after, now)
            damping = np.where(better, damping / 10, np.maximum(10 * damping, _DAMPING))
            if np.abs(shares).max() < _NOTHING:
                break
        left[rows] = now
    return left


def _damped_step(jacobian: Array, left: Array, damping: float) -> Array:
    """Shares of the parameters, (p,), that take away most of what is left, (n,), if they are small."""
    held = np.sqrt(damping) * np.diag(np.linalg.norm(jacobian, axis=0))
    target = np.concatenate([left, np.zeros(len(held))])
    step: Array = np.linalg.lstsq(np.concatenate([jacobian, held]), target, _RANK)[0]
    return step


def _log_counts(place: Place) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.log(place.counts(place.step_size()))


def _scaled(place: Place, shares: Array) -> Place:
    """With each parameter times a share of its own in each row, (n, p)."""
    named = zip(place.values.items(), shares.T, strict=True)
    return replace(place, values={name: value * share[:, None] for (name, value), share in named})


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
