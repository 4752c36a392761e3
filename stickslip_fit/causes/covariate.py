"""A column that the lab logged explains it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, FactorCause, filled, missing_column
from stickslip_fit.laws import State
from stickslip_fit.machine import Machine

PREFIX = "covariate:"
ORDER = 3


@dataclass(frozen=True)
class Covariate(FactorCause):
    """gamma times 1 + f(column), f a polynomial of the column's standard scores, smooth over the log's range.

    Attributes
    ----------
    column : str
        The lab's own name of it.
    mean, spread : float
        Over the log.
    """

    column: str = ""
    mean: float = 0.0
    spread: float = 1.0

    phrase = "steps follow a column that the lab logged"
    physics = "Whatever the column stands for; the log alone shows that the step size follows it smoothly."
    shows_best = "one configuration at the lowest and at the highest values of the column"
    parameters = tuple(
        CauseParameter(f"f{order}", "%", f"Chebyshev coefficient {order} of the column's standard score")
        for order in range(1, ORDER + 1)
    )
    absent = (0.0,) * ORDER
    joined = True
    scale = (0.01,) * ORDER

    @property
    def name(self) -> str:  # type: ignore[override]
        """See `Cause`."""
        return PREFIX + self.column

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (self.name,)

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        values = rows[self.name].to_numpy(float)
        half = (np.nanmax(values) - np.nanmin(values)) / 2
        return replace(self, mean=float(np.nanmin(values) + half), spread=float(half or 1.0))

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
        score = (filled(state.column(self.name), np.nan) - self.mean) / self.spread
        chebyshev = np.polynomial.chebyshev.chebvander(np.clip(score, -1.0, 1.0), ORDER)[..., 1:]
        departure = sum(size * chebyshev[..., k] for k, size in enumerate(values))
        return 1.0 + np.nan_to_num(departure)
