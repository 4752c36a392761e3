"""Logs in which nothing is hidden but gross errors: counts doubled or halved."""

from dataclasses import replace

import numpy as np

from tests.hidden.designs import Ints
from tests.hidden.generate import CHECK_EVERY, Hidden, hide
from tests.hidden.noise import KINDS

SIZES = {"small": ("session",), "campaign": ("thesis", "many")}


def spoil(hidden: Hidden, rows: Ints, factors: float | np.ndarray = 2.0) -> Hidden:
    """The log with the counts of some rows multiplied, to a multiple of the steps between two checks."""
    steps = hidden.table["steps"].to_numpy().copy()
    steps[rows] = CHECK_EVERY * np.round(steps[rows] * factors / CHECK_EVERY)
    return replace(hidden, table=hidden.table.assign(steps=steps))


def make_gross(size: str, rate: float, seed: int) -> tuple[Hidden, Ints]:
    """A log of this size with gross errors at this rate, at least one unless it is 0; and their rows."""
    design = SIZES[size][seed % len(SIZES[size])]
    hidden = hide(design, noise=KINDS[(seed // 2) % len(KINDS)], seed=seed)
    rng = np.random.default_rng([seed, 9])
    rows = np.flatnonzero(rng.random(len(hidden.table)) < rate)
    rows = rows if len(rows) or not rate else rng.integers(len(hidden.table), size=1)
    return spoil(hidden, rows, rng.choice([2.0, 0.5], len(rows))), rows
