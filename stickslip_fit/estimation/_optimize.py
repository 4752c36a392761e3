"""Batched Levenberg-Marquardt: weighted nonlinear least squares of many groups at once.

Each group has its own parameters and damping. Damped steps after D. Marquardt (SIAM J. Appl. Math. 11:431,
1963), scaled as by J. Moré (Lecture Notes in Mathematics 630:105, 1978). Damping falls faster than it rises
(M. Transtrum and J. Sethna, arXiv:1201.5885, 2012), but ever faster from the fourth step refused in a row on
(H. B. Nielsen, IMM-REP-1999-05, DTU). Steps are undamped once the relative offset of D. Bates and D. Watts
(Technometrics 23:179, 1981) is small, or their gain rounding. Bounds are kept by an active set.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.laws.base import Model

# Summing J' J squares the condition number; beyond this ratio of eigenvalues too few digits are left, and the
# group's own Jacobian is decomposed instead.
CONDITION_TOL = 1e-9


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

    def fix_parameters(self, fixed: BoolArray, groups: Groups) -> NormalEquations:
        """These equations with some parameters, shape (g, p), fixed where they are."""
        if not np.any(fixed):
            return self
        free = np.concatenate([~fixed, np.ones((len(fixed), 1), dtype=bool)], axis=1)
        products = self.products * free[:, :, None] * free[:, None, :]
        return NormalEquations(self.residual, self.columns * free[groups.of_row].T, products)

    def select(self, some: BoolArray, groups: Groups) -> NormalEquations:
        """The equations of some groups."""
        rows = some[groups.of_row]
        return NormalEquations(self.residual[rows], self.columns[:, rows], self.products[some])

    def merge(self, other: NormalEquations, where: BoolArray, groups: Groups) -> NormalEquations:
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
    singular_values : array, shape (g, p)
        0 for directions that are not identified.
    vectors : array, shape (g, p, p)
        Right singular vectors in columns.
    projections : array, shape (g, p)
        The residual along each left singular vector.
    """

    lengths: Array
    singular_values: Array
    vectors: Array
    projections: Array

    @cached_property
    def rank(self) -> IntArray:
        """Directions that are identified, shape (g,)."""
        return np.sum(self.singular_values > 0, axis=1)

    @cached_property
    def gain(self) -> Array:
        """By how much an undamped step lowers the quadratic form, shape (g,)."""
        return np.sum(np.where(self.singular_values > 0, self.projections**2, 0.0), axis=1)

    def step(self, damping: Array) -> Array:
        """Step to the minimum of the damped quadratic form, in units of the scales; (g,) -> (g, p)."""
        divisor = np.where(self.singular_values > 0, self.singular_values**2 + damping[:, None], np.inf)
        return (
            np.einsum("gij,gj->gi", self.vectors, self.singular_values * self.projections / divisor)
            / self.lengths
        )

    def inverse(self) -> Array:
        """Pseudo-inverse of the quadratic form, in units of the scales, shape (g, p, p)."""
        columns = self.vectors / self.lengths[:, :, None]
        divisor = np.where(self.singular_values > 0, self.singular_values**2, np.inf)
        return (columns / divisor[:, None, :]) @ columns.swapaxes(1, 2)


def products_by_group(columns: Array, groups: Groups) -> Array:
    """Products of every two of the columns summed over each group, shape (m, n) -> (g, m, m)."""
    m = len(columns)
    products = np.empty((len(groups), m, m))
    if len(groups) < m * (m + 1) // 4:  # fewer products of matrices than sums of products of two columns
        for k, rows in enumerate(groups.rows):
            own = columns[:, rows]
            np.matmul(own, own.T, out=products[k])
        return products
    for i in range(m):
        for j in range(i + 1):
            products[:, i, j] = products[:, j, i] = groups.sums(columns[i] * columns[j])
    return products


def normal_equations(
    model: Model, y: Array, weight: Array, groups: Groups, values: Array, scales: Array
) -> NormalEquations:
    """Evaluate the model at each group's values and sum up what follows."""
    p = scales.shape[1]
    with np.errstate(all="ignore"):
        residual, columns = weighted_columns(model, y, weight, values[groups.of_row])
        products = products_by_group(columns, groups)
        units = np.concatenate([scales, np.ones((len(groups), 1))], axis=1)
        products *= units[:, :, None] * units[:, None, :]
    # A trial that leaves the model's domain costs infinitely much and is not taken.
    outside = ~np.all(np.isfinite(products), axis=(1, 2))
    products[outside], products[outside, p, p] = 0.0, np.inf
    return NormalEquations(residual, columns, products)


