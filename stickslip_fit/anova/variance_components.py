"""Variance components of the step size: day, day by direction, and replicates.

Observation = mean[direction] + day[session] + day_direction[session, direction] + replicate, the last
three random. Estimates are by restricted maximum likelihood (REML); intervals are generalized pivotal
quantities (S. Weerahandi, JASA 88:899, 1993), which hold at a variance of 0, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import step_unit
from stickslip_fit._typing import Array
from stickslip_fit.anova.contrasts import (
    build_comparison,
    largest_difference,
    subtract_median,
    sums_of_squares,
)
from stickslip_fit.anova.designs import NotTestable, choose_most_informative, configuration_columns
from stickslip_fit.anova.factor_test import EXACT_REPEAT_TOL
from stickslip_fit.machine import Machine, load_machine


@dataclass(frozen=True)
class CellStatistics:
    """Observations by session and direction.

    Attributes
    ----------
    count, mean : array, shape (sessions, directions)
        The mean is 0 where the count is.
    within : float
        Sum of squares about the cells' means.
    """

    count: Array
    mean: Array
    within: float

    @property
    def complete(self) -> npt.NDArray[np.bool_]:
        """Sessions in which every direction was observed, shape (sessions,)."""
        return np.all(self.count > 0, axis=1)

    @property
    def within_df(self) -> int:
        """Degrees of freedom of `within`."""
        return int(self.count.sum() - (self.count > 0).sum())


@dataclass(frozen=True)
class VarianceEstimates:
    """Of day, of day by direction, and of a replicate."""

    day: float
    day_direction: float
    replicate: float


def fit_reml(cells: CellStatistics) -> VarianceEstimates:
    """Variances at the maximum of the restricted likelihood, each at least 0.

    The maximum may lie where a variance is 0. Each such face is searched separately, on a logarithmic
    scale, and the best is taken. With one direction only, day by direction is part of day.

    Examples
    --------
    >>> cells = CellStatistics(np.array([[3.0], [3.0]]), np.array([[0.0], [2.0]]), 4.0)
    >>> variances = fit_reml(cells)  # balanced: (MS between - MS within) / 3
    >>> round(variances.day, 6), round(variances.replicate, 6)
    (1.666667, 1.0)
    """
    faces = ([], [0], [1], [0, 1]) if cells.count.shape[1] > 1 else ([], [0])
    candidates = [ratios for free in faces for ratios in _minimize_deviance(cells, free)]
    best = min(candidates, key=lambda ratios: _profile_deviance(cells, ratios)[0])
    replicate = _profile_deviance(cells, best)[1]
    return VarianceEstimates(float(best[0] * replicate), float(best[1] * replicate), replicate)


def _minimize_deviance(cells: CellStatistics, free: list[int]) -> list[Array]:
    """Minima of the deviance with the other ratios 0, from a start on either side."""
    from scipy.optimize import minimize

    def to_ratios(logarithms: Array) -> Array:
        ratios = np.zeros(2)
        ratios[free] = np.exp(np.clip(logarithms, -60.0, 60.0))
        return ratios

    def deviance(logarithms: Array) -> float:
        return _profile_deviance(cells, to_ratios(logarithms))[0]

    if not free:
        return [np.zeros(2)]
    minima = [
        minimize(
            deviance,
            np.full(len(free), start),
            method="Nelder-Mead",
            options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 4000},
        )
        for start in (-1.0, 4.0)
    ]
    return [to_ratios(minimum.x) for minimum in minima]


def _profile_deviance(cells: CellStatistics, ratios: Array) -> tuple[float, float]:
    """Deviance at ratios of variances to the replicate's, and the replicate's variance profiled there."""
    present = cells.count > 0
    own = np.where(present, ratios[1] + 1.0 / np.maximum(cells.count, 1.0), 1.0)
    weight = present / own
    total = 1.0 + ratios[0] * weight.sum(axis=1)
    shared = ratios[0] / total

    pull, across = weight * cells.mean, weight.T * shared
    information = np.diag(weight.sum(axis=0)) - across @ weight
    score = pull.sum(axis=0) - across @ pull.sum(axis=1)
    residual = cells.mean - np.linalg.solve(information, score)
    pull = weight * residual
    between = np.sum(pull * residual) - shared @ pull.sum(axis=1) ** 2

    df = cells.count.sum() - cells.count.shape[1]
    replicate = float((cells.within + between) / df)
    logarithm = np.log(own).sum() + np.log(total).sum() + np.linalg.slogdet(information)[1]
    return float(df * np.log(replicate) + logarithm), replicate


PIVOTAL_DRAWS = 40_000
INTERVAL_QUANTILES = (0.025, 0.975)


@dataclass(frozen=True)
class VarianceIntervals:
    """95 % intervals of variances; `total` is day and day by direction together."""

    day: tuple[float, float]
    day_direction: tuple[float, float]
    replicate: tuple[float, float]
    total: tuple[float, float]


def generalized_pivotal_intervals(cells: CellStatistics) -> VarianceIntervals:
    """Intervals from the sessions, two at least, in which every direction was observed.

    A session's mean over its directions varies by ``day + V / 4`` and the difference between them by
    ``V = 2 day_direction + h replicate``, h being the sum of 1 / count over its cells, here its average.
    Both are exact where all cells have the same count.
    """
    rng = np.random.default_rng(0)
    count, mean = cells.count[cells.complete], cells.mean[cells.complete]
    df = len(mean) - 1
    replicate = cells.within / rng.chisquare(cells.within_df, PIVOTAL_DRAWS)
    h = float(np.mean(np.sum(1.0 / count, axis=1)))
    middle = _sum_of_squares(mean.mean(axis=1)) / rng.chisquare(df, PIVOTAL_DRAWS)
    if mean.shape[1] == 1:
        day = _quantile_bounds(middle - h * replicate)
        return VarianceIntervals(day, (0.0, 0.0), _quantile_bounds(replicate), day)
    across = _sum_of_squares(mean[:, 1] - mean[:, 0]) / rng.chisquare(df, PIVOTAL_DRAWS)
    return VarianceIntervals(
        _quantile_bounds(middle - across / 4),
        _quantile_bounds((across - h * replicate) / 2),
        _quantile_bounds(replicate),
        _quantile_bounds(middle + across / 4 - h * replicate / 2),
    )


def _sum_of_squares(values: Array) -> float:
    return float(np.sum((values - values.mean()) ** 2))


def _quantile_bounds(draws: Array) -> tuple[float, float]:
    low, high = np.maximum(0.0, np.quantile(draws, INTERVAL_QUANTILES))
    return float(low), float(high)


@dataclass(frozen=True)
class VarianceComponent:
    """One standard deviation, m or rad per step, with its 95 % interval; 0 is a possible lower end."""

    deviation: float
    low: float
    high: float


@dataclass(frozen=True)
class VarianceComponents:
    """Variance components of one joint at one configuration.

    Attributes
    ----------
    joint : int
    configuration : str
        Its label, as in `step_size_observations`.
    mean : float
        Mean step size.
    sessions : int
    day, day_direction, replicate : VarianceComponent
        Between sessions in both directions alike, in each by itself, and between replicates. With one
        direction only, day_direction is None and part of day.
    total : VarianceComponent
        Between sessions in one direction: day and day_direction together.
    direction, direction_low, direction_high : float or None
        Step size in direction + less that in direction -, a fixed effect, with its 95 % interval from the
        variation between sessions.
    machine : Machine
    """

    joint: int
    configuration: str
    mean: float
    sessions: int
    day: VarianceComponent
    day_direction: VarianceComponent | None
    replicate: VarianceComponent
    total: VarianceComponent
    direction: float | None = None
    direction_low: float | None = None
    direction_high: float | None = None
    machine: Machine = field(default_factory=load_machine)

    @property
    def unit(self) -> str:
        """Display unit of the step size."""
        return step_unit(self.joint, self.machine)


def estimate_components(
    rows: pd.DataFrame, machine: Machine | None = None
) -> VarianceComponents | NotTestable:
    """Variance components of one joint's observations at the most informative configuration."""
    subset = choose_most_informative(rows, configuration_columns(rows))[0]
    joint, configuration = int(subset["joint"].iloc[0]), str(subset["configuration"].iloc[0])
    cells, rounding = build_cell_statistics(subset), EXACT_REPEAT_TOL * float(subset["step_size"].max())
    scatters = cells.within_df > 0 and cells.within > cells.within_df * rounding**2
    if cells.complete.sum() < 2 or not scatters:
        reason = "needs two sessions with every direction at one configuration, and traverses that scatter"
        return NotTestable("components", joint, None, None, None, reason)
    variances, intervals = fit_reml(cells), generalized_pivotal_intervals(cells)
    two = cells.count.shape[1] > 1
    difference = _direction_difference(cells.mean[cells.complete]) if two else (None, None, None)
    components = VarianceComponents(
        joint,
        configuration,
        float(subset["step_size"].mean()),
        len(cells.count),
        _build_component(variances.day, intervals.day),
        _build_component(variances.day_direction, intervals.day_direction) if two else None,
        _build_component(variances.replicate, intervals.replicate),
        _build_component(variances.day + variances.day_direction, intervals.total),
        *difference,
    )
    return components if machine is None else replace(components, machine=machine)


