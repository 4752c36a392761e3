"""The best few of many traverses, found by adding one at a time and exchanging them till nothing is gained.

V. V. Fedorov, Theory of Optimal Experiments (1972), Ch. 3.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Loss = Callable[[Array], Array]
"""Information matrices, shape (m, p, p), to what is to be small, shape (m,)."""

GAINED = 1e-9


def exchange(jacobian: Array, count: int, loss: Loss, prior: Array) -> Indices:
    """Rows whose information is best, no row twice.

    Parameters
    ----------
    jacobian : array, shape (n, p)
        Slopes of each row's response, over its standard deviation.
    count : int
        At most n.
    loss : callable
    prior : array, shape (p, p)
        Information that is there already; positive definite.

    Returns
    -------
    array of int, shape (count,)
        In ascending order.
    """
    each = jacobian[:, :, None] * jacobian[:, None, :]
    chosen: list[int] = []
    while len(chosen) < count:
        left = _left(len(each), chosen)
        chosen.append(int(left[np.argmin(loss(prior + each[chosen].sum(axis=0) + each[left]))]))
    best = float(loss((prior + each[chosen].sum(axis=0))[None])[0])
    while len(left := _left(len(each), chosen)):
        here = prior + each[chosen].sum(axis=0)
        swapped = here - each[chosen][:, None] + each[left][None]
        losses = loss(swapped.reshape(-1, *here.shape))
        if not losses.min() < best - GAINED * abs(best):
            break
        best = float(losses.min())
        out, into = divmod(int(np.argmin(losses)), len(left))
        chosen[out] = int(left[into])
    return np.sort(np.array(chosen, dtype=np.intp))


def determinant(information: Array) -> Array:
    """D-optimality: the volume of the parameters' confidence region."""
    return -np.linalg.slogdet(information)[1]


def mean_variance(region: Array) -> Loss:
    """I-optimality: the variance of a prediction, averaged over the rows of `region`, shape (m, p)."""
    moment = region.T @ region / len(region)

    def loss(information: Array) -> Array:
        return np.trace(np.linalg.solve(information, moment[None]), axis1=1, axis2=2)

    return loss


def _left(rows: int, chosen: list[int]) -> Indices:
    return np.setdiff1d(np.arange(rows), chosen)
