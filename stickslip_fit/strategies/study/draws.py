"""What is left to chance in a campaign; every campaign draws from streams of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.repeatability import CONFIGURATION
from stickslip_fit.logs.plan import Plan
from stickslip_fit.simulate.chance import draw_chance
from stickslip_fit.simulate.simulate import GROUPS
from stickslip_fit.strategies.study.plan import Scenario, StudyPlan

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

FARTHEST = 3.0  # standard deviations; a law that stalls once in a thousand campaigns would stop a study
MOST_PARAMETERS = 4  # of a published law
UNEVEN = (1.0, 2.0)
COUNTS, LAWS, MOVES = range(3)


@dataclass(frozen=True, eq=False)
class Draws:
    """The draws of C campaigns of S sessions and n traverses.

    Attributes
    ----------
    day : array, shape (C, S, groups)
        See `Chance`.
    noise, wait : array, shape (C, n)
        Departures of log(steps), of standard deviation 1, and how long a person takes.
    luck : array, shape (C, n, 3)
    law : array, shape (C, S + 1, groups, parameters)
        How far each parameter lies from its usual value: first the campaign's, then each session's.
    """

    day: Array
    noise: Array
    wait: Array
    luck: Array
    law: Array


def draw(study: StudyPlan, scenario: Scenario, campaigns: Sequence[int]) -> Draws:
    """The draws of campaigns by number; the same whatever other campaigns are drawn beside them."""
    uneven = _uneven(study.plan) if study.scatter == "uneven" else None
    each = [_draw_one(study, scenario, number, uneven) for number in campaigns]
    return Draws(*(np.stack(parts) for parts in zip(*each, strict=True)))


def nothing_drawn(plan: Plan) -> Draws:
    """One campaign in which everything is as usual."""
    sessions, n = len(plan.sessions), len(plan.sessions) * plan.traverses_per_session
    return Draws(
        np.zeros((1, sessions, len(GROUPS))), np.zeros((1, n)), np.full((1, n), 0.5), np.full((1, n, 3), 0.5),
        np.zeros((1, sessions + 1, len(GROUPS), MOST_PARAMETERS)),
    )  # fmt: skip


def streams(study: StudyPlan, scenario: Scenario, number: int, kind: int) -> np.random.SeedSequence:
    """Where a campaign's chance comes from, one for each kind of it."""
    return np.random.SeedSequence([study.seed, crc32(scenario.name.encode()), number, kind])


def seed_of(study: StudyPlan, scenario: Scenario, number: int) -> int:
    """The seed with which `simulate` draws the same scatter, days and pauses as a campaign of a study."""
    return int(streams(study, scenario, number, COUNTS).generate_state(1, np.uint64)[0])


def _draw_one(
    study: StudyPlan, scenario: Scenario, number: int, uneven: tuple[Indices, Indices] | None
) -> tuple[Array, ...]:
    sessions, traverses = len(study.plan.sessions), study.plan.traverses_per_session
    chance = draw_chance(seed_of(study, scenario, number), sessions, traverses, len(GROUPS), study.kind)
    rng = np.random.default_rng(streams(study, scenario, number, LAWS))
    drawn = rng.standard_normal((sessions + 1, len(GROUPS), MOST_PARAMETERS))
    law = np.clip(drawn, -FARTHEST, FARTHEST)
    noise = chance.noise if uneven is None else chance.noise * _scatters(*uneven, rng)
    return chance.day, noise, chance.wait, chance.luck, law


def _uneven(plan: Plan) -> tuple[Indices, Indices]:
    """Of each row, its configuration, whatever the session, and its joint and direction."""
    rows = plan.rows()
    alike = rows[[name for name in CONFIGURATION if name != "session"]].round(9).assign(joint=rows["joint"])
    place = alike.groupby(list(alike), dropna=False, sort=False).ngroup().to_numpy()
    drive = alike.groupby(["joint", "direction"], sort=False).ngroup().to_numpy()
    return place, drive


def _scatters(place: Indices, drive: Indices, rng: np.random.Generator) -> Array:
    """Factors of the scatter, shape (n,), whose squares have mean 1 in each joint and direction."""
    factor = rng.uniform(*UNEVEN, place.max() + 1)[place]
    square = np.bincount(drive, factor**2) / np.bincount(drive)
    return factor / np.sqrt(square)[drive]
