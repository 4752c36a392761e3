"""The least-squares problem of a log: groups, responses, bounds, shared parameters, reweighting.

A JointProblem is one joint's. Where causes act on several joints their problems are combined into one.
Coefficients of smooth functions have normal priors, each one more row of the sum of squares.
The weights depend on the repeatability, and under heavy tails on the residuals, and are iterated to
convergence.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._linalg import ridge_inverse
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._arrow_products import RowBorder, multiply_arrow
from stickslip_fit.estimation._block_arrow import (
    ParameterSharing,
    share_by_direction,
    share_with_all,
    shared_covariance,
    shared_curvature,
    solve_block_arrow,
)
from stickslip_fit.estimation._groups import Groups, group_rows, mean_step_sizes
from stickslip_fit.estimation._optimize import Minimum, RowSubsetModel, minimize, products_by_group
from stickslip_fit.estimation.identifiability import identifiable_parameters
from stickslip_fit.estimation.noise import GAUSSIAN, GIVEN_DF, Likelihood, NoiseLevel
from stickslip_fit.estimation.shared_estimate import SharedCovariance
from stickslip_fit.laws import StepLaw
from stickslip_fit.laws.base import Model


@dataclass(frozen=True)
class FitOptions:
    """Options of a least-squares fit.

    Attributes
    ----------
    shared : tuple of str
        Parameters that have one value in each direction for the whole campaign.
    bounds : dict of str to (float, float)
        Lowest and highest value of parameters, SI, within those of the law itself.
    repeatability : dict of (int, str) to float
        By joint and direction, relative, where it is known and not to be estimated.
    noise_ratio : Series or None
        Standard deviation of each row's noise in any unit, by the label of the row; None where the rows of a
        joint and direction have the same.
    """

    likelihood: Likelihood = GAUSSIAN
    shared: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    repeatability: Mapping[tuple[int, str], float] = field(default_factory=dict)
    noise_ratio: pd.Series | None = None

    def check(self, laws: Iterable[StepLaw]) -> None:
        """Check the options against these laws.

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

    def relative_noise(self, rows: pd.DataFrame) -> Array:
        """Standard deviation of each row's noise over the rms of its direction, shape (n,)."""
        if self.noise_ratio is None:
            return np.ones(len(rows))
        square = self.noise_ratio.loc[rows.index] ** 2
        return np.sqrt((square / square.groupby(rows["direction"].astype(str)).transform("mean")).to_numpy())

    def known_noise(self, joint: int) -> dict[str, NoiseLevel]:
        """A joint's repeatability by direction, as far as it is known beforehand."""
        return {
            direction: NoiseLevel(value, GIVEN_DF, "given")
            for (of, direction), value in self.repeatability.items()
            if of == joint
        }


DEFAULT_OPTIONS = FitOptions()
# Of one pass: counts that a law suits take tens, and hundreds near a bound or with outliers; the next pass
# of `reweighting` carries on where it stopped.
MAX_ITERATIONS = 500
SETTLED_FALL = 1e-6  # share of the sum of squares, in so many iterations as `PATIENCE`
MANY_PENALISED = 0.5  # of the rows, parameters with priors above which it counts
LEAST_SCATTER = 1e-9  # of a response, relative to the largest


