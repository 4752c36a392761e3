"""What least squares needs to know around a point: residuals, slopes, and each group's quadratic form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.groups import Groups
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]

# Summing J' J squares the condition number; beyond this ratio of eigenvalues too few digits are left, and the
# group's own Jacobian is decomposed instead.
WELL_CONDITIONED = 1e-9


@dataclass(frozen=True)
class Moments:
    """Residuals and slopes at a point, and their products summed over each group.

    Attributes
    ----------
    residual : array, shape (n,)
    columns : array, shape (p + 1, n)
        Root weight times each slope, and times the residual.
    products : array, shape (g, p + 1, p + 1)
        Their products summed by group; infinite cost and nothing else where the model has no value.
    """

    residual: Array
    columns: Array
    products: Array

    @property
    def cost(self) -> Array:
        """Weighted sum of squares, shape (g,)."""
        return self.products[:, -1, -1]

    @property
    def norms(self) -> Array:
        """Length of each slope, shape (g, p)."""
        return np.sqrt(np.diagonal(self.products, axis1=1, axis2=2)[:, :-1])

    def curvature(self, scales: Array) -> Array:
        """J' W J in the parameters' own units, shape (g, p, p)."""
        return self.products[:, :-1, :-1] / (scales[:, :, None] * scales[:, None, :])

    def without(self, held: npt.NDArray[np.bool_], groups: Groups) -> Moments:
        """These moments with some parameters, shape (g, p), held where they are."""
        if not np.any(held):
            return self
        free = np.concatenate([~held, np.ones((len(held), 1), dtype=bool)], axis=1)
        products = self.products * free[:, :, None] * free[:, None, :]
        return Moments(self.residual, self.columns * free[groups.of_row].T, products)

    def of(self, some: npt.NDArray[np.bool_], groups: Groups) -> Moments:
        """The moments of some groups."""
        rows = some[groups.of_row]
        return Moments(self.residual[rows], self.columns[:, rows], self.products[some])

    def replaced(self, other: Moments, where: npt.NDArray[np.bool_], groups: Groups) -> Moments:
        """These moments, but `other`'s in the groups `where`."""
        if np.all(where):
            return other
        rows = where[groups.of_row]
        return Moments(
            np.where(rows, other.residual, self.residual),
            np.where(rows, other.columns, self.columns),
            np.where(where[:, None, None], other.products, self.products),
        )


@dataclass(frozen=True)
class Factors:
    """Singular values and vectors of each group's Jacobian, its columns divided by `lengths`.

    Attributes
    ----------
    lengths : array, shape (g, p)
    singular : array, shape (g, p)
        0 for directions that are not identified.
    vectors : array, shape (g, p, p)
        Right singular vectors in columns.
    along : array, shape (g, p)
        The residual along each left singular vector.
    """

    lengths: Array
    singular: Array
    vectors: Array
    along: Array

    @property
    def rank(self) -> npt.NDArray[np.intp]:
        """Directions that are identified, shape (g,)."""
        return np.sum(self.singular > 0, axis=1)

    def step(self, damping: Array) -> Array:
        """Step to the minimum of the damped quadratic form, in units of the scales; (g,) -> (g, p)."""
        divisor = np.where(self.singular > 0, self.singular**2 + damping[:, None], np.inf)
        return np.einsum("gij,gj->gi", self.vectors, self.singular * self.along / divisor) / self.lengths

    def offset(self, cost: Array, sizes: npt.NDArray[np.intp]) -> Array:
        """Relative offset: how much of the residual an undamped step would still remove, shape (g,)."""
        rank = np.maximum(self.rank, 1)
        within = np.sum(np.where(self.singular > 0, self.along**2, 0.0), axis=1)
        beyond = np.maximum(cost - within, np.finfo(float).tiny)
        with np.errstate(over="ignore"):
            return np.sqrt(within / rank * np.maximum(sizes - rank, 1) / beyond)


def moments_of(
    model: Model, y: Array, weight: Array, groups: Groups, values: Array, scales: Array
) -> Moments:
    """Evaluate the model at each group's values and sum up what follows."""
    predicted, jacobian = model(values[groups.of_row])
    residual = y - predicted
    p, root = scales.shape[1], np.sqrt(weight)
    # One contiguous row a column of [J, r]: summing by group is then a single pass over memory each.
    columns = np.empty((p + 1, len(y)))
    columns[:p], columns[p] = jacobian.T * root, residual * root
    products = np.empty((len(groups), p + 1, p + 1))
    with np.errstate(over="ignore", invalid="ignore"):
        for i in range(p + 1):
            for j in range(i + 1):
                products[:, i, j] = products[:, j, i] = groups.sums(columns[i] * columns[j])
        units = np.concatenate([scales, np.ones((len(groups), 1))], axis=1)
        products *= units[:, :, None] * units[:, None, :]
    # A trial that leaves the model's domain costs infinitely much and is not taken.
    outside = ~np.all(np.isfinite(products), axis=(1, 2))
    products[outside], products[outside, p, p] = 0.0, np.inf
    return Moments(residual, columns, products)


def factorise(here: Moments, groups: Groups, scales: Array, lengths: Array, smallest: float) -> Factors:
    """Singular values and vectors of each group's Jacobian.

    Parameters
    ----------
    here : Moments
    groups : Groups
    scales : array, shape (g, p)
    lengths : array, shape (g, p)
        Greatest length of each column so far, by which the columns are divided.
    smallest : float
        Columns and directions with a smaller share of the greatest are not identified.
    """
    floor = smallest * np.max(lengths, axis=1, keepdims=True, initial=0.0)
    lengths = np.maximum(np.maximum(lengths, floor), np.finfo(float).tiny ** 0.25)
    form = here.products[:, :-1, :-1] / (lengths[:, :, None] * lengths[:, None, :])
    eigenvalue, vectors = np.linalg.eigh(form)
    singular = np.sqrt(np.maximum(eigenvalue, 0.0))
    gradient = np.einsum("gji,gj->gi", vectors, here.products[:, :-1, -1] / lengths)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(singular > 0, gradient / singular, 0.0)
    greatest = np.max(eigenvalue, axis=1, initial=np.finfo(float).tiny)
    share = np.min(eigenvalue, axis=1, initial=np.inf) / greatest
    for group in np.flatnonzero((share < WELL_CONDITIONED) & (smallest**2 < WELL_CONDITIONED / 10)):
        rows = groups.of_row == group
        slopes = here.columns[:-1, rows].T * (scales[group] / lengths[group])
        left, singular[group], right = np.linalg.svd(slopes, full_matrices=False)
        vectors[group], along[group] = right.T, left.T @ here.columns[-1, rows]
    known = singular > smallest * np.max(singular, axis=1, keepdims=True, initial=0.0)
    return Factors(lengths, np.where(known, singular, 0.0), vectors, along)
