"""What drags of any kind have in common: they may be far from a small departure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnosis.linearized import LawBlock, fit_extended
from tests.balls.cause import Array, FallCause
from tests.balls.fall import Fall, Rows

LET_GO = 4.0  # m/s; no ball is released faster, whatever the nearest parabola says
ROUNDS, APART = 4, 0.01  # of a fit, and m/s for its slopes


@dataclass(frozen=True)
class Drag(FallCause):
    """Strong drag gives a fall another shape than weak drag, and is looked for at the size that fits best."""

    moves = True

    def trials(self, rows: pd.DataFrame) -> list[tuple[FallCause, Array]]:
        drop, height = pd.factorize(rows["session"])[0].astype(np.intp), rows["height"].to_numpy(float)
        start = np.column_stack([height[np.unique(drop, return_index=True)[1]][drop], np.zeros(len(rows))])
        part = LawBlock(Fall(), np.arange(len(rows)), drop, start)
        found = fit_extended(rows, [part], height, np.ones(len(rows)), [self], np.array(self.scale))
        return [(self, np.maximum(found.values, self.tried)[None])]

    def changes(self, law: Fall, rows: Rows, values: Array, trials: Array) -> Array:
        """By how much the falls nearest to what was measured differ, with each trial and without it.

        Under strong drag height and velocity at release act otherwise than in free fall, and linearised
        about the nearest parabola they would not absorb what they can: they are fitted anew.
        """
        extended, here = self.extend(law), law.predict(rows, values)
        return np.stack([_nearest(extended, rows, values, trial) for trial in trials], axis=1) - here[:, None]


def _nearest(law: Fall, rows: Rows, values: Array, sizes: Array) -> Array:
    """The fall nearest to what was measured, the causes' values being given, shape (n,)."""
    _, drop = np.unique(np.asarray(rows["session"], dtype=str), return_inverse=True)
    both = np.concatenate([values, np.tile(sizes, (len(values), 1))], axis=1)
    both[:, 1] = np.clip(both[:, 1], -LET_GO, LET_GO)
    here = law.predict(rows, both)
    for _ in range(ROUNDS):
        faster = both.copy()
        faster[:, 1] += APART
        slope = (law.predict(rows, faster) - here) / APART
        higher, quicker = _line(drop, slope, np.asarray(rows["height"], float) - here)
        both[:, 0] += higher
        both[:, 1] = np.clip(both[:, 1] + quicker, -LET_GO, LET_GO)
        here = law.predict(rows, both)
    return here


def _line(group: npt.NDArray[np.intp], x: Array, y: Array) -> tuple[Array, Array]:
    """Offset and slope of the straight line through each group's points, at each of them, shape (n,)."""

    def mean(values: Array) -> Array:
        return (np.bincount(group, values) / np.bincount(group))[group]

    off = x - mean(x)
    slope = mean(off * y) / mean(off**2)
    return mean(y) - slope * mean(x), slope
