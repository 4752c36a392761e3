"""Weighted nonlinear least squares for many groups at once.

Every group has its own parameters and its own damping, so that one difficult group neither slows nor
disturbs the others. Damped steps as of Marquardt (SIAM J. Appl. Math. 11:431, 1963) with the scaling of
Moré (Lecture Notes in Mathematics 630:105, 1978) and damping that falls faster than it rises (Transtrum
and Sethna, arXiv:1201.5885, 2012); undamped ones as soon as the relative offset of Bates and Watts
(Technometrics 23:179, 1981) shows that a group is nearly there. `fit.shared` solves systems of groups that
share parameters by the same search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.curvature import NormalEquations, factorise, normal_equations
from stickslip_fit.fit.groups import Groups
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]
RowSubsetModel = Callable[[Indices], Model]
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
    converged: Mask
    rank: Indices
    at_bound: Mask
    iterations: int

    def replaced(self, other: Minimum, some: Mask, groups: Groups) -> Minimum:
        """With the minimum of a search that went on with some of the groups alone."""
        whole = {name: getattr(self, name).copy() for name in ("values", "curvature", "converged", "rank")}
        whole |= {"at_bound": self.at_bound.copy(), "residual": self.residual.copy()}
        for name, array in whole.items():
            array[some[groups.of_row] if name == "residual" else some] = getattr(other, name)
        return Minimum(**whole, iterations=self.iterations + other.iterations)


def minimise(
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
    def rank(self) -> Indices:
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
    def sizes(self) -> Indices:
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
        return factorise(here, self.groups, self.scales, lengths, self.rank_tol)

    def held(self, here: NormalEquations, values: Array) -> Mask:
        """Parameters on a bound that the data would push beyond it, shape (g, p)."""
        uphill = self.gradient(here)
        return ((values <= self.lower) & (uphill < 0)) | ((values >= self.upper) & (uphill > 0))

    def rank(self, here: NormalEquations, lengths: Array) -> Indices:
        """Directions that the data determine, shape (g,)."""
        return self.factors(here, lengths).rank

    def curvature(self, here: NormalEquations) -> Array:
        """J' W J of each group, SI, shape (g, p, p)."""
        return here.curvature(self.scales)

    def of(self, some: Mask, subset: RowSubsetModel) -> Objective:
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
    converged: Mask
    lost: Mask

    @property
    def active(self) -> Mask:
        """Units still on their way, shape (u,)."""
        return ~(self.converged | self.lost)

    def of(self, some: Mask, groups: Groups) -> _State:
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
            return _minimum(objective, state, iteration)
        few = objective.sizes[active].sum() < MIN_ROWS_FRACTION * len(objective.y)
        if objective.subset is not None and few and len(objective.y) > MIN_ROWS:
            others = objective.of(active, objective.subset)
            minimum = _iterate(others, state.of(active, objective.groups), most - iteration)
            return _minimum(objective, state, iteration).replaced(minimum, active, objective.groups)
        state = _step(objective, state)
    return _minimum(objective, state, most)


def _step(objective: Objective, state: _State) -> _State:
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
        here=here.replaced(there, taken, objective.groups),
        lengths=lengths,
        damping=damping,
        last_size=np.where(near, size, np.inf),
        converged=converged,
        lost=state.lost | ((damping >= MAX_DAMPING) & ~converged),
    )


def relative_offset(factors: Factors, cost: Array, sizes: Indices) -> Array:
    """How much of the residual an undamped step would still remove, shape (u,)."""
    rank = np.maximum(factors.rank, 1)
    beyond = np.maximum(cost - factors.gain, np.finfo(float).tiny)
    with np.errstate(over="ignore"):
        return np.sqrt(factors.gain / rank * np.maximum(sizes - rank, 1) / beyond)


def _minimum(objective: Objective, state: _State, iterations: int) -> Minimum:
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
