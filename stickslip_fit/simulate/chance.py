"""Everything in a simulated campaign that is left to chance, session by session."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from stickslip_fit.logs.plan import NoiseKind

Array = npt.NDArray[np.float64]
FREEDOM = 5


@dataclass(frozen=True)
class Chance:
    """The draws for a whole campaign of n traverses.

    Attributes
    ----------
    day : array, shape (sessions, groups)
        How far each group's step size is from its usual one that day; mean 0, standard deviation 1.
    noise : array, shape (n,)
        Departures of log(steps); mean 0, standard deviation 1.
    wait : array, shape (n,)
        How long a person takes before each traverse, uniform between 0 and 1.
    luck : array, shape (n, 3)
        Whether a stop is missed or imagined, and by how much, uniform between 0 and 1.
    """

    day: Array
    noise: Array
    wait: Array
    luck: Array


def draw_chance(seed: int, sessions: int, traverses: int, groups: int, kind: NoiseKind) -> Chance:
    """Draw for every session from streams of its own, so that adding a session changes no other.

    Parameters
    ----------
    seed : int
    sessions, traverses, groups : int
        Number of sessions, of traverses in each, and of groups of traverses that share a law.
    kind : {'gaussian', 't5'}

    Examples
    --------
    >>> two, three = (draw_chance(7, sessions, 100, 6, "t5") for sessions in (2, 3))
    >>> bool(np.all(three.noise[:200] == two.noise))
    True
    """
    streams = np.random.SeedSequence(seed).spawn(sessions)
    draws = [_draw_session(stream, traverses, groups, kind) for stream in streams]
    days, *others = zip(*draws, strict=True)
    return Chance(np.stack(days), *map(np.concatenate, others))


def _draw_session(
    stream: np.random.SeedSequence, traverses: int, groups: int, kind: NoiseKind
) -> tuple[Array, Array, Array, Array]:
    day, noise, wait, luck = (np.random.default_rng(child) for child in stream.spawn(4))
    departures = draw_noise(kind, traverses, noise)
    return day.standard_normal(groups), departures, wait.random(traverses), luck.random((traverses, 3))


def draw_noise(kind: NoiseKind, size: int, rng: np.random.Generator) -> Array:
    """Independent departures with mean 0 and standard deviation 1, shape (size,).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> [round(float(draw_noise(kind, 100_000, rng).std()), 1) for kind in ("gaussian", "t5")]
    [1.0, 1.0]
    """
    if kind == "t5":
        return rng.standard_t(FREEDOM, size) * sqrt((FREEDOM - 2) / FREEDOM)
    return rng.standard_normal(size)
