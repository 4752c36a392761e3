"""A hidden effect: which stage of the making of a count it acts on, and how large it may plausibly be.

A count is made in stages: state -> law -> plus terms -> times factors -> integral -> plus counts. An effect
acts on one of them, rarely on two; at size 0 it acts on nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.hidden.campaign import Campaign
from tests.hidden.physics import Array, Place

Said = list[dict[str, object]]


def no_state(place: Place, size: float) -> Place:
    return place


def no_term(place: Place, size: float) -> Array | float:
    return 0.0


def no_factor(place: Place, size: float) -> Array | float:
    return 1.0


def no_count(campaign: Campaign, counts: Array, size: float) -> Array:
    return counts


@dataclass(frozen=True)
class Effect:
    """One effect in one form, its shape settled, its size open.

    Attributes
    ----------
    largest : float
        Largest plausible size, by conservative physics.
    said : callable
        Its parameters at a size, in people's units, as a truth to compare with: name, unit, value.
    state, term, factor, count : callable
        What it does at each stage.
    either_sign : bool
        Whether nature may have it the other way round.
    smallest : float
        Below this size it is not what its name says.
    absorbed : bool
        Whether how large it is said to be is what a recalibration of the baseline leaves of it.
    cause : str
        What the diagnosis should call it, where that is not the effect's own name.
    """

    largest: float
    said: Callable[[float], Said]
    state: Callable[[Place, float], Place] = no_state
    term: Callable[[Place, float], Array | float] = no_term
    factor: Callable[[Place, float], Array | float] = no_factor
    count: Callable[[Campaign, Array, float], Array] = no_count
    either_sign: bool = True
    smallest: float = 0.0
    absorbed: bool = True
    cause: str = ""

    def reversed(self) -> Effect:
        """The same effect the other way round."""
        return replace(
            self,
            said=lambda size: self.said(-size),
            state=lambda place, size: self.state(place, -size),
            term=lambda place, size: self.term(place, -size),
            factor=lambda place, size: self.factor(place, -size),
            count=lambda campaign, counts, size: self.count(campaign, counts, -size),
        )


Maker = Callable[[Campaign, np.random.Generator], Effect | None]


def expected(campaign: Campaign, hidden: Sequence[tuple[Effect, float]]) -> Array:
    """Counts with effects of these sizes at work; NaN where a joint would come to a halt."""
    counts = np.empty(len(campaign))
    for place in campaign.places:
        for effect, size in hidden:
            place = effect.state(place, size)
        pace = place.step_size()
        pace = pace + sum(effect.term(place, size) for effect, size in hidden)
        for effect, size in hidden:
            pace = pace * effect.factor(place, size)
        counts[place.rows] = place.counts(pace)
    for effect, size in hidden:
        counts = effect.count(campaign, counts, size)
    return np.where(counts > 0, counts, np.nan)


def change(campaign: Campaign, effect: Effect, size: float) -> Array:
    """What one effect alone does to the logarithm of each count, shape (n,)."""
    return np.log(expected(campaign, [(effect, size)]) / campaign.counts)


def say(*parameters: tuple[str, str, float]) -> Said:
    """Parameters as a truth holds them."""
    return [{"name": name, "unit": unit, "value": float(value)} for name, unit, value in parameters]


def by_row(column: Array) -> Callable[[Place, float], Array]:
    """A factor 1 + size * column, one value for each traverse of the log."""
    return lambda place, size: 1 + size * place.of(column)


def sized(name: str, unit: str, per: float, *others: tuple[str, str, float]) -> Callable[[float], Said]:
    """Say the size under this name in this unit, and the shape beside it."""
    return lambda size: say((name, unit, per * size), *others)


def sized_since(name: str, campaign: Campaign, first: int) -> Callable[[float], Said]:
    """Say the size in per cent, and from which row's moment on it acts."""
    moment = say(("moment", "min", 60 * campaign.hours[first]))[0] | {"session": campaign.labels[first]}
    return lambda size: [*say((name, "%", 100 * size)), moment]
