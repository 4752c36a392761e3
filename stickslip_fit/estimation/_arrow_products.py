"""Products of slopes and residuals of groups that share parameters, and the shared ones' part of them.

Products of shared parameters are summed over all groups at once: group by group those of many parameters
would fill the memory. Where more of them than rows have a normal prior, as coefficients of smooth functions,
the rows are kept in place of their products, and steps solved by a system of their number (M. A. Woodbury,
1950).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.estimation._optimize import Factors, factorize, products_by_group


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


class Border(Protocol):
    """The part of the q parameters that the groups of each of h sets share."""

    @property
    def squares(self) -> Array:
        """Sum of squares of each slope, priors counting as rows, shape (h, q)."""

    @property
    def gradient(self) -> Array:
        """Products of the slopes with the residual, shape (h, q)."""

    def fix_parameters(self, own: Array, shared: Array) -> Border:
        """With parameters fixed, where `own`, (g, p - q), and `shared`, (h, q), are 0; elsewhere 1."""

    def merge(self, other: Any, sets: BoolArray) -> Border:
        """That of some sets from another border of the same kind."""

    def eliminate(self, across: Array, follow: Array) -> ReducedBorder:
        """Without the own parameters; `across` is as of `ArrowProducts`, `follow` how they follow, alike."""


class ReducedBorder(Protocol):
    """A border without the own parameters."""

    @property
    def curvature(self) -> Array:
        """J' W J of the shared parameters, shape (h, q, q)."""

    def factorize(self, floor: Array, rank_tol: float) -> Factors:
        """The system solved; of slopes some `rank_tol` of `floor`, shape (h,), is next to no length."""


@dataclass(frozen=True, eq=False)
class ProductBorder:
    """Products of the shared slopes and the residual, shape (h, q + 1, q + 1); `of_set` as of sharing."""

    products: Array
    of_set: IntArray

    @classmethod
    def of(cls, sharing: ParameterSharing, groups: Groups, others: Array) -> ProductBorder:
        """From columns of shared slopes and the residual, shape (q + 1, n)."""
        products = np.empty((len(sharing.sets), len(others), len(others)))
        for place in range(len(products)):
            some = others if len(products) == 1 else others[:, sharing.sets.of_row[groups.of_row] == place]
            np.matmul(some, some.T, out=products[place])
        return cls(products, sharing.sets.of_row)

    @property
    def squares(self) -> Array:
        return _diagonal(self.products)[:, :-1]

    @property
    def gradient(self) -> Array:
        return self.products[:, :-1, -1]

    def add_priors(self, precision: Array, values: Array) -> ProductBorder:
        """With normal priors about 0, (q,), of parameters at some values."""
        products, k = self.products.copy(), np.arange(len(precision))
        products[:, k, k] += precision
        products[:, k, -1] -= precision * values
        products[:, -1, k] -= precision * values
        return replace(self, products=products)

    def fix_parameters(self, own: Array, shared: Array) -> ProductBorder:
        free = np.concatenate([shared, np.ones((len(shared), 1))], axis=1)
        return replace(self, products=self.products * free[:, :, None] * free[:, None, :])

    def merge(self, other: Any, sets: BoolArray) -> ProductBorder:
        return replace(self, products=np.where(sets[:, None, None], other.products, self.products))

    def eliminate(self, across: Array, follow: Array) -> ProductBorder:
        reduced, width = self.products.copy(), self.products.shape[1]
        for place in range(len(reduced)):
            some = self.of_set == place
            reduced[place] -= across[some].reshape(-1, width).T @ follow[some].reshape(-1, width)
        return replace(self, products=reduced)

    @property
    def curvature(self) -> Array:
        """See `ReducedBorder`."""
        return self.products[:, :-1, :-1]

    def factorize(self, floor: Array, rank_tol: float) -> Factors:
        lengths = np.sqrt(np.maximum(self.squares, 0.0))
        # A shared parameter that the own ones can follow has next to no length beside the other effects.
        seen = lengths > rank_tol * floor[:, None]
        form = self.curvature * seen[:, :, None] * seen[:, None, :]
        return factorize(form, self.gradient * seen, lengths, rank_tol)


@dataclass(frozen=True, eq=False)
class RowBorder:
    """Rows of one set, all of whose shared parameters have priors.

    Attributes
    ----------
    own : array, shape (p - q, n)
        Slopes of the own parameters of each row's group.
    others : array, shape (q + 1, n)
        Of the shared parameters, and the residual.
    precision, pull : array, shape (q,)
        Of the priors, and their gradient.
    of_row : array of int, shape (n,)
        Group of each row.
    """

    own: Array
    others: Array
    precision: Array
    pull: Array
    of_row: IntArray

    @property
    def squares(self) -> Array:
        return (np.vecdot(self.others[:-1], self.others[:-1]) + self.precision)[None]

    @property
    def gradient(self) -> Array:
        return (self.others[:-1] @ self.others[-1] + self.pull)[None]

    def fix_parameters(self, own: Array, shared: Array) -> RowBorder:
        assert np.all(shared)
        return replace(self, own=self.own * own[self.of_row].T)

    def merge(self, other: Any, sets: BoolArray) -> RowBorder:
        merged: RowBorder = other if sets.all() else self
        return merged

    def eliminate(self, across: Array, follow: Array) -> RowBorder:
        left = self.others.copy()
        for column, own in zip(self.own, follow.swapaxes(0, 1), strict=True):
            left -= column * own[self.of_row].T
        return replace(self, others=left)

    @property
    def curvature(self) -> Array:
        """See `ReducedBorder`."""
        return (self.others[:-1] @ self.others[:-1].T + np.diag(self.precision))[None]

    def factorize(self, floor: Array, rank_tol: float) -> Factors:
        return RidgeFactors(self, np.sqrt(self.squares))


