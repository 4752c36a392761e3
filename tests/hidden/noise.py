"""Noise in which nothing is wrong: Gaussian, heavy in the tails, or uneven between configurations."""

from __future__ import annotations

from math import sqrt

import numpy as np

from tests.hidden.designs import Plan
from tests.hidden.physics import Array

KINDS = ("gaussian", "t5", "uneven")


def repeatability(plan: Plan, kind: str, rng: np.random.Generator) -> Array:
    """Standard deviation of each traverse's log count, by joint and direction, shape (n,)."""
    levels = rng.uniform(0.0025, 0.0035, (4, 2))
    noisy = rng.random(int(plan.configuration().max()) + 1) < 0.3
    spread = levels[plan.joint, (plan.forward > 0).astype(int)]
    return spread * (1 + noisy[plan.configuration()]) if kind == "uneven" else spread


def innovations(kind: str, size: int, rng: np.random.Generator) -> Array:
    """Independent draws with mean 0 and variance 1, shape (size,)."""
    if kind not in KINDS:
        raise ValueError(f"there is no noise {kind!r}; choose from {KINDS}")
    if kind == "t5":
        return rng.standard_t(5, size) * sqrt(3 / 5)
    return rng.standard_normal(size)


def seen(counts: Array, check_every: int) -> Array:
    """Counts as the end stop shows them: the first check at or after it."""
    return check_every * np.ceil(counts / check_every)
