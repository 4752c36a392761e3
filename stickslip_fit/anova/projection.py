"""Orthonormal bases of what terms of a linear model span, each beyond those before it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

NOTHING = 1e-9  # of a column's length: what is left of one that earlier columns span


def indicator(codes: npt.NDArray[np.intp]) -> Array:
    """One column for each code, 1 in its rows; codes count from 0, shape (n, k)."""
    return (codes[:, None] == np.arange(codes.max() + 1)).astype(float)


def unit_columns(codes: npt.NDArray[np.intp]) -> Array:
    """As `indicator`, each column of length 1."""
    return indicator(codes) / np.sqrt(np.bincount(codes))


def contrasts(codes: npt.NDArray[np.intp]) -> Array:
    """Basis of what the means of k groups tell beyond the general mean, shape (n, k - 1).

    A reflection takes the general mean to the first axis of the groups' space; its other columns are left.
    """
    root = np.sqrt(np.bincount(codes) / len(codes))
    normal = root + np.eye(len(root))[0]
    reflection = np.eye(len(root)) - 2.0 * np.outer(normal, normal) / (normal @ normal)
    return unit_columns(codes) @ reflection[:, 1:]


def orthonormal(columns: Array, beyond: Array) -> Array:
    """Basis of what the columns span and `beyond` does not.

    Its width is the term's degrees of freedom, whatever the coding: columns that are empty, or combine
    others, add nothing. Labels of an inner factor may so be reused in each outer level or not.

    Parameters
    ----------
    columns : array, shape (n, p)
    beyond : array, shape (n, q)
        Orthonormal.

    Returns
    -------
    array, shape (n, r), r <= p

    Examples
    --------
    >>> day = indicator(np.array([0, 0, 1, 1]))
    >>> orthonormal(day, np.full((4, 1), 0.5)).shape
    (4, 1)
    """
    from scipy.linalg import qr

    length = np.sqrt(np.sum(columns**2, axis=0))
    columns = columns[:, length > 0] / length[length > 0]
    # Twice: what rounding left of the first projection goes with the second.
    for _ in range(2):
        columns = columns - beyond @ (beyond.T @ columns)
    if not columns.size:
        return np.zeros((len(columns), 0))
    basis, triangle, _ = qr(columns, mode="economic", pivoting=True)
    basis = basis[:, np.abs(np.diag(triangle)) > NOTHING]
    return basis - beyond @ (beyond.T @ basis)
