"""Weighted nonlinear least squares for many groups at once.

Every group has its own parameters and its own damping, so that one difficult group neither slows nor
disturbs the others. Damped steps as of Marquardt (SIAM J. Appl. Math. 11:431, 1963) with the scaling of
Moré (Lecture Notes in Mathematics 630:105, 1978) and damping that falls faster than it rises (Transtrum
and Sethna, arXiv:1201.5885, 2012); undamped ones as soon as the relative offset of Bates and Watts
(Technometrics 23:179, 1981) shows that a group is nearly there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.curvature import Factors, Moments, factorise, moments_of
from stickslip_fit.fit.groups import Groups
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Part = Callable[[npt.NDArray[np.intp]], Model]
"""Places of some rows to the model of these."""

# A direction of parameter space that changes the response by less than this share of what a parameter of
# ordinary effect does is not known from the data, whatever the arithmetic says.
SMALLEST = 1e-5
NEARLY_THERE = 1e-6
RISE, FALL, FIRST, MOST = 2.0, 3.0, 1e-2, 1e20
# A search goes on without the groups that are done as soon as they have most rows of a log of some size.
FEW, SMALL = 0.5, 1000


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
        The values do not move any more; they are all determined only where rank is p.
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
    rank: npt.NDArray[np.intp]
    at_bound: Mask
    iterations: int

    def replaced(self, other: Minimum, some: Mask, groups: Groups) -> Minimum:
        """With what a search that went on with some of the groups alone has found of these."""
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
    part: Part | None = None,
    lower: Array | float = -np.inf,
    upper: Array | float = np.inf,
    damping: float = FIRST,
    smallest: float = SMALLEST,
    rest: float = 0.0,
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
    part : callable, optional
        Places of some rows to their model. With it the time that a slow group takes does not grow with the
        others, since these are left alone once they have converged.
    lower, upper : array, broadcast to shape (g, p), optional
        Bounds of the parameters. A step is cut off at a bound; a parameter that lies on one, and would
        leave it, stays while the others move (active set).
    damping : float, optional
        To begin with; 0 where the model is nearly linear and undamped steps can be trusted from the start.
    smallest : float, optional
        Directions with a smaller share of the largest effect are left alone as not identified.
    rest : float, optional
        Relative offset, about the distance to the minimum in standard errors, at which a group may rest.
    tolerance : float, optional
        A group has converged when its undamped step is below this share of the scales.
    most : int, optional
        Iterations before a group is given up as not converged.

    Returns
    -------
    Minimum
    """
    low, high = np.broadcast_to(lower, scales.shape), np.broadcast_to(upper, scales.shape)
    sums = _Sums(model, y, weight, groups, scales, low, high, smallest, rest, tolerance, part)
    values, count = np.clip(start, low, high), len(groups)
    here = sums.moments(values)
    place = _Place(
        values, here, np.zeros(scales.shape), np.full(count, damping), np.full(count, np.inf),
        np.zeros(count, dtype=bool), ~np.isfinite(here.cost),
    )  # fmt: skip
    return _search(sums, place, most)


