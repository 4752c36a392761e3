"""The noise of a log: in `KINDS` nothing is wrong; `OTHER_KINDS` are what noise should not be.

Of the others: memory is an AR(1) of 0.5 from traverse to traverse of a session; skewed noise is log-normal,
its long tail above or below; places, configurations and sessions have noise five times as large in a third of
each joint's travel, in a tenth of the configurations, or in one session; rounded counts are multiples of 50.
"""

from math import exp, sqrt

import numpy as np

from tests.hidden.designs import Plan
from tests.hidden.physics import DEG, FULL, MM, Array

KINDS = ("gaussian", "t5", "uneven")
OTHER_KINDS = ("memory", "skewed", "rounded", "places", "configurations", "sessions")
MEMORY, TIMES, COARSE = 0.5, 5.0, 50
LOG_NORMAL_SDS = (0.5, 0.75, 1.0)  # skewness 1.8, 3.3, 6.2


def repeatability(plan: Plan, kind: str, rng: np.random.Generator) -> Array:
    """Standard deviation of each traverse's log count, by joint and direction, shape (n,)."""
    levels = rng.uniform(0.0025, 0.0035, (4, 2))
    configuration = plan.configuration()
    noisy = rng.random(int(configuration.max()) + 1) < (0.1 if kind == "configurations" else 0.3)
    spread = levels[plan.joint, (plan.forward > 0).astype(int)]
    if kind == "uneven":
        return spread * (1 + noisy[configuration])
    if kind == "configurations":
        return spread * np.where(noisy[configuration], TIMES, 1.0)
    if kind == "sessions":
        return spread * np.where(plan.session == rng.integers(int(plan.session.max()) + 1), TIMES, 1.0)
    if kind == "places":
        return spread * np.sqrt(1.0 + (TIMES**2 - 1.0) * _share_of_a_third(plan, rng))
    return spread


def _share_of_a_third(plan: Plan, rng: np.random.Generator) -> Array:
    """Share of each traverse in one third of its joint's travel."""
    low, high = plan.settings[:, 5], plan.settings[:, 6]
    share = np.zeros(len(plan.joint))
    for joint in (1, 2, 3):
        begin, end = (each / (MM if joint == 3 else DEG) for each in FULL[joint])
        first = begin + rng.uniform(0, 2 / 3) * (end - begin)
        inside = np.minimum(high, first + (end - begin) / 3) - np.maximum(low, first)
        share = np.where(plan.joint == joint, np.maximum(inside, 0.0) / (high - low), share)
    return share


def innovations(kind: str, plan: Plan, rng: np.random.Generator) -> Array:
    """Draws with mean 0 and variance 1, one for each traverse; independent but for memory, shape (n,)."""
    if kind not in (*KINDS, *OTHER_KINDS):
        raise ValueError(f"there is no noise {kind!r}; choose from {(*KINDS, *OTHER_KINDS)}")
    size = len(plan.joint)
    if kind == "t5":
        return rng.standard_t(5, size) * sqrt(3 / 5)
    if kind == "skewed":
        sd, sign = rng.choice(LOG_NORMAL_SDS), rng.choice([-1, 1])
        drawn = rng.lognormal(0.0, sd, size) - exp(sd**2 / 2)
        return sign * drawn / sqrt((exp(sd**2) - 1) * exp(sd**2))
    drawn = rng.standard_normal(size)
    if kind == "memory":
        for row in np.flatnonzero(np.diff(plan.session) == 0) + 1:
            drawn[row] = MEMORY * drawn[row - 1] + sqrt(1 - MEMORY**2) * drawn[row]
    return drawn


def seen(counts: Array, check_every: int) -> Array:
    """Counts as the end stop shows them: the first check at or after it."""
    return check_every * np.ceil(counts / check_every)


def written(steps: Array, kind: str) -> Array:
    """Counts as they are written down."""
    return COARSE * np.round(steps / COARSE) if kind == "rounded" else steps
