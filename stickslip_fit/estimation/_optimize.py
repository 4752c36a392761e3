"""Batched Levenberg-Marquardt: weighted nonlinear least squares of many groups at once.

Each group has its own parameters and damping. Damped steps after D. Marquardt (SIAM J. Appl. Math.
11:431, 1963), scaled as by J. Moré (Lecture Notes in Mathematics 630:105, 1978); damping falls faster
than it rises (M. Transtrum and J. Sethna, arXiv:1201.5885, 2012). Steps are undamped once the relative
offset of D. Bates and D. Watts (Technometrics 23:179, 1981) is small. Bounds are kept by an active set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.laws import traverse_length
from stickslip_fit.laws.base import Model
from stickslip_fit.logs import Log


@dataclass(frozen=True)
class Groups:
    """The groups of one joint's rows.

    Attributes
    ----------
    table : DataFrame
        Columns session and direction, one row per group, in order of time.
    of_row : array of int, shape (n,)
        Group of each row.
    """

    table: pd.DataFrame
    of_row: IntArray

    def __len__(self) -> int:
        return len(self.table)

    @property
    def sizes(self) -> IntArray:
        """Rows in each group, shape (g,)."""
        return np.bincount(self.of_row, minlength=len(self))

    def sums(self, values: Array) -> Array:
        """Sum over each group's rows, shape (n,) -> (g,).

        Examples
        --------
        >>> rows = pd.DataFrame({"session": ["a", "a", "b"], "direction": ["+", "+", "-"]})
        >>> group_rows(rows).sums(np.array([1.0, 2.0, 4.0]))
        array([3., 4.])
        """
        return np.bincount(self.of_row, values, len(self))

    def of(self, some: npt.NDArray[np.bool_]) -> Groups:
        """Some of the groups, with nothing but their rows."""
        number = np.cumsum(some) - 1
        return Groups(self.table[some].reset_index(drop=True), number[self.of_row[some[self.of_row]]])


def group_rows(rows: pd.DataFrame) -> Groups:
    """Group rows, which stand in order of time, by session and direction."""
    session, sessions = pd.factorize(rows["session"].astype(object))
    backwards = (rows["direction"] == "-").to_numpy()
    kinds, of_row = np.unique(2 * session + backwards, return_inverse=True)
    table = pd.DataFrame(
        {
            "session": np.asarray(sessions, dtype=object)[kinds // 2],
            "direction": np.where(kinds % 2 == 1, "-", "+").astype(object),
        }
    )
    return Groups(table, of_row)


def mean_step_sizes(groups: Groups, rows: pd.DataFrame, response: Array) -> Array:
    """Geometric mean of each group's step sizes, shape (g,); `response` is log(steps), shape (n,)."""
    return np.exp(groups.sums(np.log(traverse_length(rows)) - response) / groups.sizes)


