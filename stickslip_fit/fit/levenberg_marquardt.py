"""Weighted nonlinear least squares for many groups at once.

Every group has its own parameters and its own damping, so that one difficult group neither slows nor
disturbs the others. Damped steps as of Marquardt (SIAM J. Appl. Math. 11:431, 1963) with the scaling of
Moré (Lecture Notes in Mathematics 630:105, 1978) and damping that falls faster than it rises (Transtrum
and Sethna, arXiv:1201.5885, 2012); undamped ones as soon as the relative offset of Bates and Watts
(Technometrics 23:179, 1981) shows that a group is nearly there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.curvature import Moments, factorise, moments_of
from stickslip_fit.fit.groups import Groups
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# A direction of parameter space that changes the response by less than this share of what a parameter of
# ordinary effect does is not known from the data, whatever the arithmetic says.
SMALLEST = 1e-5
NEARLY_THERE = 1e-6
RISE, FALL, FIRST, MOST = 2.0, 3.0, 1e-2, 1e20


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


def minimise(
    model: Model,
    y: Array,
    weight: Array,
    groups: Groups,
    start: Array,
    scales: Array,
    *,
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
    values, seen = np.clip(start, lower, upper), np.zeros(scales.shape)
    damped = np.full(len(groups), damping)
    before = np.full(len(groups), np.inf)
    here = moments_of(model, y, weight, groups, values, scales)
    converged, lost = np.zeros(len(groups), dtype=bool), ~np.isfinite(here.cost)
    iteration = 0
    while iteration < most and not np.all(converged | lost):
        iteration += 1
        seen = np.maximum(seen, here.norms)
        held = _held(here, values, lower, upper)
        local = factorise(here.without(held, groups), groups, scales, seen, smallest)
        full = local.step(np.zeros(len(groups)))
        offset = local.offset(here.cost, groups.sizes)
        near = offset < NEARLY_THERE
        size = np.max(np.abs(full), axis=1, initial=0.0)
        # Steps that no longer shrink, so near the minimum, are rounding noise.
        close = (size < tolerance) | (near & (size >= before)) | (offset < rest)
        before = np.where(near, size, np.inf)
        step = np.where((near | close)[:, None], full, local.step(damped))
        trial = np.clip(values + step * scales, lower, upper)
        trial = np.where((converged | lost)[:, None], values, trial)
        there = moments_of(model, y, weight, groups, trial, scales)
        # Near the minimum the cost only trembles in its last digits, and a tiny step is right all the same.
        better = (there.cost <= here.cost * np.where(near, 1.0 + 1e-10, 1.0)) | (
            close & np.isfinite(there.cost)
        )
        better &= ~(converged | lost)
        values[better] = trial[better]
        here = here.replaced(there, better, groups)
        converged |= (close | (near & ~better)) & ~lost
        raised = np.minimum(np.maximum(damped * RISE, FIRST * (damped == 0)), MOST)
        damped = np.where(better, damped / FALL, raised)
        lost |= (damped >= MOST) & ~converged
    rank = factorise(here, groups, scales, np.maximum(seen, here.norms), smallest).rank
    at_bound = _held(here, values, lower, upper)
    return Minimum(values, here.curvature(scales), here.residual, converged, rank, at_bound, iteration)


def _held(here: Moments, values: Array, lower: Array | float, upper: Array | float) -> Mask:
    """Parameters on a bound that the data would push beyond it, shape (g, p)."""
    uphill = here.products[:, :-1, -1]
    return ((values <= lower) & (uphill < 0)) | ((values >= upper) & (uphill > 0))
