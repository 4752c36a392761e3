"""Least squares of nearly linear laws from a good start: Gauss and Newton's steps for everything at once.

Each block's own parameters are a block of the system, the causes' parameters its border, so that time grows
linearly with the blocks and one look at the laws makes one step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.identifiability import known_parameters
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

AT_REST = 1e-3  # of chi-square that a step would still gain: far below what any parameter's error is worth
MOST, HALVINGS = 40, 10


@dataclass(frozen=True, eq=False)
class Arrow:
    """Where the steps ended.

    Attributes
    ----------
    values : array, shape (g, p)
        Each block's own parameters, then the shared ones.
    covariance : array, shape (q, q)
        Of the shared ones.
    residual : array, shape (n,)
    converged : bool
    """

    values: Array
    covariance: Array
    residual: Array
    converged: bool


def minimise_arrow(
    model: Model,
    y: Array,
    weight: Array,
    blocks: Groups,
    start: Array,
    scales: Array,
    lower: Array,
    upper: Array,
) -> Arrow:
    """Minimise the sum of weight (y - model)^2.

    Parameters
    ----------
    model : callable
        Values of each row's block, shape (n, p), to responses and derivatives.
    y, weight : array, shape (n,)
    blocks : Groups
    start, scales : array, shape (g, p)
        The last q columns are shared: the same in all rows.
    lower, upper : array, shape (q,)
        Bounds of the shared parameters.
    """
    values, q = start.copy(), len(lower)
    own = start.shape[1] - q
    values[:, own:] = np.clip(values[:, own:], lower, upper)
    predicted, slopes = model(values[blocks.of_row])
    residual, converged = y - predicted, False
    for _ in range(MOST):
        held = _held(values[0, own:], (weight * residual) @ slopes[:, own:], lower, upper)
        step, gained, _ = _step(slopes, residual, weight, blocks, scales, held)
        for halving in range(HALVINGS):
            trial = values + step / 2**halving
            trial[:, own:] = np.clip(trial[:, own:], lower, upper)
            predicted, there = model(trial[blocks.of_row])
            left = y - predicted
            if np.sum(weight * left**2) <= np.sum(weight * residual**2) * (1 + 1e-12):
                values, slopes, residual = trial, there, left
                break
        else:
            break
        if gained < AT_REST:
            converged = True
            break
    nothing = np.zeros(q, dtype=bool)
    _, _, covariance = _step(slopes, residual, weight, blocks, scales, nothing)
    return Arrow(values, covariance, residual, converged)


def _step(
    slopes: Array, residual: Array, weight: Array, blocks: Groups, scales: Array, held: Mask
) -> tuple[Array, float, Array]:
    """Step that the linearised model asks for, (g, p), what chi-square gains by it, and the covariance."""
    own, q = slopes.shape[1] - len(held), len(held)
    both = np.concatenate([slopes, residual[:, None]], axis=1) * np.sqrt(weight)[:, None]
    both[:, own : own + q] *= ~held
    products = np.empty((len(blocks), both.shape[1], both.shape[1]))
    for i, one in enumerate(both.T):
        for j, other in enumerate(both.T[: i + 1]):
            products[:, i, j] = products[:, j, i] = blocks.sums(one * other)
    _, _, inverse = known_parameters(products[:, :own, :own], scales[:, :own])
    follow = inverse @ products[:, :own, own:]
    rest = (products[:, own:, own:] - products[:, own:, :own] @ follow).sum(axis=0)
    _, _, covariance = known_parameters(rest[None, :q, :q], scales[:1, own:])
    shared = covariance[0] @ rest[:q, q]
    step = np.empty_like(scales)
    step[:, own:] = shared
    step[:, :own] = follow[:, :, q] - follow[:, :, :q] @ shared
    before = products[:, -1, -1].sum()
    return step, float(before - rest[q, q] + shared @ rest[:q, q]), covariance[0]


def _held(values: Array, uphill: Array, lower: Array, upper: Array) -> Mask:
    """Shared parameters on a bound that the data would push beyond it, shape (q,)."""
    return ((values <= lower) & (uphill < 0)) | ((values >= upper) & (uphill > 0))
