"""Weighted nonlinear least squares for many groups at once.

Every group has its own parameters and its own damping, so that one difficult group neither slows nor
disturbs the others (K. Levenberg, Quart. Appl. Math. 2:164, 1944; D. Marquardt, SIAM J. Appl. Math.
11:431, 1963).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.groups import Groups
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]

# A direction of parameter space that changes log steps by less than this share of what a parameter of
# ordinary effect does is not known from the data, whatever the arithmetic says.
SMALLEST = 1e-5
# Plain Gauss-Newton steps until one fails: most groups never need damping.
DAMPING_FIRST = 1e-3
DAMPING_MOST = 1e12


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
    iterations : int
    """

    values: Array
    curvature: Array
    residual: Array
    converged: npt.NDArray[np.bool_]
    iterations: int


def minimise(
    model: Model,
    y: Array,
    weight: Array,
    groups: Groups,
    start: Array,
    scales: Array,
    *,
    tolerance: float = 1e-8,
    most: int = 100,
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
    tolerance : float, optional
        A group has converged when its step is below this share of the scales.
    most : int, optional
        Iterations before a group is given up as not converged.

    Returns
    -------
    Minimum
    """
    values = start.copy()
    damping = np.zeros(len(groups))
    converged = np.zeros(len(groups), dtype=bool)
    residual, curvature, gradient, cost = _linearise(model, y, weight, groups, values, scales)
    iteration = 0
    while iteration < most:
        iteration += 1
        step = damped_step(curvature, gradient, damping)
        converged |= np.max(np.abs(step), axis=1) < tolerance
        lost = damping > DAMPING_MOST
        if np.all(converged | lost):
            break
        trial = values + np.where((converged | lost)[:, None], 0.0, step * scales)
        new_residual, new_curvature, new_gradient, new_cost = _linearise(
            model, y, weight, groups, trial, scales
        )
        # Near the minimum the cost only trembles in its last digits.
        better = new_cost <= cost * (1.0 + 1e-13)
        values[better], cost[better] = trial[better], new_cost[better]
        curvature[better], gradient[better] = new_curvature[better], new_gradient[better]
        taken = better[groups.of_row]
        residual[taken] = new_residual[taken]
        damping = np.where(better, _eased(damping), np.maximum(10 * damping, DAMPING_FIRST))
    return Minimum(values, _unscaled(curvature, scales), residual, converged, iteration)


def damped_step(curvature: Array, gradient: Array, damping: Array) -> Array:
    """Step of each group in units of the scales, along the directions that the data know."""
    eigenvalue, vector = np.linalg.eigh(curvature)
    top = eigenvalue[:, -1:]
    known = eigenvalue > SMALLEST**2 * np.maximum(top, np.finfo(float).tiny)
    divisor = np.where(known, eigenvalue + damping[:, None] * top, np.inf)
    along = np.einsum("gij,gi->gj", vector, gradient) / divisor
    return np.einsum("gij,gj->gi", vector, along)


def _linearise(
    model: Model, y: Array, weight: Array, groups: Groups, values: Array, scales: Array
) -> tuple[Array, Array, Array, Array]:
    """Residuals, and each group's J' W J, J' W r and r' W r in units of the scales."""
    predicted, jacobian = model(values[groups.of_row])
    residual = y - predicted
    p, root = scales.shape[1], np.sqrt(weight)
    # One contiguous row a column of [J, r]: summing by group is then a single pass over memory each.
    columns = np.empty((p + 1, len(y)))
    columns[:p], columns[p] = jacobian.T * root, residual * root
    moments = np.empty((len(groups), p + 1, p + 1))
    for i in range(p + 1):
        for j in range(i + 1):
            moments[:, i, j] = moments[:, j, i] = groups.sums(columns[i] * columns[j])
    # A trial that leaves the law's domain costs infinitely much and is not taken.
    outside = ~np.all(np.isfinite(moments), axis=(1, 2))
    moments[outside], moments[outside, p, p] = 0.0, np.inf
    curvature = moments[:, :p, :p] * scales[:, :, None] * scales[:, None, :]
    return residual, curvature, moments[:, :p, p] * scales, moments[:, p, p]


def _eased(damping: Array) -> Array:
    return np.where(damping > DAMPING_FIRST, damping / 10, 0.0)


def _unscaled(curvature: Array, scales: Array) -> Array:
    return curvature / (scales[:, :, None] * scales[:, None, :])