@dataclass(frozen=True, eq=False)
class Problem:
    """What is minimized: n responses `y` = log(steps) in g groups; `start` to `upper` have shape (g, p)."""

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
    prior_sd: Array = field(default_factory=lambda: np.zeros(0), kw_only=True)
    """Standard deviation of the normal prior about 0 of each of the last parameters; infinite without one."""

    @property
    def penalised(self) -> IntArray:
        """Columns of the parameters with a prior."""
        return np.flatnonzero(np.isfinite(self.prior_sd)) + self.start.shape[1] - len(self.prior_sd)

    @property
    def prior_weight(self) -> Array:
        """Inverse variance of the prior of each of the `penalised` parameters."""
        return 1.0 / self.prior_sd[np.isfinite(self.prior_sd)] ** 2

    @property
    def first_weight(self) -> Array:
        """Weights to begin with, shape (n,): 1; beside a prior, by the scatter at the start."""
        if not len(self.penalised):
            return np.ones(len(self.y))
        scatter = self.y - self.model(self.start[self.groups.of_row])[0]
        least = (LEAST_SCATTER * float(np.abs(self.y).max())) ** 2  # as many parameters as rows leave none
        return np.full(len(self.y), 1.0 / max(float(np.mean(scatter**2)), least))

    def minimize(self, weight: Array, start: Array, most: int = MAX_ITERATIONS) -> Minimum:
        """The minimum of the sum of weight (y - model)^2 and of the priors, in `most` iterations at most."""
        if len(self.penalised):
            return self._minimize_penalised(weight, start, most)
        if self.sharing.parameters.any():
            arguments = (self.model, self.y, weight, self.groups, self.sharing, start, self.scales)
            return solve_block_arrow(*arguments, lower=self.lower, upper=self.upper, most=most)
        data = (self.model, self.y, weight, self.groups, start, self.scales)
        return minimize(*data, subset=self.subset, lower=self.lower, upper=self.upper, damping=0.0, most=most)

    def _minimize_penalised(self, weight: Array, start: Array, most: int) -> Minimum:
        """With the priors; what these leave to the data of the shared parameters is spread over all rows."""
        shared = np.flatnonzero(self.sharing.parameters)
        precision = np.zeros(len(shared))
        precision[np.searchsorted(shared, self.penalised)] = self.prior_weight
        data = (self.model, self.y, weight, self.groups, self.sharing, start, self.scales)
        # Where a session hardly determines its own parameters, a search among so many may creep for hundreds
        # of iterations; so small a share of the sum of squares is a few hundredths of an estimate's error.
        settled = SETTLED_FALL if len(self.penalised) > MANY_PENALISED * len(self.y) else 0.0
        options: Any = {"precision": precision, "most": most, "settled_fall": settled}
        minimum = solve_block_arrow(*data, lower=self.lower, upper=self.upper, **options)
        # A parameter that the prior determines takes no degree of freedom of the data.
        if self.has_more_than_rows:
            slopes = self.model(minimum.values[self.groups.of_row])[1]
            variance = np.diag(self.estimate_shared(slopes, weight)[1].shared)
        else:
            variance = np.diag(shared_covariance(minimum, self.sharing, self.scales))
        by_prior = float(variance[np.isfinite(self.prior_sd)] @ self.prior_weight)
        rows = np.cumsum(self.groups.sizes)
        spread = np.diff(np.round(by_prior * rows / rows[-1]), prepend=0.0)
        return replace(minimum, rank=minimum.rank - spread.astype(np.intp))

    def curvature(self, slopes: Array, information: Array) -> Array:
        """Half the second derivative by every group's parameters, all rows and priors together; (g, p, p)."""
        products = products_by_group(slopes.T * np.sqrt(information), self.groups)
        curvature = shared_curvature(products, self.sharing, self.scales)
        curvature[:, self.penalised, self.penalised] += self.prior_weight
        return curvature

    @property
    def has_more_than_rows(self) -> bool:
        """Whether more parameters than rows are shared, and all of them have priors."""
        return len(self.y) < len(self.penalised) == np.count_nonzero(self.sharing.parameters)

    def estimate_shared(self, slopes: Array, information: Array) -> tuple[BoolArray, SharedCovariance, Array]:
        """As `identifiable_parameters` where there are more parameters than rows.

        Returns
        -------
        known : array of bool, shape (g, p)
        covariance : SharedCovariance
        curvature : array, shape (g, p - q, p - q)
            J' W J of the own parameters.
        """
        shared, units = self.sharing.parameters, self.scales[0, self.sharing.parameters]
        columns = np.concatenate([slopes.T * np.sqrt(information), np.zeros((1, len(slopes)))])
        products = multiply_arrow(
            *(self.sharing, self.groups, np.zeros(len(slopes)), columns, self.scales),
            *(np.zeros(len(units)), self.prior_weight),
        )
        # What no row shows of the own parameters is none of the shared ones', which have their priors.
        known, _, inverse = identifiable_parameters(products.own, np.ones(products.own.shape[:2]))
        reduced, follow = products.eliminate(inverse)
        assert isinstance(reduced, RowBorder)
        covariance = ridge_inverse(reduced.others[:-1].T, reduced.precision, 0.0)
        assert covariance is not None
        across = -follow[:, :, :-1] @ covariance
        own, scales = inverse - across @ follow[:, :, :-1].swapaxes(1, 2), self.scales[:, ~shared]
        sizes = scales[:, :, None] * scales[:, None, :]
        every = np.ones(self.scales.shape, dtype=bool)
        every[:, ~shared] = known
        parts = own * sizes, across * scales[:, :, None] * units, covariance * units * units[:, None]
        unknown = np.zeros(len(own), dtype=bool)
        return every, SharedCovariance(*parts, unknown), products.own / sizes

    def gradient(self, slopes: Array, weighted_residual: Array) -> Array:
        """By how much half the sum of squares falls with each parameter, shape (g, p)."""
        fall = np.stack([self.groups.sums(weighted_residual * slope) for slope in slopes.T], axis=-1)
        return self.sharing.summed(fall)


