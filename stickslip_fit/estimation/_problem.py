"""The least-squares problem of a log: groups, responses, bounds, shared parameters, reweighting.

A JointProblem is one joint's. Where causes act on several joints their problems are combined into one.
The weights depend on the repeatability, and under heavy tails on the residuals, and are iterated to
convergence.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._block_arrow import (
    ParameterSharing,
    share_by_direction,
    share_with_all,
    shared_curvature,
    solve_block_arrow,
)
from stickslip_fit.estimation._optimize import (
    Groups,
    Minimum,
    RowSubsetModel,
    group_rows,
    mean_step_sizes,
    minimize,
)
from stickslip_fit.estimation.noise import GAUSSIAN, GIVEN_DF, Likelihood, NoiseLevel
from stickslip_fit.laws import StepLaw
from stickslip_fit.laws.base import Model


@dataclass(frozen=True)
class FitOptions:
    """Options of a least-squares fit.

    Attributes
    ----------
    likelihood : Likelihood
    shared : tuple of str
        Parameters that have one value in each direction for the whole campaign.
    bounds : dict of str to (float, float)
        Lowest and highest value of parameters, SI, within those of the law itself.
    repeatability : dict of (int, str) to float
        By joint and direction, relative, where it is known and not to be estimated.
    """

    likelihood: Likelihood = GAUSSIAN
    shared: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    repeatability: Mapping[tuple[int, str], float] = field(default_factory=dict)

    def check(self, laws: Iterable[StepLaw]) -> None:
        """Refuse what cannot be meant for these laws.

        Raises
        ------
        InputError
            For a parameter that no law has, bounds the wrong way round, or a repeatability not above 0.
        """
        known = list(dict.fromkeys(parameter.name for law in laws for parameter in law.parameters))
        for name in (*self.shared, *self.bounds):
            if name not in known:
                raise InputError(f"no law of this log has a parameter {name!r}; there are {', '.join(known)}")
        for name, (low, high) in self.bounds.items():
            if not low < high:
                raise InputError(f"bounds of {name}: the lower one must lie below the upper one")
        for (joint, direction), value in self.repeatability.items():
            if not 0 < value < np.inf:
                raise InputError(
                    f"repeatability of joint {joint} {direction}: must be above 0, not {value!r}"
                )

    def bounds_of(self, law: StepLaw, groups: Groups) -> tuple[Array, Array]:
        """Lower and upper bounds of a law's parameters, each shape (g, p)."""
        pairs = [
            (
                max(parameter.lower, self.bounds.get(parameter.name, (-np.inf, np.inf))[0]),
                min(parameter.upper, self.bounds.get(parameter.name, (-np.inf, np.inf))[1]),
            )
            for parameter in law.parameters
        ]
        lower, upper = np.array(pairs).T
        shape = (len(groups), len(pairs))
        return np.broadcast_to(lower, shape).copy(), np.broadcast_to(upper, shape).copy()

    def known_noise(self, joint: int) -> dict[str, NoiseLevel]:
        """A joint's repeatability by direction, as far as it is known beforehand."""
        return {
            direction: NoiseLevel(value, GIVEN_DF, "given")
            for (of, direction), value in self.repeatability.items()
            if of == joint
        }


DEFAULT_OPTIONS = FitOptions()


@dataclass(frozen=True, eq=False)
class Problem:
    """What is minimised: n responses in g groups with p parameters each.

    Attributes
    ----------
    groups : Groups
    sharing : ParameterSharing
    y : array, shape (n,)
        log(steps).
    model : Model
    start, scales, lower, upper : array, shape (g, p)
    """

    groups: Groups
    sharing: ParameterSharing
    y: Array
    model: Model
    start: Array
    scales: Array
    lower: Array
    upper: Array
    subset: RowSubsetModel | None = field(default=None, kw_only=True)
    """Positions of some rows to their model."""

    def minimize(self, weight: Array, start: Array) -> Minimum:
        """The minimum of the sum of weight (y - model)^2."""
        if self.sharing.parameters.any():
            return solve_block_arrow(
                self.model, self.y, weight, self.groups, self.sharing, start, self.scales,
                lower=self.lower, upper=self.upper,
            )  # fmt: skip
        return minimize(
            self.model, self.y, weight, self.groups, start, self.scales,
            subset=self.subset, lower=self.lower, upper=self.upper, damping=0.0,
        )  # fmt: skip

    def curvature(self, slopes: Array, information: Array) -> Array:
        """J' W J of every group's parameters by all rows, each with its `information`; (g, p, p)."""
        return shared_curvature(slopes, information, self.groups, self.sharing, self.scales)

    def gradient(self, slopes: Array, weighted_residual: Array) -> Array:
        """By how much half the sum of squares falls with each parameter, shape (g, p)."""
        fall = np.stack([self.groups.sums(weighted_residual * slope) for slope in slopes.T], axis=-1)
        return self.sharing.summed(fall)


