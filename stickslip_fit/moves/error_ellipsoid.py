"""Where 95 % of normal errors with a covariance lie: in an ellipsoid, or within a radius.

The ellipsoid in d dimensions has the semi-axes sqrt(chi2 lambda), with lambda the eigenvalues of the
covariance and chi2 the quantile of chi-square with d degrees of freedom (exact).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from stickslip_fit._typing import Array

NOT_COVERED = 0.05


def error_radius(covariance: Array) -> Array:
    """Radius that holds 95 % of normal errors with these covariances, shape (..., d, d) -> (...).

    The squared error has mean tr C and variance 2 tr C^2; its quantile is that of the scaled chi-square with
    these moments (F. E. Satterthwaite, Biometrics Bull. 2:110, 1946). Exact where one direction dominates
    and where all are alike, and 2 % off at worst between.

    Examples
    --------
    >>> error_radius(np.diag([1.0, 0.0, 0.0])).round(2), error_radius(np.eye(3)).round(2)
    (np.float64(1.96), np.float64(2.8))
    """
    mean = np.trace(covariance, axis1=-2, axis2=-1)
    square = np.einsum("...ij,...ji->...", covariance, covariance)
    with np.errstate(invalid="ignore", divide="ignore"):
        df = mean**2 / square
        radius = np.sqrt(mean / df * chdtri(df, NOT_COVERED))
    return np.where(mean == 0.0, 0.0, radius)


def semi_axes(variances: Array) -> Array:
    """Semi-axes of the ellipsoid from the variances along them, shape (d,) -> (d,).

    Examples
    --------
    >>> semi_axes(np.array([4.0, 1.0, 0.0])).round(2)
    array([5.59, 2.8 , 0.  ])
    """
    return np.sqrt(chdtri(len(variances), NOT_COVERED) * np.clip(variances, 0.0, None))


@dataclass(frozen=True)
class ErrorEllipse:
    """Semi-axes, m, and the direction of the longer one, rad from the first coordinate's axis."""

    longer: float
    shorter: float
    angle: float

    def points(self, count: int) -> Array:
        """Points on it about its centre, m, shape (count, 2)."""
        turn = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
        along = np.array([np.cos(self.angle), np.sin(self.angle)])
        across = np.array([-along[1], along[0]])
        return np.outer(self.longer * np.cos(turn), along) + np.outer(self.shorter * np.sin(turn), across)


def error_ellipse(covariance: Array) -> ErrorEllipse | None:
    """The ellipse that holds 95 % of normal errors of this covariance, m^2, shape (2, 2); None if not known.

    Examples
    --------
    >>> ellipse = error_ellipse(np.diag([4e-12, 1e-12]))
    >>> print(f"{1e6 * ellipse.longer:.3f} and {1e6 * ellipse.shorter:.3f} µm")
    4.895 and 2.448 µm
    """
    if not np.all(np.isfinite(covariance)):
        return None
    variances, axes = np.linalg.eigh(covariance)
    shorter, longer = semi_axes(variances)
    return ErrorEllipse(float(longer), float(shorter), float(np.arctan2(axes[1, 1], axes[0, 1])))
