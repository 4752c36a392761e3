"""svd: a singular value decomposition that ends on every finite matrix."""

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