@dataclass(frozen=True, eq=False)
class JointProblem(Problem):
    """What is minimized for one joint.

    `rounding`, shape (n,), is the variance that rounding adds; `noise_ratio`, shape (n,), each row's standard
    deviation over the repeatability of its direction, rounding aside.
    """

    law: StepLaw
    rows: pd.DataFrame
    rounding: Array
    noise_ratio: Array

    @cached_property
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
        groups=groups,
        sharing=share_by_direction(names, options.shared, groups),
        y=y,
        model=law.model(rows),
        start=law.start_values(mean_step),
        scales=law.scales(mean_step),
        lower=lower,
        upper=upper,
        law=law,
        rows=rows,
        rounding=rounding,
        noise_ratio=options.relative_noise(rows),
        subset=lambda some: law.model(rows.iloc[some]),
    )


def combined_problem(joints: Sequence[JointProblem], shared: int, prior_sd: Array) -> Problem:
    """One problem of joints whose last `shared` parameters are the same for all, and no others are shared.

    `prior_sd`, shape (shared,), is as of a `Problem`. It has the rows and groups of one joint after the
    other's, and columns as of `columns_of`.
    """
    width = max(joint.start.shape[1] for joint in joints)
    columns = [np.r_[: joint.start.shape[1] - shared, width - shared : width] for joint in joints]
    before = np.cumsum([0, *(len(joint.groups) for joint in joints)])
    tables = [joint.groups.table.assign(joint=joint.law.joint) for joint in joints]
    of_row = [joint.groups.of_row + first for joint, first in zip(joints, before[:-1], strict=True)]
    groups = Groups(pd.concat(tables, ignore_index=True), np.concatenate(of_row))

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
        groups=groups,
        sharing=share_with_all(np.arange(width) >= width - shared, groups),
        y=np.concatenate([joint.y for joint in joints]),
        model=model,
        start=table("start", 0.0),
        scales=table("scales", 1.0),
        lower=table("lower", -np.inf),
        upper=table("upper", np.inf),
        prior_sd=prior_sd,
    )


def columns_of(whole: Problem, joint: JointProblem) -> IntArray:
    """Positions of a joint's parameters among those of a combined problem: its own first, the shared last."""
    width, shared = len(whole.sharing.parameters), int(whole.sharing.parameters.sum())
    return np.r_[: joint.start.shape[1] - shared, width - shared : width]
