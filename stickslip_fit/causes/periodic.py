"""Generic causes that repeat: with the position, or by the clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._format import format_duration
from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.generic import AddedTerm, CovariateCause, Term, linear_term
from stickslip_fit.causes.parameters import CauseParameter, SizedParameter, Sizes
from stickslip_fit.causes.smooth import harmonics
from stickslip_fit.laws import Rows
from stickslip_fit.units import Z_95, Interval, TableUnit

MAX_PERIODS, MIN_VALUES_PER_PERIOD = 60, 5.0
MIN_PERIODS = 2.0  # in the range: less than that repeats nothing, and looks like any bend


@dataclass(frozen=True, kw_only=True)
class PeriodicPosition(CovariateCause, AddedTerm):
    """s sin(2 pi x / period) + c cos(2 pi x / period), x the position."""

    low: float = 0.0
    period: float = 1.0

    base_name = "periodic-in-position"
    base_phrase = "the response is periodic in the position"
    physics = (
        "Cogging of a motor, the pitch of a lead screw or a belt's teeth, an encoder's interpolation: each "
        "repeats after the same way."
    )
    shows_best = "one slow sweep over many periods, there and back"
    sentence = "The response is periodic in the position {column}, with a period of {period:.4g}{opposite}"

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        unit = TableUnit(self.unit)
        return CauseParameter("s", unit, "of the sine"), CauseParameter("c", unit, "of the cosine")

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        return {**super().quantities(sizes), "column": self.column, "period": self.period}

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `GenericCause`: periods that repeat, down to the spacing of positions, even in frequency."""
        position = rows[self.column].to_numpy(float)
        extent = float(np.ptp(position))
        finest = min(len(np.unique(position)) / MIN_VALUES_PER_PERIOD, MAX_PERIODS / 2)
        periods = extent / np.arange(MIN_PERIODS, max(finest, MIN_PERIODS) + 0.25, 0.5)
        return [(replace(self, period=float(period)), self.size * np.eye(2)) for period in periods]

    def term(self, rows: Rows) -> Term:
        waves = harmonics(np.asarray(rows[self.column], float) - self.low, self.period, 1)
        return linear_term(waves[:, ::-1])


@dataclass(frozen=True, kw_only=True)
class PeriodicTime(AddedTerm):
    """A wave in time with its harmonics, of the table's only session.

    Attributes
    ----------
    period : float
        In the unit of the time.
    harmonics : int
        1 for a sine wave alone.
    """

    period: float
    harmonics: int = 2
    time_unit: str = "s"

    base_name = "periodic-in-time"
    base_phrase = "the response comes and goes with a strict period"
    physics = (
        "Day and night, an air conditioner, a pump or the mains: what repeats by the clock takes the "
        "response with it."
    )
    shows_best = "one condition again and again, at most a quarter of the period apart"
    remedy = "averaging over whole periods"
    combine_trials = True
    sentence = "The response comes and goes with a period of {period}, by {swing} either way{opposite}"
    columns = ("session_seconds",)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        unit = TableUnit(self.unit)
        return tuple(
            CauseParameter(f"{name}{k}", unit, f"of the {wave} of 1/{k} of the period")
            for k in range(1, self.harmonics + 1)
            for name, wave in (("c", "cosine"), ("s", "sine"))
        )

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        return {
            **super().quantities({}),
            "period": format_duration(self.period, self.time_unit, 4),
            "swing": sizes["amplitude"],
        }

    def summarize(self, values: Array, covariance: Array) -> tuple[SizedParameter, ...]:
        """Amplitude of the wave and of each harmonic, of coefficients (q,) with their covariance (q, q)."""
        summary = []
        for k in range(self.harmonics):
            own = [2 * k, 2 * k + 1]
            pair, amplitude = values[own], float(np.linalg.norm(values[own]))
            slope = pair / max(amplitude, 1e-300)
            variance = float(slope @ covariance[np.ix_(own, own)] @ slope)
            error = Z_95 * np.sqrt(max(variance, 0.0))
            name = "amplitude" + (f", 1/{k + 1} of the period" if k else "")
            size = Interval(amplitude, max(amplitude - error, 0.0), amplitude + error)
            summary.append(SizedParameter(name, TableUnit(self.unit), size))
        return tuple(summary)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [(self, self.size * np.diag(1.0 / np.repeat(np.arange(1, self.harmonics + 1), 2)))]

    def functions(self, rows: Rows) -> Array:
        """See `smooth.harmonics`; shape (n, 2 harmonics)."""
        return harmonics(np.asarray(rows["session_seconds"], float), self.period, self.harmonics)

    def term(self, rows: Rows) -> Term:
        return linear_term(self.functions(rows))
