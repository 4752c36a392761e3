r"""Steps over a rotary traverse in closed form: integrals of powers of gamma0 + A cos(q - phase).

With e = A / gamma0 the integral of dq / (1 + e cos q) is that of Kepler's true anomaly, and the
eccentric anomaly E makes it elementary without a branch to mind (R. H. Battin, An Introduction to
the Mathematics and Methods of Astrodynamics, AIAA, 1999, Eqs. 4.29 to 4.32):

    E = q - 2 atan2(beta sin q, 1 + beta cos q),   beta = e / (1 + sqrt(1 - e^2))
    integral of 1 / (1 + e cos q)        = E / (1 - e^2)^(1/2)
    integral of 1 / (1 + e cos q)^2      = (E - e sin E) / (1 - e^2)^(3/2)
    integral of cos q / (1 + e cos q)^2  = (sin E - e E) / (1 - e^2)^(3/2)
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def harmonic_counts(
    gamma0: Array, amplitude: Array, phase: Array, start: Array, stop: Array
) -> tuple[Array, Array, Array]:
    """Steps over a traverse whose step size is gamma0 + amplitude cos(q - phase), and their slopes.

    Parameters
    ----------
    gamma0, amplitude : array, shape (n,)
        Step size without load and its greatest departure, rad.
    phase, start, stop : array, shape (n,)
        Where the departure is greatest, and the ends of the traverse, rad.

    Returns
    -------
    counts, slope_gamma0, slope_amplitude : array, shape (n,)
        NaN where the step size reaches zero somewhere on the circle.

    Examples
    --------
    >>> half_turn = np.array([0.0]), np.array([np.pi])
    >>> counts, _, _ = harmonic_counts(np.array([1e-4]), np.array([0.0]), np.array([0.0]), *half_turn)
    >>> print(counts.round(3))
    [31415.927]
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        e = amplitude / gamma0
        root = np.sqrt(np.where(gamma0 > np.abs(amplitude), 1.0 - e**2, np.nan))
        first, last = _eccentric(e, root, start - phase), _eccentric(e, root, stop - phase)
        way = np.sign(stop - start)
        swept = way * (last - first)
        rise = way * (np.sin(last) - np.sin(first))
        counts = swept / (gamma0 * root)
        slope_gamma0 = -(swept - e * rise) / (gamma0**2 * root**3)
        slope_amplitude = -(rise - e * swept) / (gamma0**2 * root**3)
    return counts, slope_gamma0, slope_amplitude


def _eccentric(e: Array, root: Array, q: Array) -> Array:
    beta = e / (1.0 + root)
    return q - 2.0 * np.arctan2(beta * np.sin(q), 1.0 + beta * np.cos(q))
