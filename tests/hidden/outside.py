"""Logs with an effect from outside the library of causes, and what its true form saves on a fresh replicate.

>>> one = cases((12.0,))[0]
>>> log, fresh = one.make(), one.make(replicate=1)
>>> saving = rms(fresh, baseline(log)) - rms(fresh, true_form(log, fresh))
>>> round(100 * saving, 2)  # % of the step size
0.03
"""

from dataclasses import dataclass

import numpy as np

from tests.hidden.catalogue import OUTSIDE_SETS
from tests.hidden.effect import change
from tests.hidden.generate import CHECK_EVERY, Hidden, UnreachableError, hide
from tests.hidden.physics import Array
from tests.hidden.strength import recalibrations
from tests.hidden.study import DESIGNS, NOISES

ANOTHER_SEED, MAX_TRIES = 100_000, 30


@dataclass(frozen=True)
class OutsideCase:
    """A log to make, with one effect of `OUTSIDE_SETS`."""

    name: str
    form: str
    design: str
    noise: str
    strength: float
    seed: int

    def make(self, replicate: int = 0) -> Hidden:
        """The log; another `replicate` is the same campaign measured again."""
        forms = {self.name: self.form}
        return hide(
            self.design, (self.name,), self.strength, self.noise, (), self.seed, forms, replicate=replicate
        )

    @property
    def plausible(self) -> bool:
        """Whether the effect can be as strong in this log at a plausible size."""
        try:
            (effect,) = self.make().truth["effects"]
        except UnreachableError:
            return False
        return bool(effect["share_of_largest"] <= 1)


def cases(strengths: tuple[float, ...], first: int = 0, number: int = 1) -> list[OutsideCase]:
    """One for each effect of a set and each strength, over designs and noises in turn.

    An effect that is not plausible at the strength in a design takes the next design, then other seeds.
    """
    found = []
    pairs = [(name, form) for name, forms in OUTSIDE_SETS[number].items() for form in forms]
    for place, (name, form) in enumerate(pairs):
        for strength in strengths:
            tries = (
                OutsideCase(
                    name, form, DESIGNS[(place + turn) % 3], NOISES[(place // 3) % 3], strength,
                    first + place + ANOTHER_SEED * (turn // 3),
                )
                for turn in range(MAX_TRIES)
            )  # fmt: skip
            found.append(next(each for each in tries if each.plausible))
    return found


def log_counts(hidden: Hidden) -> Array:
    """Logarithms of the counts that stand in the middle between checks, shape (n,)."""
    return np.log(hidden.table["steps"].to_numpy() - CHECK_EVERY / 2)


def baseline(hidden: Hidden) -> Array:
    """The published laws recalibrated on a log: logarithms of its counts, shape (n,)."""
    return _predict(hidden, np.zeros(len(hidden.campaign)), np.zeros(len(hidden.campaign)))


def true_form(hidden: Hidden, fresh: Hidden) -> Array:
    """The same with the true form of its effect, whose size is fitted: for a fresh replicate, shape (n,)."""
    (act,), (again,) = hidden.acts, fresh.acts
    return _predict(hidden, hidden.effect(act.name), change(fresh.campaign, again.effect, act.size))


def _predict(hidden: Hidden, shape: Array, fresh_shape: Array) -> Array:
    """By least squares, rows weighted by their true repeatability."""
    weight = 1 / hidden.campaign.repeatability
    directions = recalibrations(hidden.campaign, weight)
    y = (log_counts(hidden) - np.log(hidden.campaign.counts)) * weight
    left = shape * weight - directions @ (directions.T @ (shape * weight))
    size = float(left @ y) / (float(left @ left) or 1.0)
    calibrated = directions @ (directions.T @ (y - size * shape * weight)) / weight
    return np.log(hidden.campaign.counts) + calibrated + size * fresh_shape


def rms(hidden: Hidden, predicted: Array) -> float:
    """Rms error of predicted logarithms of a log's counts."""
    return float(np.sqrt(np.mean((log_counts(hidden) - predicted) ** 2)))
