"""Least squares with parameters shared by many groups: the normal equations are block-arrow-shaped.

Each group's own parameters are a block, the shared ones the border; eliminating the blocks leaves a
small system, so that time and memory grow linearly with the groups (`_arrow_products`). Own parameters are
damped little, so that the search follows the profile of the sum of squares (variable projection: G. Golub
and V. Pereyra, SIAM J. Numer. Anal. 10:413, 1973; L. Kaufman, BIT 15:49, 1975).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.estimation._arrow_products import (
    ArrowProducts,
    ParameterSharing,
    ReducedBorder,
    multiply_arrow,
)
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.estimation._optimize import (
    RANK_TOL,
    Factors,
    Minimum,
    Objective,
    SingularFactors,
    factorize,
    search,
    weighted_columns,
)
from stickslip_fit.estimation.identifiability import identifiable_parameters
from stickslip_fit.laws.base import Model

OWN_DAMPING = 1e-4  # own parameters enter nearly linearly and keep up with the shared ones
OFFSET_TOL = 1e-5  # where causes bend the laws, the rounding of the sum of squares hides much smaller ones


def share_by_direction(names: tuple[str, ...], shared: tuple[str, ...], groups: Groups) -> ParameterSharing:
    """Parameters that have one value in each direction, whatever the session."""
    set_of_group, directions = pd.factorize(groups.table["direction"].to_numpy())
    sets = Groups(pd.DataFrame(index=pd.RangeIndex(len(directions))), set_of_group)
    return ParameterSharing(np.array([name in shared for name in names]), sets)


def share_with_all(parameters: BoolArray, groups: Groups) -> ParameterSharing:
    """Parameters that have one value in all groups."""
    return ParameterSharing(parameters, Groups(pd.DataFrame({"set": [0]}), np.zeros(len(groups), np.intp)))


def solve_block_arrow(
    model: Model,
    y: Array,
    weight: Array,
    groups: Groups,
    sharing: ParameterSharing,
    start: Array,
    scales: Array,
    *,
    precision: Array | None = None,
    lower: Array | float = -np.inf,
    upper: Array | float = np.inf,
    tolerance: float = 1e-8,
    offset_tol: float = OFFSET_TOL,
    least_fall: float = 0.0,
    settled_fall: float = 0.0,
    most: int = 2000,
) -> Minimum:
    """Minimize the sum of weight (y - model)^2 over each group's own and the shared parameters.

    Parameters
    ----------
    model : callable
        Values of each row's group, shape (n, p), to responses and derivatives; see `StepLaw.model`.
    y, weight : array, shape (n,)
    start, scales : array, shape (g, p)
        Shared parameters begin at the mean over their groups.
    precision : array, shape (q,), optional
        Inverse variances of normal priors about 0 of the shared parameters of a single set, 0 without one.
        Each counts as a row of the first group.
    lower, upper : array, broadcast to shape (g, p), optional
        Not of shared parameters of which there are more than rows, all with priors.
    tolerance, most : float, int, optional
        See `minimize`; a set of groups converges as one.
    offset_tol : float, optional
        A set has also converged where the relative offset, about the distance to the minimum in standard
        errors, is less than this.
    least_fall : float, optional
        A set is given up where the sum of squares falls by a smaller share in `PATIENCE` iterations.
    settled_fall : float, optional
        The same, by which it has converged.

    Returns
    -------
    Minimum
        Of `minimize`; shared values stand in each of their groups, `curvature` is that of the shared
        parameters of each set, the own ones eliminated, and their rank is spread over the groups of a set.
    """
    low, high = np.broadcast_to(lower, scales.shape), np.broadcast_to(upper, scales.shape)
    scales, tolerances = sharing.averaged(scales), (RANK_TOL, tolerance, offset_tol)
    precision = np.zeros(np.count_nonzero(sharing.parameters)) if precision is None else precision
    assert len(sharing.sets) == 1 or not precision.any()
    options: Any = {
        "least_fall": least_fall,
        "settled_fall": settled_fall,
        "sharing": sharing,
        "precision": precision,
    }
    objective = _BlockArrow(model, y, weight, groups, scales, low, high, *tolerances, **options)
    return search(objective, sharing.averaged(start), 0.0, most)


@dataclass(frozen=True, eq=False)
class _BlockArrow(Objective[ArrowProducts]):
    """Sums of squares in which the groups of a set move together."""

    sharing: ParameterSharing = field(kw_only=True)
    precision: Array = field(kw_only=True)

    @property
    def sizes(self) -> IntArray:
        rows = np.bincount(self.sharing.sets.of_row, self.groups.sizes, len(self.sharing.sets))
        return rows.astype(np.intp) + np.count_nonzero(self.precision)

    def of_group[T: np.generic](self, values: npt.NDArray[T]) -> npt.NDArray[T]:
        return values[self.sharing.sets.of_row]

    def of_unit(self, values: Array) -> Array:
        return self.sharing.sets.sums(values)

    def largest(self, values: Array) -> Array:
        largest = np.zeros(len(self.sharing.sets))
        np.maximum.at(largest, self.sharing.sets.of_row, np.max(values, axis=1, initial=0.0))
        return largest

    def normal_equations(self, values: Array) -> ArrowProducts:
        of_row = values[self.groups.of_row]
        with np.errstate(all="ignore"):
            residual, columns = weighted_columns(self.model, self.y, self.weight, of_row)
        shared = values[0, self.sharing.parameters]
        return multiply_arrow(
            self.sharing, self.groups, residual, columns, self.scales, shared, self.precision
        )

    def gradient(self, here: ArrowProducts) -> Array:
        return here.gradient

    def lengths(self, here: ArrowProducts) -> Array:
        return np.sqrt(here.squares)

    def factors(self, here: ArrowProducts, lengths: Array) -> _ArrowFactors:
        return _ArrowFactors(here, lengths, self.sharing, self.rank_tol)

    def rank(self, here: ArrowProducts, lengths: Array) -> IntArray:
        factors = self.factors(here, lengths)
        return factors.own.rank + _distribute_rank(factors.border.rank, self.sharing.sets, self.groups.sizes)

    def curvature(self, here: ArrowProducts) -> Array:
        units = np.ones(here.own.shape[:2])
        inverse = identifiable_parameters(here.own, units)[2]
        first = np.unique(self.sharing.sets.of_row, return_index=True)[1]
        shared = self.scales[first][:, self.sharing.parameters]
        return here.eliminate(inverse)[0].curvature / (shared[:, :, None] * shared[:, None, :])


@dataclass(frozen=True, eq=False)
class _ArrowFactors:
    """A block-arrow system, solved for g groups in h sets."""

    products: ArrowProducts
    lengths: Array
    sharing: ParameterSharing
    rank_tol: float

    @cached_property
    def own(self) -> SingularFactors:
        """Each group's own parameters, the shared ones fixed."""
        lengths = self.lengths[:, ~self.sharing.parameters]
        return factorize(self.products.own, self.products.across[:, :, -1], lengths, self.rank_tol)

    @cached_property
    def border(self) -> Factors:
        """Each set's shared parameters, the own ones eliminated."""
        by_own = self.sharing.total(np.diagonal(self.products.own, axis1=1, axis2=2))
        longest = np.max(np.concatenate([by_own, self.products.border.squares], axis=1), axis=1, initial=0.0)
        return self._eliminated[0].factorize(np.sqrt(longest), self.rank_tol)

    @cached_property
    def rank(self) -> IntArray:
        return self.sharing.total(self.own.rank.astype(float)).astype(np.intp) + self.border.rank

    @cached_property
    def gain(self) -> Array:
        return self.sharing.total(self.own.gain) + self.border.gain

    def step(self, damping: Array) -> Array:
        # The own parameters follow the shared ones undamped; their own steps are damped little.
        of_set, follow = self.sharing.sets.of_row, self._eliminated[1][:, :, :-1]
        shared = self.border.step(damping)[of_set]
        step = np.empty_like(self.lengths)
        step[:, self.sharing.parameters] = shared
        own = self.own.step(OWN_DAMPING * damping[of_set])
        step[:, ~self.sharing.parameters] = own - np.vecdot(follow, shared[:, None])
        return step

    @cached_property
    def _eliminated(self) -> tuple[ReducedBorder, Array]:
        return self.products.eliminate(self.own.inverse())