def usable_rows(log: Log) -> pd.DataFrame:
    """The traverses of a log that may be fitted.

    Raises
    ------
    InputError
        If there is none.
    """
    rows = log.usable
    if rows.empty:
        raise InputError("the log has no usable traverse: every row is interrupted or excluded")
    return rows


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

    def merge(self, other: NormalEquations, where: npt.NDArray[np.bool_], groups: Groups) -> NormalEquations:
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
    along : array, shape (g, p)
        The residual along each left singular vector.
    """

    lengths: Array
    singular_values: Array
    vectors: Array
    along: Array

    @property
    def rank(self) -> npt.NDArray[np.intp]:
        """Directions that are identified, shape (g,)."""
        return np.sum(self.singular_values > 0, axis=1)

    @property
    def gain(self) -> Array:
        """By how much an undamped step lowers the quadratic form, shape (g,)."""
        return np.sum(np.where(self.singular_values > 0, self.along**2, 0.0), axis=1)

    def step(self, damping: Array) -> Array:
        """Step to the minimum of the damped quadratic form, in units of the scales; (g,) -> (g, p)."""
        divisor = np.where(self.singular_values > 0, self.singular_values**2 + damping[:, None], np.inf)
        return (
            np.einsum("gij,gj->gi", self.vectors, self.singular_values * self.along / divisor) / self.lengths
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


def factorize_jacobian(
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
    for group in np.flatnonzero((share < CONDITION_TOL) & (rank_tol**2 < CONDITION_TOL / 10)):
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


RowSubsetModel = Callable[[IntArray], Model]
"""Positions of some rows to the model of these."""

# A direction of parameter space that changes the response by less than this share of what a parameter of
# ordinary effect does is not known from the data, whatever the arithmetic says.
RANK_TOL = 1e-5
REL_OFFSET_TOL = 1e-6
DAMPING_UP, DAMPING_DOWN, FIRST_DAMPING, MAX_DAMPING = 2.0, 3.0, 1e-2, 1e20
# A search goes on without the groups that are done as soon as they have most rows of a log of some size.
MIN_ROWS_FRACTION, MIN_ROWS = 0.5, 1000


@dataclass(frozen=True)
class Minimum:
    """Where the search ended.

    Attributes
    ----------
    values : array, shape (g, p)
    curvature : array, shape (g, p, p)
        J' W J at the minimum, SI.
    residual : array, shape (n,)
    converged : array of bool, shape (g,)
        The last step was below the tolerance; all parameters are determined only where rank is p.
    rank : array of int, shape (g,)
        Directions of parameter space that the data determine.
    at_bound : array of bool, shape (g, p)
        Parameters held back by a bound: the sum of squares would fall beyond it.
    iterations : int
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
    """Minimise each group's sum of weight (y - model)^2.

    Parameters
    ----------
    model : callable
        Values of each row's group, shape (n, p), to responses and derivatives; see `StepLaw.model`.
    y, weight : array, shape (n,)
    groups : Groups
    start, scales : array, shape (g, p)
        Where to begin, and a change of each parameter that matters.
    subset : callable, optional
        Positions of some rows to their model. With it the time that a slow group takes does not grow with the
        others, since these are left alone once they have converged.
    lower, upper : array, broadcast to shape (g, p), optional
        Bounds of the parameters. A step is cut off at a bound; a parameter that lies on one, and would
        leave it, stays while the others move (active set).
    damping : float, optional
        To begin with; 0 where the model is nearly linear and undamped steps can be trusted from the start.
    rank_tol : float, optional
        Directions with a smaller share of the largest effect are left alone as not identified.
    tolerance : float, optional
        A group has converged when its undamped step is below this share of the scales.
    most : int, optional
        Iterations before a group is given up as not converged.

    Returns
    -------
    Minimum
    """
    low, high = np.broadcast_to(lower, scales.shape), np.broadcast_to(upper, scales.shape)
    objective = Objective(model, y, weight, groups, scales, low, high, rank_tol, tolerance, subset=subset)
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
class Objective:
    """The sums of squares of g groups of n rows, and the accuracy of their minimum; see `minimise`.

    What can only move together is a unit: here each group by itself.
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

    def normal_equations(self, values: Array) -> NormalEquations:
        """Residuals, slopes and their products at a point, shape (g, p)."""
        return normal_equations(self.model, self.y, self.weight, self.groups, values, self.scales)

    def gradient(self, here: NormalEquations) -> Array:
        """By how much half the sum of squares falls with each parameter, shape (g, p)."""
        return here.products[:, :-1, -1]

    def lengths(self, here: NormalEquations) -> Array:
        """Length of each parameter's slopes, shape (g, p)."""
        return here.norms

    def factors(self, here: NormalEquations, lengths: Array) -> Factors:
        """The units' normal equations at a point, solved."""
        return factorize_jacobian(here, self.groups, self.scales, lengths, self.rank_tol)

    def held(self, here: NormalEquations, values: Array) -> BoolArray:
        """Parameters on a bound that the data would push beyond it, shape (g, p)."""
        neg_gradient = self.gradient(here)
        return ((values <= self.lower) & (neg_gradient < 0)) | ((values >= self.upper) & (neg_gradient > 0))

    def rank(self, here: NormalEquations, lengths: Array) -> IntArray:
        """Directions that the data determine, shape (g,)."""
        return self.factors(here, lengths).rank

    def curvature(self, here: NormalEquations) -> Array:
        """J' W J of each group, SI, shape (g, p, p)."""
        return here.curvature(self.scales)

    def of(self, some: BoolArray, subset: RowSubsetModel) -> Objective:
        """The sums of some of the groups."""
        rows = np.flatnonzero(some[self.groups.of_row])
        return replace(
            self, model=subset(rows), y=self.y[rows], weight=self.weight[rows], groups=self.groups.of(some),
            scales=self.scales[some], lower=self.lower[some], upper=self.upper[some],
            subset=lambda fewer: subset(rows[fewer]),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _State:
    """How far the search is.

    Attributes
    ----------
    values : array, shape (g, p)
    here : NormalEquations
    lengths : array, shape (g, p)
        The greatest length of each slope so far.
    damping : array, shape (u,)
    last_size : array, shape (u,)
        Size of the last undamped step; infinite far from the minimum.
    converged, lost : array of bool, shape (u,)
    """

    values: Array
    here: NormalEquations
    lengths: Array
    damping: Array
    last_size: Array
    converged: BoolArray
    lost: BoolArray

    @property
    def active(self) -> BoolArray:
        """Units still on their way, shape (u,)."""
        return ~(self.converged | self.lost)

    def of(self, some: BoolArray, groups: Groups) -> _State:
        """The state of some groups that are units."""
        return _State(
            self.values[some], self.here.of(some, groups), self.lengths[some], self.damping[some],
            self.last_size[some], self.converged[some], self.lost[some],
        )  # fmt: skip


def search(objective: Objective, start: Array, damping: float, most: int) -> Minimum:
    """Minimise an objective from start values, shape (g, p); see `minimise`."""
    values = np.clip(start, objective.lower, objective.upper)
    here, units = objective.normal_equations(values), len(objective.sizes)
    state = _State(
        values, here, np.zeros(values.shape), np.full(units, damping), np.full(units, np.inf),
        np.zeros(units, dtype=bool), ~np.isfinite(objective.of_unit(here.cost)),
    )  # fmt: skip
    return _iterate(objective, state, most)


def _iterate(objective: Objective, state: _State, most: int) -> Minimum:
    for iteration in range(most):
        active = state.active
        if not active.any():
            return _build_minimum(objective, state, iteration)
        few = objective.sizes[active].sum() < MIN_ROWS_FRACTION * len(objective.y)
        if objective.subset is not None and few and len(objective.y) > MIN_ROWS:
            others = objective.of(active, objective.subset)
            minimum = _iterate(others, state.of(active, objective.groups), most - iteration)
            return _build_minimum(objective, state, iteration).merge(minimum, active, objective.groups)
        state = _advance(objective, state)
    return _build_minimum(objective, state, most)


def _advance(objective: Objective, state: _State) -> _State:
    values, here, damping, active = state.values, state.here, state.damping, state.active
    lengths = np.maximum(state.lengths, objective.lengths(here))
    factors = objective.factors(here.without(objective.held(here, values), objective.groups), lengths)
    undamped, cost = factors.step(np.zeros(len(damping))), objective.of_unit(here.cost)
    offset = relative_offset(factors, cost, objective.sizes)
    near = offset < REL_OFFSET_TOL
    size = objective.largest(np.abs(undamped))
    # Steps that no longer shrink, so near the minimum, are rounding noise.
    close = (size < objective.tolerance) | (near & (size >= state.last_size))
    close |= offset < objective.offset_tol
    step = undamped
    if damping.any():
        step = np.where(objective.of_group(near | close)[:, None], undamped, factors.step(damping))
    trial = np.clip(values + step * objective.scales, objective.lower, objective.upper)
    trial = np.where(objective.of_group(active)[:, None], trial, values)
    there = objective.normal_equations(trial)
    new_cost = objective.of_unit(there.cost)
    # Near the minimum the cost only trembles in its last digits, and a tiny step is right all the same.
    better = (new_cost <= cost * np.where(near, 1.0 + 1e-10, 1.0)) | (close & np.isfinite(new_cost))
    better &= active
    converged = state.converged | ((close | (near & ~better)) & ~state.lost)
    raised = np.minimum(np.maximum(damping * DAMPING_UP, FIRST_DAMPING * (damping == 0)), MAX_DAMPING)
    damping = np.where(better, damping / DAMPING_DOWN, raised)
    taken = objective.of_group(better)
    return _State(
        values=np.where(taken[:, None], trial, values),
        here=here.merge(there, taken, objective.groups),
        lengths=lengths,
        damping=damping,
        last_size=np.where(near, size, np.inf),
        converged=converged,
        lost=state.lost | ((damping >= MAX_DAMPING) & ~converged),
    )


def relative_offset(factors: Factors, cost: Array, sizes: IntArray) -> Array:
    """How much of the residual an undamped step would still remove, shape (u,)."""
    rank = np.maximum(factors.rank, 1)
    beyond = np.maximum(cost - factors.gain, np.finfo(float).tiny)
    with np.errstate(over="ignore"):
        return np.sqrt(factors.gain / rank * np.maximum(sizes - rank, 1) / beyond)


def _build_minimum(objective: Objective, state: _State, iterations: int) -> Minimum:
    values, here = state.values, state.here
    return Minimum(
        values=values,
        curvature=objective.curvature(here),
        residual=here.residual,
        converged=objective.of_group(state.converged),
        rank=objective.rank(here, np.maximum(state.lengths, objective.lengths(here))),
        at_bound=objective.held(here, values),
        iterations=iterations,
    )