@dataclass(frozen=True, eq=False)
class JointProblem(Problem):
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
    def directions(self) -> npt.NDArray[np.object_]:
        """Direction of each group, shape (g,)."""
        return self.groups.table["direction"].to_numpy(dtype=object)


def single_problem(law: StepLaw, rows: pd.DataFrame, options: FitOptions) -> JointProblem:
    """One joint's rows under its law."""
    groups = group_rows(rows)
    y, rounding = law.response(rows)
    mean_step = mean_step_sizes(groups, rows, y)
    names = tuple(parameter.name for parameter in law.parameters)
    lower, upper = options.bounds_of(law, groups)
    return JointProblem(
        groups, share_by_direction(names, options.shared, groups), y, law.model(rows),
        law.start_values(mean_step), law.scales(mean_step), lower, upper, law, rows, rounding,
        subset=lambda some: law.model(rows.iloc[some]),
    )  # fmt: skip


def combined_problem(joints: Sequence[JointProblem], shared: int) -> Problem:
    """Joints whose last parameters, so many of them, are the same for all.

    Parameters
    ----------
    joints : sequence of JointProblem
        Among a joint's own parameters none is shared.
    shared : int

    Returns
    -------
    Problem
        With the rows and groups of one joint after the other's, and columns as of `columns_of`.
    """
    width = max(joint.start.shape[1] for joint in joints)
    columns = [_columns(joint, width, shared) for joint in joints]
    groups = _concatenated(joints)

    def table(name: str, absent: float) -> Array:
        """Each joint's groups and parameters; a parameter that a joint lacks has no effect."""
        tables = []
        for joint, place in zip(joints, columns, strict=True):
            tables.append(np.full((len(joint.groups), width), absent))
            tables[-1][:, place] = getattr(joint, name)
        return np.concatenate(tables)

    def model(values: Array) -> tuple[Array, Array]:
        predicted, slopes, first = np.empty(len(values)), np.zeros((len(values), width)), 0
        for joint, place in zip(joints, columns, strict=True):
            rows = slice(first, first := first + len(joint.y))
            predicted[rows], slopes[rows, place] = joint.model(values[rows, place])
        return predicted, slopes

    return Problem(
        groups, share_with_all(np.arange(width) >= width - shared, groups),
        np.concatenate([joint.y for joint in joints]), model,
        table("start", 0.0), table("scales", 1.0), table("lower", -np.inf), table("upper", np.inf),
    )  # fmt: skip


def columns_of(whole: Problem, joint: JointProblem) -> IntArray:
    """Positions of a joint's parameters among those of a combined problem: its own first, the shared last."""
    return _columns(joint, len(whole.sharing.parameters), int(whole.sharing.parameters.sum()))


def _columns(joint: JointProblem, width: int, shared: int) -> IntArray:
    return np.r_[: joint.start.shape[1] - shared, width - shared : width]


def _concatenated(joints: Sequence[JointProblem]) -> Groups:
    before = np.cumsum([0, *(len(joint.groups) for joint in joints)])
    of_row = [joint.groups.of_row + first for joint, first in zip(joints, before[:-1], strict=True)]
    tables = [joint.groups.table.assign(joint=joint.law.joint) for joint in joints]
    return Groups(pd.concat(tables, ignore_index=True), np.concatenate(of_row))
