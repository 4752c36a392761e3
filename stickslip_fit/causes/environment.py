"""Causes that follow a recorded column: temperature, humidity, supply voltage, step rate, covariates.

All are factors on the step size that are 1 at the log's mean (step rate: at the median period).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import log
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.friction import StageCause
from stickslip_fit.causes.kinds import FactorCause, OnSomeJoints
from stickslip_fit.causes.parameters import CauseParameter, Sizes, fill_empty, missing_column
from stickslip_fit.laws import State
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.machine import Machine

__all__ = ["Temperature", "Humidity", "SupplyVoltage", "StepRate", "Covariate"]  # noqa: RUF022


@dataclass(frozen=True)
class ColumnCause(FactorCause):
    """gamma times 1 + k (x - mean x), x a column of the log: the only one of `columns`.

    Attributes
    ----------
    mean : float
        Of the column over the log.
    """

    mean: float = 0.0

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        return replace(self, mean=float(np.nanmean(rows[self.columns[0]].to_numpy(float))))

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        return missing_column(rows, self.columns[0])

    def factor(self, state: State, values: list[Array]) -> Array:
        return 1.0 + values[0] * self.deviation(state)

    def deviation(self, state: State) -> Array:
        """The column less its mean, shape (n, 1)."""
        return fill_empty(state.column(self.columns[0]), self.mean) - self.mean


TEMPERATURE_PARAMETERS = (
    CauseParameter("k", "%/K", "change of the step size per kelvin"),
    CauseParameter("bend", "1", "share of k gained at half the log's range above its mean", -1.0, 1.0),
)


@dataclass(frozen=True)
class Temperature(ColumnCause):
    """gamma times 1 + k x, in its curved form 1 + k x (1 + bend x / half), with x = T - mean T.

    Attributes
    ----------
    form : {"straight", "curved"}
    half : float
        Half of the log's range of temperatures, K.
    """

    form: str = "straight"
    half: float = 1.0

    name = "temperature"
    phrase = "steps follow the room's temperature"
    physics = (
        "A piezo's stroke per volt depends on its temperature, and so does the friction of the guides, so "
        "that a warmer room makes other steps. Over a few kelvin both change about in proportion; over more, "
        "the response may bend gently."
    )
    shows_best = "the same traverse in a cold and in a warm room"
    remedy = "keeping the room's temperature"
    may_differ_by_joint = True
    columns = ("temperature",)
    forms = ("straight", "curved")

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return TEMPERATURE_PARAMETERS[: 1 + (self.form == "curved")]

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (0.002, 0.5)[: len(self.parameters)]

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        return replace(super().bind(rows, machine), half=float(np.ptp(rows["temperature"].dropna()) / 2))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        straight, curved = (replace(self, form=form) for form in self.forms)
        return [(straight, np.array([[0.002]])), (curved, np.array([[0.002, 0.5], [0.002, -0.5]]))]

    @property
    def sentence(self) -> str:  # type: ignore[override]
        plain = "Steps {k:grow|shrink} by {k} with the room's temperature"
        return plain + ", {cold:+} where it is cold and {warm:+} where it is warm" * (self.form == "curved")

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `Cause.quantities`: of its curved form the slopes at half the log's range from the mean."""
        if self.form == "straight":
            return sizes
        k, bend = sizes["k"], sizes["bend"].size.estimate
        return {**sizes, "cold": k.plus(-2.0 * bend), "warm": k.plus(2.0 * bend)}

    def largest_plausible(self) -> tuple[Array, ...]:
        return (np.array([0.02, 0.0])[: len(self.parameters)],)

    def factor(self, state: State, values: list[Array]) -> Array:
        deviation = self.deviation(state)
        bend = values[1] if self.form == "curved" else 0.0
        return 1.0 + values[0] * deviation * (1.0 + bend * deviation / self.half)


