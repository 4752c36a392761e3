"""Normal equations of each group, and their solution by singular values."""

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
class NormalEquations:
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

    def without(self, held: npt.NDArray[np.bool_], groups: Groups) -> NormalEquations:
        """These equations with some parameters, shape (g, p), held where they are."""
        if not np.any(held):
            return self
        free = np.concatenate([~held, np.ones((len(held), 1), dtype=bool)], axis=1)
        products = self.products * free[:, :, None] * free[:, None, :]
        return NormalEquations(self.residual, self.columns * free[groups.of_row].T, products)

    def of(self, some: npt.NDArray[np.bool_], groups: Groups) -> NormalEquations:
        """The equations of some groups."""
        rows = some[groups.of_row]
        return NormalEquations(self.residual[rows], self.columns[:, rows], self.products[some])

    def replaced(
        self, other: NormalEquations, where: npt.NDArray[np.bool_], groups: Groups
    ) -> NormalEquations:
        """These equations, but `other`'s in the groups `where`."""
        if np.all(where):
            return other
        rows = where[groups.of_row]
        return NormalEquations(
            np.where(rows, other.residual, self.residual),
            np.where(rows, other.columns, self.columns),
            np.where(where[:, None, None], other.products, self.products),
        )


@dataclass(frozen=True)
class SingularFactors:
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

    @property
    def gain(self) -> Array:
        """By how much an undamped step lowers the quadratic form, shape (g,)."""
        return np.sum(np.where(self.singular > 0, self.along**2, 0.0), axis=1)

    def step(self, damping: Array) -> Array:
        """Step to the minimum of the damped quadratic form, in units of the scales; (g,) -> (g, p)."""
        divisor = np.where(self.singular > 0, self.singular**2 + damping[:, None], np.inf)
        return np.einsum("gij,gj->gi", self.vectors, self.singular * self.along / divisor) / self.lengths

    def inverse(self) -> Array:
        """Pseudo-inverse of the quadratic form, in units of the scales, shape (g, p, p)."""
        columns = self.vectors / self.lengths[:, :, None]
        divisor = np.where(self.singular > 0, self.singular**2, np.inf)
        return (columns / divisor[:, None, :]) @ columns.swapaxes(1, 2)


def products_by_group(columns: Array, groups: Groups) -> Array:
    """Products of every two of the columns summed over each group, shape (m, n) -> (g, m, m)."""
    m = len(columns)
    products = np.empty((len(groups), m, m))
    for i in range(m):
        for j in range(i + 1):
            products[:, i, j] = products[:, j, i] = groups.sums(columns[i] * columns[j])
    return products


def normal_equations(
    model: Model, y: Array, weight: Array, groups: Groups, values: Array, scales: Array
) -> NormalEquations:
    """Evaluate the model at each group's values and sum up what follows."""
    predicted, jacobian = model(values[groups.of_row])
    residual = y - predicted
    p, root = scales.shape[1], np.sqrt(weight)
    # One contiguous row a column of [J, r]: summing by group is then a single pass over memory each.
    columns = np.empty((p + 1, len(y)))
    columns[:p], columns[p] = jacobian.T * root, residual * root
    with np.errstate(over="ignore", invalid="ignore"):
        products = products_by_group(columns, groups)
        units = np.concatenate([scales, np.ones((len(groups), 1))], axis=1)
        products *= units[:, :, None] * units[:, None, :]
    # A trial that leaves the model's domain costs infinitely much and is not taken.
    outside = ~np.all(np.isfinite(products), axis=(1, 2))
    products[outside], products[outside, p, p] = 0.0, np.inf
    return NormalEquations(residual, columns, products)


def factorise(
    here: NormalEquations, groups: Groups, scales: Array, lengths: Array, rank_tol: float
) -> SingularFactors:
    """Singular values and vectors of each group's Jacobian.

    Parameters
    ----------
    here : NormalEquations
    groups : Groups
    scales : array, shape (g, p)
    lengths : array, shape (g, p)
        Greatest length of each column so far, by which the columns are divided.
    rank_tol : float
        Columns and directions with a smaller share of the greatest are not identified.
    """
    lengths = _at_least(lengths, rank_tol)
    eigenvalue, singular, vectors, along = _eigen(
        here.products[:, :-1, :-1], here.products[:, :-1, -1], lengths
    )
    greatest = np.max(eigenvalue, axis=1, initial=np.finfo(float).tiny)
    share = np.min(eigenvalue, axis=1, initial=np.inf) / greatest
    for group in np.flatnonzero((share < WELL_CONDITIONED) & (rank_tol**2 < WELL_CONDITIONED / 10)):
        rows = groups.of_row == group
        slopes = here.columns[:-1, rows].T * (scales[group] / lengths[group])
        left, singular[group], right = np.linalg.svd(slopes, full_matrices=False)
        vectors[group], along[group] = right.T, left.T @ here.columns[-1, rows]
    known = singular > rank_tol * np.max(singular, axis=1, keepdims=True, initial=0.0)
    return SingularFactors(lengths, np.where(known, singular, 0.0), vectors, along)


def factorise_products(products: Array, gradient: Array, lengths: Array, rank_tol: float) -> SingularFactors:
    """As `factorise`, from J' W J, shape (g, p, p), and J' W r, shape (g, p), alone."""
    lengths = _at_least(lengths, rank_tol)
    _, singular, vectors, along = _eigen(products, gradient, lengths)
    known = singular > rank_tol * np.max(singular, axis=1, keepdims=True, initial=0.0)
    return SingularFactors(lengths, np.where(known, singular, 0.0), vectors, along)


def _at_least(lengths: Array, rank_tol: float) -> Array:
    floor = rank_tol * np.max(lengths, axis=1, keepdims=True, initial=0.0)
    return np.maximum(np.maximum(lengths, floor), np.finfo(float).tiny ** 0.25)


def _eigen(products: Array, gradient: Array, lengths: Array) -> tuple[Array, Array, Array, Array]:
    """Eigenvalues, singular values, right singular vectors, and the residual along the left ones."""
    eigenvalue, vectors = np.linalg.eigh(products / (lengths[:, :, None] * lengths[:, None, :]))
    singular = np.sqrt(np.maximum(eigenvalue, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.einsum("gji,gj->gi", vectors, gradient / lengths) / singular
    return eigenvalue, singular, vectors, np.where(singular > 0, along, 0.0)
