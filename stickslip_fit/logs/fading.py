"""What rows add to something that fades with time, and what follows something late: each in one pass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, Int64Array

NEGLIGIBLE = 1e-9  # share of what a row adds itself, below which the rest is rounding
BLOCK_SCALES = 300.0  # time constants that are summed at once


@dataclass(frozen=True, eq=False)
class Fading:
    """Rows in the order of time, and the time constant with which what they add to their group fades.

    Attributes
    ----------
    seconds : array, shape (n,)
        When each row is, from 0 on.
    group : array of int, shape (n,)
    scale : float
        Time constant, s.
    """

    seconds: Array
    group: Int64Array
    scale: float

    def sum_before(self, added: Array) -> Array:
        """Sums of what all earlier rows of the group have added, each times exp(-age / scale), shape (n,).

        As what is driven warms a joint that cools in pauses.

        Examples
        --------
        >>> Fading(np.array([0.0, 60.0, 120.0]), np.zeros(3, int), 60.0).sum_before(np.ones(3)).round(3)
        array([0.   , 0.368, 0.503])
        """
        sums = self._sum(added) - added
        return np.where(np.abs(sums) < NEGLIGIBLE * np.abs(added), 0.0, sums)

    def follow(self, values: Array) -> Array:
        """Values behind a low-pass filter of the first order, at rest as each group begins, shape (n,).

        As the temperature of a body of one time constant follows that of the room. Values are linear between
        rows; a missing one is the one before.

        Examples
        --------
        >>> late = Fading(np.array([0.0, 60.0, 120.0]), np.zeros(3, int), 60.0)
        >>> late.follow(np.array([0.0, 1.0, 1.0])).round(3)
        array([0.   , 0.368, 0.767])
        """
        known = values
        if not np.isfinite(values).all():
            known = pd.Series(values).groupby(self.group).ffill().to_numpy()
        rises = np.nan_to_num(known - known[self._before])  # the first known one is no rise
        return np.asarray(known - self._sum(rises * self._rise))

    @cached_property
    def _before(self) -> Int64Array:
        """The row before each row of its group; of the first any other."""
        return previous_rows(self.group)

    @cached_property
    def _rise(self) -> Array:
        """Share of a rise since the row before by which a follower is behind, 0 of a group's first row."""
        passed = (self.seconds - self.seconds[self._before]) / self.scale
        passed = np.maximum(passed, np.finfo(float).tiny)
        return np.where(self._before >= 0, -np.expm1(-passed) / passed, 0.0)

    @cached_property
    def _blocks(self) -> tuple[Int64Array, Array]:
        """Blocks of each group, as exponentials of long times are no numbers; and the growth in each."""
        block, since = np.divmod(self.seconds, BLOCK_SCALES * self.scale)
        number = self.group * (int(block.max(initial=0)) + 1) + block.astype(np.int64)
        return number, np.exp(since / self.scale)

    def _sum_blocks(self, added: Array) -> Array:
        blocks, growth = self._blocks
        return pd.Series(added * growth).groupby(blocks, sort=False).cumsum().to_numpy() / growth

    def _sum(self, added: Array) -> Array:
        """As `sum_before`, with what each row adds itself."""
        sums, blocks = self._sum_blocks(added), self._blocks[0]
        begins = np.flatnonzero((self._before >= 0) & (blocks != blocks[self._before]))
        if len(begins):  # of what a block has added, nothing is left two blocks later
            left, last = np.zeros_like(sums), self._before[begins]
            left[begins] = sums[last] * np.exp((self.seconds[last] - self.seconds[begins]) / self.scale)
            sums += self._sum_blocks(left)
        return np.asarray(sums)


def previous_rows(group: Int64Array) -> Int64Array:
    """Index of the previous row in the same group, -1 for a group's first.

    Examples
    --------
    >>> previous_rows(np.array([7, 7, 2, 7, 2]))
    array([-1,  0, -1,  1,  2])
    """
    order = np.argsort(group, kind="stable")
    same = group[order[1:]] == group[order[:-1]]
    before = np.full(len(group), -1)
    before[order[1:][same]] = order[:-1][same]
    return before