def build_cell_statistics(rows: pd.DataFrame) -> CellStatistics:
    """Counts and means by session and direction, and the scatter within."""
    values = rows["step_size"].to_numpy(float)
    shifted = subtract_median(values)
    session = pd.factorize(rows["session"])[0]
    direction = np.unique(rows["direction"].to_numpy(object), return_inverse=True)[1]
    shape = (session.max() + 1, direction.max() + 1)
    flat = np.ravel_multi_index((session, direction), shape)
    count = np.bincount(flat, minlength=shape[0] * shape[1]).astype(float)
    total = np.bincount(flat, shifted, minlength=len(count))
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    within = float(sums_of_squares(values, build_comparison(flat)).within)
    return CellStatistics(count.reshape(shape), mean.reshape(shape), within)


def _build_component(variance: float, interval: tuple[float, float]) -> VarianceComponent:
    """A standard deviation whose interval is widened to hold an estimate at the bound of another variance."""
    deviation, low, high = np.sqrt([variance, *interval])
    return VarianceComponent(float(deviation), float(min(low, deviation)), float(max(high, deviation)))


def _direction_difference(mean: Array) -> tuple[float, float, float]:
    """Direction + less -, the columns being in this order."""
    sessions = np.repeat(np.arange(len(mean)), 2)
    effect = largest_difference(mean.ravel(), build_comparison(np.tile([0, 1], len(mean)), sessions))
    sign = 1.0 if effect.largest == 0 else -1.0
    low, high = sorted((sign * effect.low, sign * effect.high))
    return sign * effect.difference, low, high
