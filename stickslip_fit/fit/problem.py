"""Traverses laid out for least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.groups import Groups, group_rows, mean_steps
from stickslip_fit.fit.levenberg_marquardt import Minimum, Part, minimise
from stickslip_fit.fit.shared import Sharing, minimise_shared, share_by_direction, shared_curvature
from stickslip_fit.fit.terms import Terms
from stickslip_fit.laws import StepLaw
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class System:
    """What is minimised: n responses in g groups with p parameters each.

    Attributes
    ----------
    groups : Groups
    sharing : Sharing
    y : array, shape (n,)
        log(steps).
    model : Model
    start, scales, lower, upper : array, shape (g, p)
    part : callable
        Places of some rows to their model.
    """

    groups: Groups
    sharing: Sharing
    y: Array
    model: Model
    start: Array
    scales: Array
    lower: Array
    upper: Array
    part: Part

    def minimise(self, weight: Array, start: Array) -> Minimum:
        """Where the sum of weight (y - model)^2 is least."""
        if self.sharing.parameters.any():
            return minimise_shared(
                self.model, self.y, weight, self.groups, self.sharing, start, self.scales,
                part=self.part, lower=self.lower, upper=self.upper,
            )  # fmt: skip
        return minimise(
            self.model, self.y, weight, self.groups, start, self.scales,
            part=self.part, lower=self.lower, upper=self.upper, damping=0.0,
        )  # fmt: skip

    def curvature(self, slopes: Array, information: Array) -> Array:
        """What the rows, each with its `information`, say of every group's parameters; (g, p, p)."""
        return shared_curvature(slopes, information, self.groups, self.sharing, self.scales)

    def uphill(self, slopes: Array, weighted_residual: Array) -> Array:
        """By how much half the sum of squares falls with each parameter, shape (g, p)."""
        fall = np.stack([self.groups.sums(weighted_residual * slope) for slope in slopes.T], axis=-1)
        common, sets = self.sharing.parameters, self.sharing.sets
        for k in np.flatnonzero(common):
            fall[:, k] = sets.sums(fall[:, k])[sets.of_row]
        return fall


@dataclass(frozen=True, eq=False)
class Problem(System):
    """What is minimised for one joint.

    Attributes
    ----------
    law : StepLaw
    rows : DataFrame
    rounding : array, shape (n,)
        The variance that rounding adds.
    """

    law: StepLaw
    rows: pd.DataFrame
    rounding: Array

    @property
    def ways(self) -> npt.NDArray[np.object_]:
        """Direction of each group, shape (g,)."""
        return self.groups.table["direction"].to_numpy(dtype=object)


def lay_out(law: StepLaw, rows: pd.DataFrame, terms: Terms) -> Problem:
    """Lay out one joint's rows."""
    groups = group_rows(rows)
    y, rounding = law.response(rows)
    mean_step = mean_steps(groups, rows, y)
    names = tuple(parameter.name for parameter in law.parameters)
    lower, upper = terms.bounds_of(law, groups)
    return Problem(
        groups, share_by_direction(names, terms.shared, groups), y, law.model(rows),
        law.start_values(mean_step), law.scales(mean_step), lower, upper,
        lambda some: law.model(rows.iloc[some]), law, rows, rounding,
    )  # fmt: skip
