"""box_epsilon: by how much errors that are alike in neighbouring stretches reduce degrees of freedom.

Of p - 1 degrees of freedom along the travel, Box's epsilon is the share that F tests have left under the
covariance that errors have from stretch to stretch (Ann. Math. Stat. 25:484, 1954). A few sessions say little
of that covariance: each one of a grid, part independent and part smooth, counts by its restricted likelihood,
and epsilon is a low quantile of theirs. With the likeliest one, tests of sessions that have profiles of their
own reject twice as often as they say: where errors happen to be small, they look independent, too.
"""

from __future__ import annotations

import numpy as np

from stickslip_fit._typing import Array

P_INDEPENDENT = 0.3  # prior probability of errors that are independent from stretch to stretch
SMOOTH_SHARES = np.array([0.3, 0.6, 0.8, 0.9, 0.97, 0.99])  # of the variance of the others
SHORTEST, N_LENGTHS = 0.5, 8  # correlation length, in stretches; the longest is twice the travel
QUANTILE = 0.1


def box_epsilon(errors: Array, n_runs: float) -> float:
    """A lower limit of Box's epsilon, between 1 / (p - 1) and 1.

    Parameters
    ----------
    errors : array, shape (m, p)
        Of p stretches in their order along the travel, by session and so on; NaN where unknown.
    n_runs : float
        How many runs along the travel are independent: the errors' degrees of freedom over p - 1.
    """
    p = errors.shape[1]
    if p < 3:
        return 1.0
    known = np.isfinite(errors)
    filled = np.where(known, errors, 0.0)
    covariance = filled.T @ filled / np.maximum(known.T.astype(float) @ known, 1.0)
    variances, squares = _covariances(covariance)
    log_likelihood = (
        -0.5
        * n_runs
        * (np.log(variances).sum(axis=1) + (p - 1) * np.log(np.mean(squares / variances, axis=1)))
    )
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight[0] *= P_INDEPENDENT
    weight[1:] *= (1.0 - P_INDEPENDENT) / (len(weight) - 1)
    epsilon = variances.sum(axis=1) ** 2 / ((p - 1) * np.sum(variances**2, axis=1))
    order = np.argsort(epsilon)
    share = np.cumsum(weight[order]) / weight.sum()
    return float(epsilon[order][np.searchsorted(share, QUANTILE)])


def _covariances(measured: Array) -> tuple[Array, Array]:
    """Eigenvalues of each covariance of the grid, and mean squares of errors along its axes, (k, p - 1) each.

    The general mean is taken out; the first covariance is that of independent errors.
    """
    p = len(measured)
    contrasts = np.linalg.svd(np.ones((1, p)))[2][1:]
    measured = contrasts @ measured @ contrasts.T
    variances, squares = [np.ones(p - 1)], [np.full(p - 1, np.trace(measured) / (p - 1))]
    apart = np.abs(np.subtract.outer(np.arange(p), np.arange(p)))
    for length in np.geomspace(SHORTEST, 2.0 * p, N_LENGTHS):
        for correlation in (np.exp(-apart / length), np.exp(-0.5 * (apart / length) ** 2)):
            smooth, axes = np.linalg.eigh(contrasts @ correlation @ contrasts.T)
            smooth = np.maximum(smooth, 0.0) / np.mean(smooth)
            along = np.maximum(np.sum(axes * (measured @ axes), axis=0), 0.0)
            for share in SMOOTH_SHARES:
                variances.append(share * smooth + (1.0 - share))
                squares.append(along)
    return np.array(variances), np.array(squares)
