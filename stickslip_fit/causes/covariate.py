"""A column that the lab logged explains it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, FactorCause, filled, missing_column
from stickslip_fit.laws import State
from stickslip_fit.logs.columns import COVARIATE
from stickslip_fit.machine import Machine

ORDER = 3


@dataclass(frozen=True)
class Covariate(FactorCause):
    """gamma times 1 + f(column), f a polynomial over the log's range and constant beyond; 0 at the mean.

    Attributes
    ----------
    column : str
        The lab's own name of it.
    mean, low, high : float
        Over the log.
    """

    column: str = ""
    mean: float = 0.0
    low: float = -1.0
    high: float = 1.0

    phrase = "steps follow a column that the lab logged"
    physics = "Whatever the column stands for; the log alone shows that the step size follows it smoothly."
    shows_best = "one configuration at the lowest and at the highest values of the column"
    parameters = tuple(
        CauseParameter(f"f{order}", "%", f"Chebyshev coefficient {order} over the column's range")
        for order in range(1, ORDER + 1)
    )
    absent = (0.0,) * ORDER
    joined = True
    scale = (0.01,) * ORDER

    @property
    def name(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return COVARIATE + self.column

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (self.name,)

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        values = rows[self.name].astype(float)
        return replace(self, mean=float(values.mean()), low=float(values.min()), high=float(values.max()))

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        return missing_column(rows, self.name, f"column {self.column}")

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(self, 0.01 * np.eye(ORDER))]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([0.1, 0.0, 0.0]),)

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        column = filled(state.column(self.name), self.mean)
        shape = self._chebyshev(column) - self._chebyshev(np.array(self.mean))
        return 1.0 + np.sum([size * shape[..., k] for k, size in enumerate(values)], axis=0)

    def _chebyshev(self, column: Array) -> Array:
        score = np.clip((2.0 * column - self.low - self.high) / (self.high - self.low), -1.0, 1.0)
        return np.stack([score, 2.0 * score**2 - 1.0, 4.0 * score**3 - 3.0 * score], axis=-1)
