r"""The load coefficient d of a rotary joint from one count, three ways (thesis Eq. 6.6 is one).

With gravity acting, the steps over a traverse are N = integral of dq / (gamma0 + d u(q)), and the mean
step changes by delta = traverse / N - gamma0. The thesis gets d from delta by an iteration and, for
daily use, by a fitted quadratic (Eq. 6.6); solving the integral has the error of neither.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize.elementwise import find_root

from stickslip_fit.laws.harmonic import harmonic_counts

Array = npt.NDArray[np.float64]

NEAREST_TO_STALL = 1.0 - 1e-9


def solve_d(counts: Array, gamma0: Array, amplitude: Array, phase: Array, start: Array, stop: Array) -> Array:
    """The d that gives exactly `counts` steps over each traverse.

    Parameters
    ----------
    counts : array, shape (n,)
        Steps, not rounded.
    gamma0 : array, shape (n,)
        Step size without load, rad.
    amplitude, phase : array, shape (n,)
        Of the load, u = amplitude cos(q - phase).
    start, stop : array, shape (n,)
        rad.

    Returns
    -------
    array, shape (n,)
        rad; NaN where no step size above 0 all round gives the count, or where no load acts.

    Examples
    --------
    A mean step that gravity raises from 95 to 104.2 µrad over joint 2's full traverse:

    >>> start, stop = np.radians([30.0]), np.radians([-210.0])
    >>> counts, gamma0 = (start - stop) / 104.2e-6, np.array([95e-6])
    >>> d = solve_d(counts, gamma0, np.array([1.0]), np.array([-np.pi / 2]), start, stop)
    >>> print((d * 1e6).round(2))
    [25.91]
    """

    def excess(d: Array, *arguments: Array) -> Array:
        wanted, *rest = arguments
        return _counts(d, *rest)[0] - wanted

    def slope(d: Array, *arguments: Array) -> Array:
        return _counts(d, *arguments[1:])[1]

    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(np.abs(amplitude) > 1e-9, NEAREST_TO_STALL * gamma0 / np.abs(amplitude), np.nan)
    arguments = (counts, gamma0, amplitude, phase, start, stop)
    # Steps grow without bound towards the stall on one side only; on the other they fall to a least value
    # and may rise again: a working drive is between the stall and that least value.
    downhill = -np.sign(slope(np.zeros_like(gamma0), *arguments)) * limit
    least = find_root(slope, (np.zeros_like(gamma0), downhill), args=arguments)
    turning = np.where(least.success, least.x, downhill)
    root = find_root(excess, (-downhill, turning), args=arguments)
    return np.where(root.success, root.x, np.nan)


def iterate_d(counts: Array, gamma0: Array, start: Array, stop: Array, iterations: int) -> Array:
    """The thesis's way: scale d by how far the mean step it predicts is off, again and again.

    The listing itself is not reproduced here; this form has its starting value (first order in delta)
    and its rate of convergence, 0.11 to 0.16 per iteration. It holds for joint 2 with psi = theta = 0,
    where u = sin(zeta), zeta = -q2.

    Parameters
    ----------
    counts, gamma0 : array, shape (n,)
        As in `solve_d`.
    start, stop : array, shape (n,)
        Ends of the traverse in q2, rad.
    iterations : int

    Returns
    -------
    array, shape (iterations + 1, n)
        d before the first iteration and after each, rad.
    """
    delta = np.abs(stop - start) / counts - gamma0
    mean_load = np.abs((np.cos(stop) - np.cos(start)) / (stop - start))
    d = delta / mean_load
    path = [d]
    for _ in range(iterations):
        predicted, _ = _counts(d, gamma0, np.ones_like(d), np.full_like(d, -np.pi / 2), start, stop)
        d = d * delta / (np.abs(stop - start) / predicted - gamma0)
        path.append(d)
    return np.stack(path)


def d_from_quadratic(delta: npt.ArrayLike) -> Array:
    """Eq. 6.6: d = 3.41 x^2 + 0.025 x + 6.42e-7 rad, with x the mean step's change in units of 0.01 rad.

    The thesis gives x in rad or µrad, which makes nonsense. Even so read, one quadratic for every
    gamma0 is off by up to 1.6 µrad between 75 and 115 µrad.

    Parameters
    ----------
    delta : array_like
        Change of the mean step over joint 2's full traverse, rad.

    Examples
    --------
    >>> print((d_from_quadratic([9.2e-6, -9.2e-6]) * 1e6).round(1))
    [ 26.5 -19.5]
    """
    x = np.asarray(delta, float) / 0.01
    return 3.41 * x**2 + 0.025 * x + 6.42e-7


def _counts(
    d: Array, gamma0: Array, amplitude: Array, phase: Array, start: Array, stop: Array
) -> tuple[Array, Array]:
    counts, _, by_swing = harmonic_counts(gamma0, d * amplitude, phase, start, stop)
    return counts, by_swing * amplitude