@dataclass(frozen=True)
class Humidity(StageCause, ColumnCause):
    """gamma times 1 + k (x - mean x), x the relative humidity."""

    name = "humidity"
    phrase = "steps follow the humidity"
    physics = (
        "Water adsorbed from the air changes the friction between ceramic and steel, and with it how far a "
        "joint slips in each step (B. Bhushan, Introduction to Tribology, 2nd ed., Wiley, 2013)."
    )
    shows_best = "the same traverse in dry and in humid air"
    sentence = "Steps {k:grow|shrink} by {k} with the humidity"
    remedy = "keeping the room's humidity"
    may_differ_by_joint = True
    columns = ("humidity",)
    parameters = (CauseParameter("k", "%/%", "change of the step size per per cent of relative humidity"),)
    scale = (0.05,)
    largest_sizes = ((0.5,),)


@dataclass(frozen=True)
class SupplyVoltage(ColumnCause):
    """gamma times 1 + k (x - mean x), x the supply voltage."""

    name = "supply-voltage"
    phrase = "steps follow the supply voltage"
    physics = (
        "The amplitude of the saw-tooth drive follows the supply, and a step is proportional to the "
        "amplitude less the part that friction takes up elastically."
    )
    shows_best = "the same traverse at two supply voltages"
    sentence = "Steps {k:grow|shrink} by {k} with the supply voltage"
    remedy = "steadying the supply"
    may_differ_by_joint = True
    columns = ("supply",)
    parameters = (CauseParameter("k", "%/V", "change of the step size per volt"),)
    scale = (0.005,)
    largest_sizes = ((0.05,),)


@dataclass(frozen=True)
class StepRate(FactorCause):
    """gamma times 1 + k log(period / median period).

    Attributes
    ----------
    median : float
        Step period, s.
    """

    median: float = 1.0

    name = "step-rate"
    phrase = "steps follow the step period"
    physics = (
        "A joint still rings from one step when the next begins, and friction depends on how long the "
        "surfaces have been at rest, so that the period between steps changes how far each slips."
    )
    shows_best = "the same traverse at the shortest and at the longest step period"
    sentence = "Steps {k:grow|shrink} by {k} when the step period doubles"
    remedy = "keeping to one step period"
    may_differ_by_joint = True
    columns = ("step_period",)
    parameters = (CauseParameter("k", "%", "change of the step size per e-fold of the step period"),)
    scale = (0.02,)
    largest_sizes = ((0.2,),)

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        return replace(self, median=float(np.nanmedian(rows["step_period"].to_numpy(float))))

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        return missing_column(rows, "step_period")

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `Cause.quantities`: for a doubling of the period."""
        return {"k": sizes["k"].times(log(2))}

    def factor(self, state: State, values: list[Array]) -> Array:
        return 1.0 + values[0] * np.log(fill_empty(state.column("step_period"), self.median) / self.median)


CHEBYSHEV_ORDER = 3


@dataclass(frozen=True)
class Covariate(OnSomeJoints, FactorCause):
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
    sentence = "Steps follow the column {column}"
    parameters = tuple(
        CauseParameter(f"f{order}", "%", f"Chebyshev coefficient {order} over the column's range")
        for order in range(1, CHEBYSHEV_ORDER + 1)
    )
    combine_trials = True
    scale = (0.01,) * CHEBYSHEV_ORDER
    trial_values = 0.01 * np.eye(CHEBYSHEV_ORDER)
    largest_sizes = ((0.1, 0.0, 0.0),)

    @property
    def name(self) -> str:  # type: ignore[override]
        return COVARIATE_PREFIX + self.column

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return (self.name,)

    @property
    def remedy(self) -> str:  # type: ignore[override]
        return f"keeping {self.column} steady"

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `Cause.quantities`: the coefficients of a curve are left out."""
        return {"column": self.column}

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        values = rows[self.name].astype(float)
        return replace(self, mean=float(values.mean()), low=float(values.min()), high=float(values.max()))

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        return missing_column(rows, self.name)

    def factor(self, state: State, values: list[Array]) -> Array:
        column = fill_empty(state.column(self.name), self.mean)
        shape = self._chebyshev(column) - self._chebyshev(np.array(self.mean))
        return 1.0 + np.sum([size * shape[..., k] for k, size in enumerate(values)], axis=0)

    def _chebyshev(self, column: Array) -> Array:
        score = np.clip((2.0 * column - self.low - self.high) / (self.high - self.low), -1.0, 1.0)
        return np.stack([score, 2.0 * score**2 - 1.0, 4.0 * score**3 - 3.0 * score], axis=-1)