@dataclass(frozen=True, eq=False)
class RidgeFactors:
    """A border by its rows, columns damped in proportion to their lengths, shape (1, q)."""

    border: RowBorder
    lengths: Array

    @property
    def rank(self) -> IntArray:
        """See `Factors`: every parameter has a prior."""
        return np.array([len(self.border.precision)])

    @cached_property
    def gain(self) -> Array:
        """See `Factors`."""
        return np.vecdot(self.border.gradient, self._undamped)

    def step(self, damping: Array) -> Array:
        """See `Factors`; (1,) -> (1, q)."""
        return self._solve(damping) if damping.any() else self._undamped

    @cached_property
    def _undamped(self) -> Array:
        return self._solve(np.zeros(1))

    def _solve(self, damping: Array) -> Array:
        columns, precision = self.border.others[:-1], self.border.precision + damping * self.lengths[0] ** 2
        step, scaled = self.border.gradient[0] / precision, columns / precision[:, None]
        answer = np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ scaled, step @ columns)
        return np.asarray((step - scaled @ answer)[None])


@dataclass(frozen=True, eq=False)
class ArrowProducts:
    """Products of slopes and residuals at a point.

    Attributes
    ----------
    sharing : ParameterSharing
        Of p parameters of g groups, q of them shared.
    residual : array, shape (n,)
    cost : array, shape (g,)
        Weighted sum of squares; infinite, and all products 0, where the model has no value.
    own : array, shape (g, p - q, p - q)
        Products of the own parameters' slopes.
    across : array, shape (g, p - q, q + 1)
        Of these with the slopes of the shared parameters, and with the residual.
    border : Border
    """

    sharing: ParameterSharing
    residual: Array
    cost: Array
    own: Array
    across: Array
    border: Border

    @property
    def squares(self) -> Array:
        """Sum of squares of each slope, that of a shared parameter over all groups of the set, (g, p)."""
        return self._of_all(_diagonal(self.own), self.border.squares)

    @property
    def gradient(self) -> Array:
        """Products of the slopes with the residual, that of a shared parameter over all groups, (g, p)."""
        return self._of_all(self.across[:, :, -1], self.border.gradient)

    def _of_all(self, own: Array, shared: Array) -> Array:
        """Of own, (g, p - q), and shared parameters, (h, q); (g, p)."""
        whole = np.empty((len(own), len(self.sharing.parameters)))
        whole[:, ~self.sharing.parameters] = own
        whole[:, self.sharing.parameters] = shared[self.sharing.sets.of_row]
        return whole

    def fix_parameters(self, fixed: BoolArray, groups: Groups) -> ArrowProducts:
        """These products with some parameters, shape (g, p), fixed: shared ones in all groups of a set."""
        if not np.any(fixed):
            return self
        shared, of_set = self.sharing.parameters, self.sharing.sets.of_row
        free, of_sets = (
            (~fixed[:, ~shared]).astype(float),
            np.ones((len(self.sharing.sets), np.count_nonzero(shared))),
        )
        of_sets[of_set] = ~fixed[:, shared]
        across = self.across * free[:, :, None]
        across[:, :, :-1] *= of_sets[of_set, None]
        return replace(
            self,
            own=self.own * free[:, :, None] * free[:, None, :],
            across=across,
            border=self.border.fix_parameters(free, of_sets),
        )

    def merge(self, other: ArrowProducts, where: BoolArray, groups: Groups) -> ArrowProducts:
        """These products, but `other`'s in the groups `where`, which are all those of some sets."""
        if np.all(where):
            return other
        if not np.any(where):
            return self
        sets = np.zeros(len(self.sharing.sets), dtype=bool)
        sets[self.sharing.sets.of_row] = where
        return replace(
            self,
            residual=np.where(where[groups.of_row], other.residual, self.residual),
            cost=np.where(where, other.cost, self.cost),
            own=np.where(where[:, None, None], other.own, self.own),
            across=np.where(where[:, None, None], other.across, self.across),
            border=self.border.merge(other.border, sets),
        )

    def eliminate(self, inverse: Array) -> tuple[ReducedBorder, Array]:
        """The border without the own parameters, and how these follow the others, shaped as `across`.

        `inverse` is that of `own`.
        """
        follow = inverse @ self.across
        return self.border.eliminate(self.across, follow), follow


def multiply_arrow(
    sharing: ParameterSharing,
    groups: Groups,
    residual: Array,
    columns: Array,
    scales: Array,
    values: Array,
    precision: Array,
) -> ArrowProducts:
    """The products of the columns of [J, r], shape (p + 1, n), in units of the scales of parameters, (g, p).

    Shared parameters, at `values`, (q,), have priors of some `precision`, (q,), 0 where they have none.
    """
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
    border: Border
    if not precision.any():
        border = ProductBorder.of(sharing, groups, others)
    else:
        units = scales[0, shared]
        cost[0] += np.sum(precision * values**2)
        scaled, at = precision * units**2, values / units
        if len(scaled) > others.shape[1] and precision.all():
            border = RowBorder(own, others, scaled, -scaled * at, groups.of_row)
        else:
            border = ProductBorder.of(sharing, groups, others).add_priors(scaled, at)
    return ArrowProducts(sharing, residual, cost, products_by_group(own, groups), across, border)


def _sum_by_group(values: Array, groups: Groups) -> Array:
    """Sums of rows over each group, (m, n) -> (m, g)."""
    place = np.arange(len(values))[:, None] * len(groups) + groups.of_row
    return np.bincount(place.ravel(), values.ravel(), len(values) * len(groups)).reshape(len(values), -1)


def _diagonal(matrices: Array) -> Array:
    return np.diagonal(matrices, axis1=1, axis2=2)
