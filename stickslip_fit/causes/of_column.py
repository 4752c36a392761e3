"""Causes that follow one column of the log: a factor linear in its departure from its mean."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, FactorCause, filled, missing_column
from stickslip_fit.laws import State
from stickslip_fit.machine import Machine


@dataclass(frozen=True)
class OfColumn(FactorCause):
    """gamma times 1 + k (x - mean x).

    Attributes
    ----------
    mean : float
        Of the column over the log.
    """

    mean: float = 0.0

    column: ClassVar[str]
    called: ClassVar[str]
    plausible: ClassVar[float]
    absent = (0.0,)

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        return replace(self, mean=float(np.nanmean(rows[self.column].to_numpy(float))))

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        return missing_column(rows, self.column, self.called)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (self.plausible / 10,)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([self.plausible]),)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        return 1.0 + values[0] * self.departure(state)

    def departure(self, state: State) -> Array:
        """How far the column is from its mean, shape (n, 1)."""
        return filled(state.column(self.column), self.mean) - self.mean
