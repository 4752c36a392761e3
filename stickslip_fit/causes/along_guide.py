"""Causes by which the guide is not the same all along."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, FactorCause, Row
from stickslip_fit.laws import Configuration, ConstantStep, State, StepLaw
from stickslip_fit.machine import PRISMATIC


class AlongGuide(FactorCause):
    """gamma times a factor that depends on the place along the guide alone."""

    joints = (PRISMATIC,)
    along = True

    @abstractmethod
    def profile(self, position: Array, values: list[Array]) -> Array:
        """The factor at places along the guide, m, shape (n, k)."""

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return self.profile(state.position, values)

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        mine = rows[rows["joint"].isin(self.joints)]
        ends = np.sort(mine[["start", "stop"]].to_numpy(float), axis=1).round(7)
        if len(mine) and len(np.unique(ends, axis=0)) < 2:
            return "every prismatic traverse runs the whole guide"
        return super().missing(rows)

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: where nothing else changes along the guide, each stretch is done once."""
        from stickslip_fit.causes.extended import ExtendedLaw

        if isinstance(law, ExtendedLaw):
            return super().changes(law, rows, values, trials)
        ends = np.stack([np.asarray(rows[end], dtype=float) for end in ("start", "stop")], axis=-1)
        stretches, which = np.unique(ends, axis=0, return_inverse=True)
        even = ConstantStep(PRISMATIC, Configuration("anywhere"))
        once = dict(zip(("start", "stop"), stretches.T, strict=True))
        return Cause.changes(self, even, once, np.ones((len(stretches), 1)), trials)[which.ravel()]
