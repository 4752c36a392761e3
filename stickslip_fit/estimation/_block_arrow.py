"""Least squares with parameters shared by many groups: the normal equations are block-arrow-shaped.

Each group's own parameters are a block, the shared ones the border; eliminating the blocks leaves a
small system, so that time and memory grow linearly with the groups. Products of shared parameters are summed
over all groups at once: of many parameters, group by group they would fill the memory. Own parameters are
damped little, so
that the search follows the profile of the sum of squares (variable projection: G. Golub and V. Pereyra,
SIAM J. Numer. Anal. 10:413, 1973; L. Kaufman, BIT 15:49, 1975).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.estimation._optimize import (
    RANK_TOL,
    Minimum,
    Objective,
    SingularFactors,
    factorize,
    products_by_group,
    search,
    weighted_columns,
)
from stickslip_fit.estimation.identifiability import identifiable_parameters
from stickslip_fit.laws.base import Model

OWN_DAMPING = 1e-4  # own parameters enter nearly linearly and keep up with the shared ones
OFFSET_TOL = 1e-5  # where causes bend the laws, the rounding of the sum of squares hides much smaller ones


@dataclass(frozen=True)
class ParameterSharing:
    """Which parameters, shape (p,), are shared; `sets.of_row` gives the set, of h, of each group."""

    parameters: BoolArray
    sets: Groups

    def total(self, values: Array) -> Array:
        """Sum over the groups of each set, shape (g, ...) -> (h, ...)."""
        total = np.zeros((len(self.sets), *values.shape[1:]))
        for own, place in zip(values, self.sets.of_row.tolist(), strict=True):  # `np.add.at` is far slower
            total[place] += own
        return total

    def summed(self, values: Array) -> Array:
        """Values with each shared column summed over the set, shape (g, p)."""
        summed = values.copy()
        summed[:, self.parameters] = self.total(values[:, self.parameters])[self.sets.of_row]
        return summed

    def averaged(self, values: Array) -> Array:
        """Values with each shared column at its mean over the set, shape (g, p)."""
        size = self.sets.sizes[self.sets.of_row, None]
        return self.summed(values) / np.where(self.parameters, size, 1.0)


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
    lower: Array | float = -np.inf,
    upper: Array | float = np.inf,
    tolerance: float = 1e-8,
    offset_tol: float = OFFSET_TOL,
    least_fall: float = 0.0,
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
    lower, upper : array, broadcast to shape (g, p), optional
    tolerance, most : float, int, optional
        See `minimize`; a set of groups converges as one.
    offset_tol : float, optional
        A set has also converged where the relative offset, about the distance to the minimum in standard
        errors, is less than this.
    least_fall : float, optional
        A set is given up where the sum of squares falls by a smaller share in `PATIENCE` iterations.

    Returns
    -------
    Minimum
        Of `minimize`; shared values stand in each of their groups, `curvature` is that of the shared
        parameters of each set, the own ones eliminated, and their rank is spread over the groups of a set.
    """
    low, high = np.broadcast_to(lower, scales.shape), np.broadcast_to(upper, scales.shape)
    scales, tolerances = sharing.averaged(scales), (RANK_TOL, tolerance, offset_tol)
    objective = _BlockArrow(
        model, y, weight, groups, scales, low, high, *tolerances, least_fall=least_fall, sharing=sharing
    )
    return search(objective, sharing.averaged(start), 0.0, most)


