"""Decompositions that end on every finite matrix, and inverses of what few rows say of many parameters."""

from __future__ import annotations

import numpy as np

from stickslip_fit._typing import Array


def svd(matrices: Array) -> tuple[Array, Array, Array]:
    """As `np.linalg.svd` without full matrices, of one matrix, (m, n), or several, (..., m, n).

    LAPACK's divide-and-conquer (gesdd) may not converge on a finite matrix, of which neither entries nor rank
    are unusual; its iteration by QR (gesvd) does.

    Raises
    ------
    LinAlgError
        For entries that are not finite.

    Examples
    --------
    >>> svd(np.array([[3.0, 0.0], [4.0, 0.0]]))[1].tolist()
    [5.0, 0.0]
    """
    try:
        return np.linalg.svd(matrices, full_matrices=False)
    except np.linalg.LinAlgError:
        if not np.isfinite(matrices).all():
            raise
    from scipy.linalg import svd as decompose

    parts = [
        decompose(one, full_matrices=False, lapack_driver="gesvd")
        for one in matrices.reshape(-1, *matrices.shape[-2:])
    ]
    before = matrices.shape[:-2]
    left, singular, right = (np.stack(own) for own in zip(*parts, strict=True))
    return tuple(own.reshape(before + own.shape[1:]) for own in (left, singular, right))  # type: ignore[return-value]


def eigh(matrices: Array) -> tuple[Array, Array]:
    """As `np.linalg.eigh` of symmetric matrices, (k, w, w); of one or two rows in closed form, much faster.

    Raises
    ------
    LinAlgError
        If the iteration for wider ones does not converge.

    Examples
    --------
    >>> eigh(np.array([[[2.0, 1.0], [1.0, 2.0]]]))[0].round(9).tolist()
    [[1.0, 3.0]]
    """
    if matrices.shape[1] == 1:
        return matrices[:, 0], np.ones_like(matrices)
    if matrices.shape[1] > 2 or not np.isfinite(matrices).all():
        return np.linalg.eigh(matrices)
    first, both, second = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    middle, spread = (first + second) / 2, np.hypot((first - second) / 2, both)
    angle = np.arctan2(both, (first - second) / 2) / 2
    cosine, sine = np.cos(angle), np.sin(angle)
    vectors = np.stack([-sine, cosine, cosine, sine], axis=1).reshape(-1, 2, 2)
    return np.stack([middle - spread, middle + spread], axis=1), vectors


def ridge_inverse(rows: Array, precision: Array, least: float) -> Array | None:
    """The inverse of rows' rows + diag(precision), of fewer rows than columns; (n, q) and (q,) -> (q, q).

    By an n by n system (M. A. Woodbury, 1950). None if divided to a diagonal of 1 the matrix may have an
    eigenvalue that is less than the share `least` of the largest.

    Examples
    --------
    >>> ridge_inverse(np.array([[3.0, 0.0]]), np.array([1.0, 2.0]), 1e-9)
    array([[0.1, 0. ],
           [0. , 0.5]])
    """
    size = np.einsum("nq,nq->q", rows, rows) + precision
    share = precision / size
    gram = (rows / size) @ rows.T
    if share.min() < least * (np.linalg.eigvalsh(gram)[-1] + share.max()):
        return None
    scaled = rows / precision
    inverse = -scaled.T @ np.linalg.solve(np.eye(len(rows)) + scaled @ rows.T, scaled)
    inverse[np.diag_indices_from(inverse)] += 1.0 / precision
    return np.asarray((inverse + inverse.T) / 2.0)


def square_root(rows: Array, covariance: Array) -> Array:
    """A matrix R with R R' = rows covariance rows', (n, q) and (q, q) -> (n, min(n, q)).

    Where a direction of the covariance is unknown, R is 0.
    """
    if len(rows) < len(covariance):
        variance, axes = np.linalg.eigh(rows @ covariance @ rows.T)
        return np.asarray(axes * np.sqrt(np.maximum(variance, 0.0)))
    variance, axes = np.linalg.eigh(covariance)
    return np.asarray(rows @ (axes * np.sqrt(np.maximum(variance, 0.0))))
