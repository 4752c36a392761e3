"""How much of the step size's variance comes from the day, the direction, and from reading to reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.anova.answer import REPEATS_EXACTLY
from stickslip_fit.anova.comparison import compare, shift, sums_of_squares
from stickslip_fit.anova.effect import effect_of
from stickslip_fit.anova.pivotal import generalized_pivotal_intervals
from stickslip_fit.anova.question import Refusal, most_read
from stickslip_fit.anova.readings import HELD
from stickslip_fit.anova.reml import CellStatistics, reml

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Component:
    """One standard deviation, m or rad per step, with its 95 % interval; 0 is a possible lower end."""

    deviation: float
    low: float
    high: float


@dataclass(frozen=True)
class Components:
    """Variance components of one joint at one configuration.

    Attributes
    ----------
    joint : int
    configuration : str
        Label of it, as in `readings.readings`.
    mean : float
        Mean step size.
    sessions : int
    day, day_direction, replicate : Component
        What changes from session to session in both directions alike, in each by itself, and from reading
        to reading. With one direction only, day_direction is None and part of day.
    total : Component
        What changes from session to session in one direction: day and day_direction together.
    direction : float or None
        The step size in direction + less that in direction -. Both directions there are were driven, so that
        this is a fixed effect: a difference, not a variance.
    direction_low, direction_high : float or None
        Its 95 % interval, from how differently it comes out in different sessions.
    """

    joint: int
    configuration: str
    mean: float
    sessions: int
    day: Component
    day_direction: Component | None
    replicate: Component
    total: Component
    direction: float | None = None
    direction_low: float | None = None
    direction_high: float | None = None


def components(rows: pd.DataFrame) -> Components | Refusal:
    """Variance components at the configuration that says most.

    Estimates are by restricted maximum likelihood, intervals by generalised pivotal quantities.

    Parameters
    ----------
    rows : DataFrame
        Readings of one joint.
    """
    here = most_read(rows, HELD)[0]
    joint, where = int(here["joint"].iloc[0]), str(here["configuration"].iloc[0])
    cells, rounding = cells_of(here), REPEATS_EXACTLY * float(here["step_size"].max())
    scatters = cells.within_freedom > 0 and cells.within > cells.within_freedom * rounding**2
    if cells.complete.sum() < 2 or not scatters:
        reason = "needs two sessions with every direction at one configuration, and readings that scatter"
        return Refusal("components", joint, None, None, None, reason)
    found, bounds = reml(cells), generalized_pivotal_intervals(cells)
    two = cells.count.shape[1] > 1
    difference = _difference(cells.mean[cells.complete]) if two else (None, None, None)
    return Components(
        joint,
        where,
        float(here["step_size"].mean()),
        len(cells.count),
        _component(found.day, bounds.day),
        _component(found.day_direction, bounds.day_direction) if two else None,
        _component(found.replicate, bounds.replicate),
        _component(found.day + found.day_direction, bounds.total),
        *difference,
    )


def cells_of(rows: pd.DataFrame) -> CellStatistics:
    """Counts and means by session and direction, and the scatter within."""
    values = rows["step_size"].to_numpy(float)
    shifted = shift(values)
    session = pd.factorize(rows["session"])[0]
    direction = np.unique(rows["direction"].to_numpy(object), return_inverse=True)[1]
    shape = (session.max() + 1, direction.max() + 1)
    flat = np.ravel_multi_index((session, direction), shape)
    count = np.bincount(flat, minlength=shape[0] * shape[1]).astype(float)
    total = np.bincount(flat, shifted, minlength=len(count))
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    within = float(sums_of_squares(values, compare(flat)).within)
    return CellStatistics(count.reshape(shape), mean.reshape(shape), within)


def _component(variance: float, bounds: tuple[float, float]) -> Component:
    """Where directions change against each other, day is 0 and the rest is estimated as if that were known.

    Their intervals do not know that, and are widened to hold the estimates.
    """
    deviation, low, high = np.sqrt([variance, *bounds])
    return Component(float(deviation), float(min(low, deviation)), float(max(high, deviation)))


def _difference(mean: Array) -> tuple[float, float, float]:
    """Direction + less -, the columns being in this order."""
    sessions = np.repeat(np.arange(len(mean)), 2)
    found = effect_of(mean.ravel(), compare(np.tile([0, 1], len(mean)), sessions))
    sign = 1.0 if found.largest == 0 else -1.0
    low, high = sorted((sign * found.low, sign * found.high))
    return sign * found.difference, low, high