@dataclass(frozen=True, eq=False)
class ArrowProducts:
    """Products of slopes and residuals at a point, shared parameters summed over each set.

    Attributes
    ----------
    sharing : ParameterSharing
        Of p parameters of g groups, q of them shared by the groups of each of h sets.
    residual : array, shape (n,)
    cost : array, shape (g,)
        Weighted sum of squares; infinite, and all products 0, where the model has no value.
    own : array, shape (g, p - q, p - q)
        Products of the own parameters' slopes.
    across : array, shape (g, p - q, q + 1)
        Of these with the slopes of the shared parameters, and with the residual.
    border : array, shape (h, q + 1, q + 1)
        Of the latter.
    """

    sharing: ParameterSharing
    residual: Array
    cost: Array
    own: Array
    across: Array
    border: Array

    @classmethod
    def of(
        cls, sharing: ParameterSharing, groups: Groups, residual: Array, columns: Array, scales: Array
    ) -> ArrowProducts:
        """From the columns of [J, r], shape (p + 1, n), and the scales of the parameters, (g, p)."""
        shared = sharing.parameters
        with np.errstate(all="ignore"):
            columns[:-1] *= scales[groups.of_row].T
            # By the inequality of Cauchy and Schwarz no product is greater.
            outside = ~np.isfinite(groups.sums(np.einsum("pn,pn->n", columns, columns)))
        if outside.any():
            columns[:, outside[groups.of_row]] = 0.0
        own, others = columns[:-1][~shared], np.concatenate([columns[:-1][shared], columns[-1:]])
        cost = np.where(outside, np.inf, groups.sums(columns[-1] ** 2))
        across = np.empty((len(groups), len(own), len(others)))
        for k, column in enumerate(own):
            across[:, k] = _sum_by_group(column * others, groups).T
        border = np.empty((len(sharing.sets), len(others), len(others)))
        for place in range(len(border)):
            some = others[:, (sharing.sets.of_row == place)[groups.of_row]] if len(border) > 1 else others
            np.matmul(some, some.T, out=border[place])
        return cls(sharing, residual, cost, products_by_group(own, groups), across, border)

    @property
    def squares(self) -> Array:
        """Sum of squares of each slope, that of a shared parameter over all groups of the set, (g, p)."""
        shared, squares = self.sharing.parameters, np.empty((len(self.own), len(self.sharing.parameters)))
        squares[:, ~shared] = _diagonal(self.own)
        squares[:, shared] = _diagonal(self.border)[self.sharing.sets.of_row, :-1]
        return squares

    @property
    def gradient(self) -> Array:
        """Products of the slopes with the residual, that of a shared parameter over all groups, (g, p)."""
        shared, gradient = self.sharing.parameters, np.empty((len(self.own), len(self.sharing.parameters)))
        gradient[:, ~shared] = self.across[:, :, -1]
        gradient[:, shared] = self.border[self.sharing.sets.of_row, :-1, -1]
        return gradient

    def fix_parameters(self, fixed: BoolArray, groups: Groups) -> ArrowProducts:
        """These products with some parameters, shape (g, p), fixed: shared ones in all groups of a set."""
        if not np.any(fixed):
            return self
        shared, of_set = self.sharing.parameters, self.sharing.sets.of_row
        free = 1.0 * ~fixed[:, ~shared]
        of_sets = np.ones((len(self.border), self.border.shape[1]))
        of_sets[of_set, :-1] = ~fixed[:, shared]
        return replace(
            self,
            own=self.own * free[:, :, None] * free[:, None, :],
            across=self.across * free[:, :, None] * of_sets[of_set, None],
            border=self.border * of_sets[:, :, None] * of_sets[:, None, :],
        )

    def merge(self, other: ArrowProducts, where: BoolArray, groups: Groups) -> ArrowProducts:
        """These products, but `other`'s in the groups `where`, which are all those of some sets."""
        if np.all(where):
            return other
        if not np.any(where):
            return self
        of_sets = np.zeros(len(self.border), dtype=bool)
        of_sets[self.sharing.sets.of_row] = where
        chosen = {"residual": where[groups.of_row], "cost": where, "own": where, "across": where}
        chosen |= {"border": of_sets}
        merged = {}
        for name, own in chosen.items():
            merged[name] = getattr(self, name).copy()
            merged[name][own] = getattr(other, name)[own]
        return replace(self, **merged)

    def eliminate(self, inverse: Array) -> tuple[Array, Array]:
        """The border without the own parameters, (h, q + 1, q + 1), and how these follow the others.

        `inverse` is that of `own`; what follows has the shape of `across`.
        """
        follow, width = inverse @ self.across, self.border.shape[1]
        reduced = self.border.copy()
        for place in range(len(reduced)):
            some = self.sharing.sets.of_row == place
            reduced[place] -= self.across[some].reshape(-1, width).T @ follow[some].reshape(-1, width)
        return reduced, follow


def _sum_by_group(values: Array, groups: Groups) -> Array:
    """Sums of rows over each group, (m, n) -> (m, g)."""
    place = np.arange(len(values))[:, None] * len(groups) + groups.of_row
    return np.bincount(place.ravel(), values.ravel(), len(values) * len(groups)).reshape(len(values), -1)


def _diagonal(matrices: Array) -> Array:
    return np.diagonal(matrices, axis1=1, axis2=2)


@dataclass(frozen=True, eq=False)
class _BlockArrow(Objective[ArrowProducts]):
    """Sums of squares in which the groups of a set move together."""

    sharing: ParameterSharing = field(kw_only=True)

    @property
    def sizes(self) -> IntArray:
        return np.bincount(self.sharing.sets.of_row, self.groups.sizes, len(self.sharing.sets)).astype(
            np.intp
        )

    def of_group[T: np.generic](self, values: npt.NDArray[T]) -> npt.NDArray[T]:
        return values[self.sharing.sets.of_row]

    def of_unit(self, values: Array) -> Array:
        return self.sharing.sets.sums(values)

    def largest(self, values: Array) -> Array:
        largest = np.zeros(len(self.sharing.sets))
        np.maximum.at(largest, self.sharing.sets.of_row, np.max(values, axis=1, initial=0.0))
        return largest

    def normal_equations(self, values: Array) -> ArrowProducts:
        with np.errstate(all="ignore"):
            residual, columns = weighted_columns(self.model, self.y, self.weight, values[self.groups.of_row])
        return ArrowProducts.of(self.sharing, self.groups, residual, columns, self.scales)

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
        own = np.flatnonzero(~self.sharing.parameters)
        units = np.ones((len(self.groups), len(own)))
        inverse = identifiable_parameters(here.own, units)[2]
        first = np.unique(self.sharing.sets.of_row, return_index=True)[1]
        shared = self.scales[first][:, self.sharing.parameters]
        return here.eliminate(inverse)[0][:, :-1, :-1] / (shared[:, :, None] * shared[:, None, :])


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
    def border(self) -> SingularFactors:
        """Each set's shared parameters, the own ones eliminated."""
        total, products = self._eliminated[0], self.products
        lengths = np.sqrt(np.maximum(_diagonal(total)[:, :-1], 0.0))
        # A shared parameter that the own ones can follow has next to no length beside the other effects.
        longest = np.max(_diagonal(products.border)[:, :-1], axis=1, keepdims=True, initial=0.0)
        by_own = self.sharing.total(_diagonal(products.own)).max(axis=1, keepdims=True, initial=0.0)
        seen = lengths > self.rank_tol * np.sqrt(np.maximum(longest, by_own))
        form = total[:, :-1, :-1] * seen[:, :, None] * seen[:, None, :]
        return factorize(form, total[:, :-1, -1] * seen, lengths, self.rank_tol)

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
    def _eliminated(self) -> tuple[Array, Array]:
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