def shared_covariance(minimum: Minimum, sharing: ParameterSharing, scales: Array) -> Array:
    """Covariance of the parameters that all groups share, shape (q, q)."""
    return identifiable_parameters(minimum.curvature[:1], scales[:1, sharing.parameters])[2][0]


def shared_curvature(products: Array, sharing: ParameterSharing, scales: Array) -> Array:
    """J' W J of each group, (g, p, p), with that of its set's other groups, own parameters eliminated.

    Its inverse is the covariance of the group's own and the shared parameters.
    """
    reduced, common = _reduced(products, sharing, scales), np.flatnonzero(sharing.parameters)
    curvature = products.copy()
    curvature[:, common[:, None], common] += sharing.total(reduced)[sharing.sets.of_row] - reduced
    return curvature


def _reduced(products: Array, sharing: ParameterSharing, scales: Array) -> Array:
    """J' W J of the shared parameters in each group, its own eliminated, shape (g, q, q)."""
    own = np.flatnonzero(~sharing.parameters)
    _, _, inverse = identifiable_parameters(products[:, own[:, None], own], scales[:, own])
    return _eliminate_own(products, inverse, sharing)[0]


def _eliminate_own(products: Array, inverse: Array, sharing: ParameterSharing) -> tuple[Array, Array]:
    """Products of all but the own columns, these eliminated, and how the own parameters follow the others."""
    own = np.flatnonzero(~sharing.parameters)
    others = np.setdiff1d(np.arange(products.shape[1]), own)
    across = products[:, own[:, None], others]
    follow = inverse @ across
    return products[:, others[:, None], others] - across.swapaxes(1, 2) @ follow, follow


def _distribute_rank(rank: IntArray, sets: Groups, sizes: IntArray) -> IntArray:
    """The rank of each set in whole numbers for its groups, as nearly as possible by their rows."""
    shares = np.zeros(len(sizes), dtype=np.intp)
    for number, set_rank in enumerate(rank):
        members = np.flatnonzero(sets.of_row == number)
        due = np.round(np.cumsum(sizes[members]) / sizes[members].sum() * set_rank)
        shares[members] = np.diff(due, prepend=0.0)
    return shares