@dataclass(frozen=True, eq=False)
class _Sums:
    """The sums of squares of g groups of n rows, and what is asked of a minimum; see `minimise`."""

    model: Model
    y: Array
    weight: Array
    groups: Groups
    scales: Array
    lower: Array
    upper: Array
    smallest: float
    rest: float
    tolerance: float
    part: Part | None

    def moments(self, values: Array) -> Moments:
        """Residuals, slopes and their products at a point, shape (g, p)."""
        return moments_of(self.model, self.y, self.weight, self.groups, values, self.scales)

    def held(self, here: Moments, values: Array) -> Mask:
        """Parameters on a bound that the data would push beyond it, shape (g, p)."""
        uphill = here.products[:, :-1, -1]
        return ((values <= self.lower) & (uphill < 0)) | ((values >= self.upper) & (uphill > 0))

    def factors(self, here: Moments, seen: Array) -> Factors:
        """The groups' Jacobians at a point."""
        return factorise(here, self.groups, self.scales, seen, self.smallest)

    def of(self, some: Mask, part: Part) -> _Sums:
        """The sums of some of the groups."""
        rows = np.flatnonzero(some[self.groups.of_row])
        return replace(
            self, model=part(rows), y=self.y[rows], weight=self.weight[rows], groups=self.groups.of(some),
            scales=self.scales[some], lower=self.lower[some], upper=self.upper[some],
            part=lambda fewer: part(rows[fewer]),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the groups are in their searches.

    Attributes
    ----------
    values : array, shape (g, p)
    here : Moments
    seen : array, shape (g, p)
        The greatest length of each slope so far.
    damped : array, shape (g,)
    before : array, shape (g,)
        Size of the last undamped step; infinite far from the minimum.
    converged, lost : array of bool, shape (g,)
    """

    values: Array
    here: Moments
    seen: Array
    damped: Array
    before: Array
    converged: Mask
    lost: Mask

    def of(self, some: Mask, groups: Groups) -> _Place:
        """Where some of the groups are."""
        return _Place(
            self.values[some], self.here.of(some, groups), self.seen[some], self.damped[some],
            self.before[some], self.converged[some], self.lost[some],
        )  # fmt: skip


def _search(sums: _Sums, place: _Place, most: int) -> Minimum:
    for iteration in range(most):
        some = ~(place.converged | place.lost)
        if not some.any():
            return _minimum(sums, place, iteration)
        slow = sums.groups.sizes[some].sum() < FEW * len(sums.y) and len(sums.y) > SMALL
        if slow and sums.part is not None:
            others = _search(sums.of(some, sums.part), place.of(some, sums.groups), most - iteration)
            return _minimum(sums, place, iteration).replaced(others, some, sums.groups)
        place = _step(sums, place)
    return _minimum(sums, place, most)


def _step(sums: _Sums, place: _Place) -> _Place:
    values, here, damped, on_the_way = place.values, place.here, place.damped, ~(place.converged | place.lost)
    seen = np.maximum(place.seen, here.norms)
    local = sums.factors(here.without(sums.held(here, values), sums.groups), seen)
    full = local.step(np.zeros(len(values)))
    offset = local.offset(here.cost, sums.groups.sizes)
    near = offset < NEARLY_THERE
    size = np.max(np.abs(full), axis=1, initial=0.0)
    # Steps that no longer shrink, so near the minimum, are rounding noise.
    close = (size < sums.tolerance) | (near & (size >= place.before)) | (offset < sums.rest)
    step = np.where((near | close)[:, None], full, local.step(damped))
    trial = np.clip(values + step * sums.scales, sums.lower, sums.upper)
    trial = np.where(on_the_way[:, None], trial, values)
    there = sums.moments(trial)
    # Near the minimum the cost only trembles in its last digits, and a tiny step is right all the same.
    better = (there.cost <= here.cost * np.where(near, 1.0 + 1e-10, 1.0)) | (close & np.isfinite(there.cost))
    better &= on_the_way
    converged = place.converged | ((close | (near & ~better)) & ~place.lost)
    raised = np.minimum(np.maximum(damped * RISE, FIRST * (damped == 0)), MOST)
    damped = np.where(better, damped / FALL, raised)
    return _Place(
        values=np.where(better[:, None], trial, values),
        here=here.replaced(there, better, sums.groups),
        seen=seen,
        damped=damped,
        before=np.where(near, size, np.inf),
        converged=converged,
        lost=place.lost | ((damped >= MOST) & ~converged),
    )


def _minimum(sums: _Sums, place: _Place, iterations: int) -> Minimum:
    values, here = place.values, place.here
    rank = sums.factors(here, np.maximum(place.seen, here.norms)).rank
    return Minimum(
        values, here.curvature(sums.scales), here.residual, place.converged, rank, sums.held(here, values),
        iterations,
    )  # fmt: skip
