"""A campaign on which nothing acts yet: plan, true laws, expected counts, clock, history and noise."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tests.hidden.conditions import conditions
from tests.hidden.designs import DESIGNS, Ints, Plan
from tests.hidden.noise import innovations, repeatability
from tests.hidden.physics import Array, Place, place
from tests.hidden.seeds import stream
from tests.hidden.truth import draw_truth

_FIRST_DAY = np.datetime64("2012-03-05T00:00:00")


@dataclass(frozen=True)
class Campaign:
    """One row per traverse in order of time; SI, but for the columns as the lab writes them."""

    plan: Plan
    places: tuple[Place, ...]
    counts: Array  # expected of the published laws
    time: np.ndarray
    hours: Array  # since the session's first traverse
    columns: Mapping[str, Array]
    before: Ints  # the same joint's traverse before in the session, -1 for the first
    steps_before: Array  # the joint's own, expected, in the whole log
    repeatability: Array
    innovations: Array

    def __len__(self) -> int:
        return len(self.counts)

    def previous(self, column: Array, first: float = 0.0) -> Array:
        """What a column was at the traverse before."""
        return np.where(self.before >= 0, column[self.before], first)

    @property
    def labels(self) -> list[str]:
        """What each traverse's session is called: the day it began."""
        first = np.searchsorted(self.plan.session, self.plan.session)
        return [str(day) for day in self.time[first].astype("datetime64[D]")]

    @property
    def load(self) -> Array:
        """Published load averaged over each traverse."""
        load = np.zeros(len(self))
        for each in self.places:
            load[each.rows] = each.mean_load()
        return load


class Nature(Protocol):
    """What the step size really is, where it is not a published law."""

    def draw(self, joint: int, session: Ints, forward: Ints, rng: np.random.Generator) -> dict[str, Array]:
        """What it depends on, at each traverse."""
        ...

    def pace(self, place: Place) -> Array:
        """Step size at the nodes of traverses."""
        ...


def make_campaign(
    design: str, noise: str, seed: int, replicate: int = 0, nature: Nature | None = None
) -> Campaign:
    """Draw a campaign; another `replicate` differs in its noise alone."""
    if design not in DESIGNS:
        raise ValueError(f"there is no design {design!r}; choose from {tuple(DESIGNS)}")
    plan = DESIGNS[design](stream(seed, "plan"))
    places = _places(plan, seed, nature)
    counts = np.empty(len(plan.joint))
    for each in places:
        counts[each.rows] = each.counts(each.step_size())
    seconds = _seconds(plan, counts, stream(seed, "pauses"))
    begin = 8.5 + stream(seed, "mornings").uniform(-0.5, 1.5, int(plan.session.max()) + 1)
    begin_seconds = np.round(3600 * begin).astype(np.int64)[plan.session]
    since_midnight = begin_seconds + seconds
    hours = seconds / 3600
    return Campaign(
        plan=plan,
        places=places,
        counts=counts,
        time=_FIRST_DAY + 86400 * plan.days[plan.session] + since_midnight,
        hours=hours,
        columns=conditions(plan, hours, since_midnight / 3600, stream(seed, "room")),
        before=_before(plan),
        steps_before=_steps_before(plan.joint, counts),
        repeatability=repeatability(plan, noise, stream(seed, "repeatability")),
        innovations=innovations(noise, plan, stream(seed, f"noise {replicate}")),
    )


def _places(plan: Plan, seed: int, nature: Nature | None) -> tuple[Place, ...]:
    positions, places = plan.positions(), []
    for joint in (1, 2, 3):
        rows = np.flatnonzero(plan.joint == joint)
        forward = plan.forward[rows]
        draw, pace = (draw_truth, None) if nature is None else (nature.draw, nature.pace)
        values = draw(joint, plan.session[rows], forward, stream(seed, f"truth {joint}"))
        subset = {name: column[rows] for name, column in positions.items()}
        places.append(place(joint, rows, subset, values, forward.astype(float), pace))
    return tuple(places)


def _seconds(plan: Plan, counts: Array, rng: np.random.Generator) -> Ints:
    """Whole seconds since the session began: what the steps take, and half a minute or more in between."""
    takes = np.ceil(counts * plan.step_period + rng.uniform(30, 90, len(counts))).astype(np.int64)
    elapsed = np.cumsum(takes) - takes
    first = np.searchsorted(plan.session, np.arange(int(plan.session.max()) + 1))
    return elapsed - elapsed[first][plan.session]


def _before(plan: Plan) -> Ints:
    before = np.full(len(plan.joint), -1)
    for joint in (1, 2, 3):
        subset = np.flatnonzero(plan.joint == joint)
        same = plan.session[subset[1:]] == plan.session[subset[:-1]]
        before[subset[1:][same]] = subset[:-1][same]
    return before


def _steps_before(joint: Ints, counts: Array) -> Array:
    driven = np.zeros(len(joint))
    for each in (1, 2, 3):
        subset = joint == each
        driven[subset] = np.cumsum(counts[subset]) - counts[subset]
    return driven
