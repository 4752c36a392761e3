"""Logs in which the step size differs from place to place along one joint's own travel."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.hidden.campaign import make_campaign
from tests.hidden.effect import Effect, expected, sized
from tests.hidden.generate import CHECK_EVERY
from tests.hidden.noise import seen
from tests.hidden.physics import FULL, Array, Place
from tests.hidden.table import write_down

N_KNOTS = 6

Profile = Callable[[Array, Array], Array]
"""Relative step size, its mean over the travel 0, at shares of the travel and directions 1 or -1."""


def draw_profile(rng: np.random.Generator, rms: float, by_direction: bool) -> Profile:
    """Random heights at equal distances along the travel, joined by a Catmull-Rom spline."""
    grid, curves = np.linspace(0.0, 1.0, 1001), {}
    for sign in (1, -1):
        heights = rng.standard_normal(N_KNOTS)
        curve = _interpolate(grid, heights)
        curves[sign] = heights, float(curve.mean()), rms / float(curve.std())

    def profile(share: Array, forward: Array) -> Array:
        up, down = (
            size * (_interpolate(np.clip(share, 0.0, 1.0), heights) - mean)
            for heights, mean, size in curves.values()
        )
        return np.where(forward > 0, up, down) if by_direction else up

    return profile


def write_profile_log(path: Path, joint: int, profile: Profile, *, seed: int, design: str = "many") -> int:
    """Write a log with this profile of a joint in it; the number of its rows."""
    campaign, (low, high) = make_campaign(design, "gaussian", seed), FULL[joint]

    def factor(place: Place, size: float) -> Array | float:
        if place.joint != joint:
            return 1.0
        return 1.0 + size * profile((place.own - low) / (high - low), place.forward)

    effect = Effect(1.0, sized("rms", "%", 100), factor=factor)
    counts = expected(campaign, [(effect, 1.0)])
    steps = seen(counts * np.exp(campaign.repeatability * campaign.innovations), CHECK_EVERY)
    write_down(campaign, steps.astype(np.int64), {}).to_csv(path, index=False)
    return len(campaign)


def _interpolate(share: Array, heights: Array) -> Array:
    """Catmull-Rom interpolation of heights at equal distances."""
    padded = np.concatenate([heights[:1], heights, heights[-1:]])
    place = np.minimum((share * (len(heights) - 1)).astype(int), len(heights) - 2)
    t = share * (len(heights) - 1) - place
    before, one, two, after = (padded[place + k] for k in range(4))
    slope, bend = (two - before) / 2, before - 2.5 * one + 2 * two - after / 2
    return one + t * (slope + t * (bend + t * ((after - before) / 2 + 1.5 * (one - two))))
