"""Many small symmetric positive systems at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def solve(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Solve small positive definite systems by elimination, the matrices' own axes first.

    A loop over the p pivots, each for all systems, is several times faster than a call of LAPACK for each.

    Parameters
    ----------
    matrix : array, shape (p, p, ...)
    right : array, shape (p, k, ...)

    Returns
    -------
    solution : array, shape (p, k, ...)
    log_determinant : array, shape (...)

    Examples
    --------
    >>> solution, log_determinant = solve(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([[3.0], [3.0]]))
    >>> solution.ravel(), float(np.exp(log_determinant).round(12))
    (array([1., 1.]), 3.0)
    """
    p = len(matrix)
    work = np.concatenate([matrix, right], axis=1)
    determinant = np.ones(matrix.shape[2:])
    for k in range(p):
        determinant = determinant * work[k, k]
        row = work[k] / work[k, k]
        work -= work[:, k, None] * row
        work[k] = row
    return work[:, p:], np.log(determinant)