def weighted_columns(model: Model, y: Array, weight: Array, values: Array) -> tuple[Array, Array]:
    """Residuals, (n,), and root weight times [J, r], (p + 1, n), at the values of each row, (n, p)."""
    # One contiguous row a column of [J, r]: summing by group is then a single pass over memory each.
    root, columns = np.sqrt(weight), np.empty((values.shape[1] + 1, len(y)))
    predicted, jacobian = model(values)
    residual = y - predicted
    columns[:-1], columns[-1] = jacobian.T * root, residual * root
    return residual, columns


def factorize(
    products: Array,
    gradient: Array,
    lengths: Array,
    rank_tol: float,
    whitened: Callable[[int, Array], tuple[Array, Array]] | None = None,
) -> SingularFactors:
    """Singular values and vectors of each group's Jacobian from J' W J, (g, p, p), and J' W r, (g, p).

    Columns are divided by `lengths`, (g, p), the greatest of each so far. Columns and directions with a
    smaller share of the greatest than `rank_tol` are not identified. `whitened` gives the Jacobian, divided
    by its lengths, and the residual of a group whose products have lost too many digits.
    """
    floor = rank_tol * np.max(lengths, axis=1, keepdims=True, initial=0.0)
    lengths = np.maximum(np.maximum(lengths, floor), np.finfo(float).tiny ** 0.25)
    eigenvalue, vectors = np.linalg.eigh(products / (lengths[:, :, None] * lengths[:, None, :]))
    singular = np.sqrt(np.maximum(eigenvalue, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        projections = np.einsum("gji,gj->gi", vectors, gradient / lengths) / singular
    projections = np.where(singular > 0, projections, 0.0)
    if whitened is not None and rank_tol**2 < CONDITION_TOL / 10:
        greatest = np.max(eigenvalue, axis=1, initial=np.finfo(float).tiny)
        share = np.min(eigenvalue, axis=1, initial=np.inf) / greatest
        for group in np.flatnonzero(share < CONDITION_TOL).tolist():
            jacobian, residual = whitened(group, lengths[group])
            left, singular[group], right = svd(jacobian)
            vectors[group], projections[group] = right.T, left.T @ residual
    known = singular > rank_tol * np.max(singular, axis=1, keepdims=True, initial=0.0)
    return SingularFactors(lengths, np.where(known, singular, 0.0), vectors, projections)


RowSubsetModel = Callable[[IntArray], Model]
"""Positions of some rows to the model of these."""

# A direction of parameter space that changes the response by less than this share of what a parameter of
# ordinary effect does is not known from the data, whatever the arithmetic says.
RANK_TOL = 1e-5
REL_OFFSET_TOL = 1e-6
DAMPING_UP, DAMPING_DOWN, FIRST_DAMPING, MAX_DAMPING = 2.0, 3.0, 1e-2, 1e20
MIN_ROWS_FRACTION, MIN_ROWS = 0.5, 300  # of groups still searched, below which the others are left out
PATIENCE = 10  # iterations
BOUND_TOL = 1e-9  # of the scales


@dataclass(frozen=True)
class Minimum:
    """The minimum of a sum of squares.

    Attributes
    ----------
    values : array, shape (g, p)
    curvature : array, shape (g, p, p)
        J' W J at the minimum, SI; see `solve_block_arrow` for that of parameters that groups share.
    residual : array, shape (n,)
    converged : array of bool, shape (g,)
        The last step was below the tolerance; all parameters are determined only where rank is p.
    rank : array of int, shape (g,)
        Directions of parameter space that the data determine.
    at_bound : array of bool, shape (g, p)
        Parameters held back by a bound: the sum of squares would fall beyond it.
    """

    values: Array
    curvature: Array
    residual: Array
    converged: BoolArray
    rank: IntArray
    at_bound: BoolArray
    iterations: int

    def merge(self, other: Minimum, some: BoolArray, groups: Groups) -> Minimum:
        """With the minimum of a search that went on with some of the groups alone."""
        whole = {name: getattr(self, name).copy() for name in ("values", "curvature", "converged", "rank")}
        whole |= {"at_bound": self.at_bound.copy(), "residual": self.residual.copy()}
        for name, array in whole.items():
            array[some[groups.of_row] if name == "residual" else some] = getattr(other, name)
        return Minimum(**whole, iterations=self.iterations + other.iterations)


def minimize(
    model: Model,
    y: Array,
    weight: Array,
    groups: Groups,
    start: Array,
    scales: Array,
    *,
    subset: RowSubsetModel | None = None,
    lower: Array | float = -np.inf,
    upper: Array | float = np.inf,
    damping: float = FIRST_DAMPING,
    rank_tol: float = RANK_TOL,
    tolerance: float = 1e-8,
    most: int = 2000,
) -> Minimum:
    """Minimize each group's sum of weight (y - model)^2.

    Parameters
    ----------
    model : callable
        Values of each row's group, shape (n, p), to responses and derivatives; see `StepLaw.model`.
    y, weight : array, shape (n,)
    start, scales : array, shape (g, p)
        Where to begin, and a change of each parameter that matters.
    subset : callable, optional
        Positions of some rows to their model. With it the time that a slow group takes does not grow with the
        others, which are left out once they have converged.
    lower, upper : array, broadcast to shape (g, p), optional
        Bounds of the parameters. A step is cut off at a bound; a parameter that lies on one, and would
        leave it, stays while the others move (active set).
    damping : float, optional
        At the start; 0 where the model is nearly linear and undamped steps can be trusted from there.
    rank_tol : float, optional
        Directions with a smaller share of the largest effect are left alone as not identified.
    tolerance : float, optional
        A group has converged when its undamped step is below this share of the scales.
    most : int, optional
        Iterations before a group is given up as not converged.

    """
    low, high = np.broadcast_to(lower, scales.shape), np.broadcast_to(upper, scales.shape)
    objective = _GroupObjective(
        model, y, weight, groups, scales, low, high, rank_tol, tolerance, subset=subset
    )
    return search(objective, start, damping, most)


class Factors(Protocol):
    """The solved normal equations of u units; see `SingularFactors`."""

    @property
    def rank(self) -> IntArray:
        """Directions that are identified, shape (u,)."""

    @property
    def gain(self) -> Array:
        """By how much an undamped step lowers the quadratic form, shape (u,)."""

    def step(self, damping: Array) -> Array:
        """Damped step in units of the scales, shape (u,) -> (g, p)."""


@dataclass(frozen=True, eq=False)
class Objective[E](ABC):
    """The sums of squares of g groups of n rows, and the accuracy of their minimum; see `minimize`.

    What can only move together is a unit: as a rule each group by itself. One whose sum of squares falls by a
    smaller share than `least_fall` in `PATIENCE` iterations is given up; one whose falls by a smaller share
    than `settled_fall` has converged. `E` are the products of slopes and residuals at a point, as of
    `NormalEquations`.
    """

    model: Model
    y: Array
    weight: Array
    groups: Groups
    scales: Array
    lower: Array
    upper: Array
    rank_tol: float
    tolerance: float
    offset_tol: float = 0.0
    subset: RowSubsetModel | None = None
    least_fall: float = 0.0
    settled_fall: float = 0.0

    @property
    def sizes(self) -> IntArray:
        """Rows of each unit, shape (u,)."""
        return self.groups.sizes

    def of_group[T: np.generic](self, values: npt.NDArray[T]) -> npt.NDArray[T]:
        """Each unit's values for its groups, shape (u, ...) -> (g, ...)."""
        return values

    def of_unit(self, values: Array) -> Array:
        """Sum over each unit's groups, shape (g,) -> (u,)."""
        return values

    def largest(self, values: Array) -> Array:
        """Largest value in each unit, shape (g, p) -> (u,)."""
        return np.max(values, axis=1, initial=0.0)

    @abstractmethod
    def normal_equations(self, values: Array) -> E:
        """Residuals, slopes and their products at a point, shape (g, p)."""

    @abstractmethod
    def gradient(self, here: E) -> Array:
        """By how much half the sum of squares falls with each parameter, shape (g, p)."""

    @abstractmethod
    def lengths(self, here: E) -> Array:
        """Length of each parameter's slopes, shape (g, p)."""

    @abstractmethod
    def factors(self, here: E, lengths: Array) -> Factors:
        """The units' normal equations at a point, solved."""

    @abstractmethod
    def rank(self, here: E, lengths: Array) -> IntArray:
        """Directions that the data determine, shape (g,)."""

    @abstractmethod
    def curvature(self, here: E) -> Array:
        """See `Minimum.curvature`."""

    def rounding(self, residual: Array) -> Array:
        """By how much the sums of squares may be wrong, shape (n,) -> (u,)."""
        size = self.weight * np.abs(residual) * (np.abs(self.y) + np.abs(self.y - residual))
        return self.of_unit(np.finfo(float).eps * self.groups.sums(size))

    def bound(self, values: Array) -> Array:
        """Parameters within their bounds, shape (g, p); what is next to a bound is on it.

        By rounding beside its bound a parameter would not count as on it, and every step would be cut off.
        """
        lower, upper, near = self.lower, self.upper, BOUND_TOL * self.scales
        return np.where(values < lower + near, lower, np.where(values > upper - near, upper, values))

    def active_bounds(self, here: E, values: Array) -> BoolArray:
        """Parameters on a bound that the data would push beyond it, shape (g, p)."""
        neg_gradient = self.gradient(here)
        return ((values <= self.lower) & (neg_gradient < 0)) | ((values >= self.upper) & (neg_gradient > 0))

    def select(self, some: BoolArray, subset: RowSubsetModel) -> Self:
        """The objective of some of the groups."""
        rows = np.flatnonzero(some[self.groups.of_row])
        arrays: dict[str, Any] = {name: getattr(self, name)[some] for name in ("scales", "lower", "upper")}
        arrays |= {name: getattr(self, name)[rows] for name in ("y", "weight")}
        groups, fewer = self.groups.select(some), lambda few: subset(rows[few])
        return replace(self, model=subset(rows), subset=fewer, groups=groups, **arrays)


class _GroupObjective(Objective[NormalEquations]):
    """Of groups that are units by themselves."""

    def normal_equations(self, values: Array) -> NormalEquations:
        return normal_equations(self.model, self.y, self.weight, self.groups, values, self.scales)

    def gradient(self, here: NormalEquations) -> Array:
        return here.products[:, :-1, -1]

    def lengths(self, here: NormalEquations) -> Array:
        return here.norms

    def factors(self, here: NormalEquations, lengths: Array) -> Factors:
        def whitened(group: int, lengths: Array) -> tuple[Array, Array]:
            rows = self.groups.of_row == group
            return here.columns[:-1, rows].T * (self.scales[group] / lengths), here.columns[-1, rows]

        form, gradient = here.products[:, :-1, :-1], here.products[:, :-1, -1]
        return factorize(form, gradient, lengths, self.rank_tol, whitened)

    def rank(self, here: NormalEquations, lengths: Array) -> IntArray:
        return self.factors(here, lengths).rank

    def curvature(self, here: NormalEquations) -> Array:
        return here.curvature(self.scales)


@dataclass(frozen=True, eq=False)
class _State:
    """State of the search.

    `here` is of `Objective.normal_equations`, `lengths` are the greatest so far, `last_size` that of the last
    undamped step; `refused` counts the steps refused in a row. `factors` are kept while no unit moves, None
    after that.
    """

    values: Array
    here: Any
    lengths: Array
    damping: Array
    refused: IntArray
    last_size: Array
    converged: BoolArray
    diverged: BoolArray
    factors: Factors | None = None

    @property
    def active(self) -> BoolArray:
        """Units that are still searched, shape (u,)."""
        return ~(self.converged | self.diverged)

    def select(self, some: BoolArray, groups: Groups) -> _State:
        """The state of some groups that are units."""
        names = ("values", "lengths", "damping", "refused", "last_size", "converged", "diverged")
        return _State(
            here=self.here.select(some, groups), **{name: getattr(self, name)[some] for name in names}
        )


def search(objective: Objective[Any], start: Array, damping: float, most: int) -> Minimum:
    """Minimize an objective from start values, shape (g, p); see `minimize`."""
    values = objective.bound(start)
    here, units = objective.normal_equations(values), len(objective.sizes)
    state = _State(
        values=values,
        here=here,
        lengths=np.zeros(values.shape),
        damping=np.full(units, damping),
        refused=np.zeros(units, dtype=np.intp),
        last_size=np.full(units, np.inf),
        converged=np.zeros(units, dtype=bool),
        diverged=~np.isfinite(objective.of_unit(here.cost)),
    )
    return _iterate(objective, state, most)


def _iterate(objective: Objective[Any], state: _State, most: int) -> Minimum:
    before = np.full(len(state.damping), np.inf)
    for iteration in range(most):
        if (objective.least_fall or objective.settled_fall) and iteration % PATIENCE == 0:
            cost = objective.of_unit(state.here.cost)
            settled = (cost > (1.0 - objective.settled_fall) * before) & (state.refused == 0)
            state = replace(state, converged=state.converged | (settled & ~state.diverged))
            stuck = cost > (1.0 - objective.least_fall) * before
            state, before = replace(state, diverged=state.diverged | (stuck & ~state.converged)), cost
        active = state.active
        if not active.any():
            return _build_minimum(objective, state, iteration)
        few = objective.sizes[active].sum() < MIN_ROWS_FRACTION * len(objective.y)
        if objective.subset is not None and few and len(objective.y) > MIN_ROWS:
            others = objective.select(active, objective.subset)
            minimum = _iterate(others, state.select(active, objective.groups), most - iteration)
            return _build_minimum(objective, state, iteration).merge(minimum, active, objective.groups)
        state = _advance(objective, state)
    return _build_minimum(objective, state, most)


def _advance(objective: Objective[Any], state: _State) -> _State:
    values, here, damping, active = state.values, state.here, state.damping, state.active
    lengths = np.maximum(state.lengths, objective.lengths(here))
    factors = state.factors
    if factors is None:
        free = here.fix_parameters(objective.active_bounds(here, values), objective.groups)
        factors = objective.factors(free, lengths)
    undamped, cost = factors.step(np.zeros(len(damping))), objective.of_unit(here.cost)
    offset = relative_offset(factors, cost, objective.sizes)
    rounding = objective.rounding(here.residual)
    near = (offset < REL_OFFSET_TOL) | (factors.gain < rounding)
    size = objective.largest(np.abs(undamped))
    # Steps that no longer shrink, so near the minimum, are rounding noise.
    close = (size < objective.tolerance) | (near & (size >= state.last_size))
    close |= offset < objective.offset_tol
    step = undamped
    if damping.any():
        step = np.where(objective.of_group(near | close)[:, None], undamped, factors.step(damping))
    trial = objective.bound(values + step * objective.scales)
    trial = np.where(objective.of_group(active)[:, None], trial, values)
    there = objective.normal_equations(trial)
    new_cost = objective.of_unit(there.cost)
    # Near the minimum the cost changes by rounding alone, and a tiny step is right all the same.
    slack = np.where(near, np.maximum(1e-10 * cost, rounding), 0.0)
    better = active & ((new_cost <= cost + slack) | (close & np.isfinite(new_cost)))
    converged = state.converged | ((close | (near & ~better)) & ~state.diverged)
    higher = damping * DAMPING_UP ** np.maximum(state.refused - 1.0, 1.0)
    higher = np.minimum(np.where(damping == 0, FIRST_DAMPING, higher), MAX_DAMPING)
    damping = np.where(better, damping / DAMPING_DOWN, higher)
    taken = objective.of_group(better)
    return _State(
        values=np.where(taken[:, None], trial, values),
        here=here.merge(there, taken, objective.groups),
        lengths=lengths,
        damping=damping,
        refused=np.where(better | ~active, 0, state.refused + 1),
        last_size=np.where(near, size, np.inf),
        converged=converged,
        diverged=state.diverged | ((damping >= MAX_DAMPING) & ~converged),
        factors=None if better.any() else factors,
    )


def relative_offset(factors: Factors, cost: Array, sizes: IntArray) -> Array:
    """How much of the residual an undamped step would still remove, shape (u,)."""
    rank = np.maximum(factors.rank, 1)
    beyond = np.maximum(cost - factors.gain, np.finfo(float).tiny)
    with np.errstate(over="ignore"):
        return np.sqrt(factors.gain / rank * np.maximum(sizes - rank, 1) / beyond)


def _build_minimum(objective: Objective[Any], state: _State, iterations: int) -> Minimum:
    values, here = state.values, state.here
    return Minimum(
        values=values,
        curvature=objective.curvature(here),
        residual=here.residual,
        converged=objective.of_group(state.converged),
        rank=objective.rank(here, np.maximum(state.lengths, objective.lengths(here))),
        at_bound=objective.active_bounds(here, values),
        iterations=iterations,
    )
