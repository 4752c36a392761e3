"""The load coefficient d of a rotary joint from one count: exactly, and by the thesis's two methods.

With gravity, the steps over a traverse are N = integral of dq / (gamma0 + d u(q)), and the mean step changes
by delta = traverse / N - gamma0. The thesis (Sec. 6.2) gets d from delta by an iteration and by a fitted
quadratic (Eq. 6.6); solving the integral has the error of neither.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.estimation.identifiability import is_full
from stickslip_fit.estimation.result import Result, choose_repeatability
from stickslip_fit.laws import Elbow, expected_steps, rounding_variance, traverse_length
from stickslip_fit.laws.integration import harmonic_counts
from stickslip_fit.logs import Log

MAX_LOAD_RATIO = 1.0 - 1e-9


def solve_load_coefficient(
    counts: Array, gamma0: Array, amplitude: Array, phase: Array, start: Array, stop: Array
) -> Array:
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
    >>> d = solve_load_coefficient(counts, gamma0, np.array([1.0]), np.array([-np.pi / 2]), start, stop)
    >>> print((d * 1e6).round(2))
    [25.91]
    """
    from scipy.optimize.elementwise import find_root

    def excess(d: Array, counts: Array, gamma0: Array, amplitude: Array, *path: Array) -> Array:
        return harmonic_counts(gamma0, d * amplitude, *path)[0] - counts

    def slope(d: Array, counts: Array, gamma0: Array, amplitude: Array, *path: Array) -> Array:
        return harmonic_counts(gamma0, d * amplitude, *path)[2] * amplitude

    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(np.abs(amplitude) > 1e-9, MAX_LOAD_RATIO * gamma0 / np.abs(amplitude), np.nan)
    arguments = (counts, gamma0, amplitude, phase, start, stop)
    # Steps grow without bound towards the stall on one side only; on the other they fall to a least value
    # and may rise again: a working drive is between the stall and that least value.
    downhill = -np.sign(slope(np.zeros_like(gamma0), *arguments)) * limit
    least = find_root(slope, (np.zeros_like(gamma0), downhill), args=arguments)
    turning = np.where(least.success, least.x, downhill)
    root = find_root(excess, (-downhill, turning), args=arguments)
    return np.where(root.success, root.x, np.nan)


def iterate_load_coefficient(
    counts: Array, gamma0: Array, start: Array, stop: Array, iterations: int
) -> Array:
    """The thesis's iteration: d is multiplied by the change of the mean step over that which it predicts.

    It starts at first order in delta and converges at a rate of 0.11 to 0.16 per iteration. It holds for
    joint 2 with psi = theta = 0, where u = sin(zeta), zeta = -q2. The thesis's listing walks single steps
    where this integrates, which makes a difference of 1e-9 rad.

    Parameters
    ----------
    counts, gamma0 : array, shape (n,)
        As in `solve_load_coefficient`.
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
        predicted = harmonic_counts(gamma0, d, np.full_like(d, -np.pi / 2), start, stop)[0]
        d = d * delta / (np.abs(stop - start) / predicted - gamma0)
        path.append(d)
    return np.stack(path)


def load_coefficient_from_quadratic(delta: npt.ArrayLike) -> Array:
    """Eq. 6.6: d = 3.41 x^2 + 0.025 x + 6.42e-7 rad, with x the mean step's change in units of 0.01 rad.

    The thesis gives no unit of x; rad or µrad cannot be. Read as here, one quadratic for every gamma0 is off
    by up to 1.4 µrad between 75 and 115 µrad, for changes up to its 9.2 µrad.

    Parameters
    ----------
    delta : array_like
        Change of the mean step over joint 2's full traverse, rad.

    Examples
    --------
    >>> print((load_coefficient_from_quadratic([9.2e-6, -9.2e-6]) * 1e6).round(1))
    [ 26.5 -19.5]
    """
    x = np.asarray(delta, float) / 0.01
    return 3.41 * x**2 + 0.025 * x + 6.42e-7


THESIS_ITERATIONS = 3
LOAD_TOL = 1e-6  # cos(theta) of a base on its side


def tabulate_load_coefficients(log: Log, calibration: Result, fit: Result) -> pd.DataFrame:
    """gamma0 and d wherever a session has joint 2's full traverse with and without load.

    Replicates are averaged; errors are one repeatability carried through the solution.

    Returns
    -------
    DataFrame
        session, direction, q3, gamma0, gamma0_error, delta (change of the mean step under the full
        load), d, d_error, iteration_0 ... iteration_3 (the thesis's iteration) and quadratic (its
        Eq. 6.6); rad and m. Empty where the log has no such pair, or the machine another geometry.
    """
    joint = Elbow.joint
    rows = log.usable
    if not log.machine.has_published_geometry:
        return rows[:0]
    rows = rows[(rows["joint"] == joint) & (np.abs(rows["psi"]) < LOAD_TOL)]
    rows = rows[is_full(rows, log.machine.span(joint))]
    swing = np.abs(np.cos(rows["theta"].to_numpy(float)))
    unloaded = _average_replicates(rows[swing < LOAD_TOL])
    loaded = _average_replicates(rows[np.abs(rows["theta"]) < LOAD_TOL])
    pairs = unloaded.merge(loaded, on=["session", "direction", "q3"], suffixes=("_unloaded", "_loaded"))
    if pairs.empty:
        return pairs
    order = np.lexsort((pairs["direction"], pairs["q3"], pd.factorize(pairs["session"])[0]))
    noise = {sign: choose_repeatability(joint, sign, calibration, fit).value for sign in ("+", "-")}
    return _solve_pairs(pairs.iloc[order], noise, log.machine.ranges[joint])


def _average_replicates(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean log steps of each session, direction and q3, with their number and the rounding's variance."""
    work = rows[["session", "direction", "q3"]].astype({"session": object, "direction": object})
    work["y"] = np.log(expected_steps(rows["steps"], rows["check_every"]))
    work["rounding"] = rounding_variance(rows["steps"], rows["check_every"])
    work["travel"] = traverse_length(rows)
    groups = work.groupby(["session", "direction", "q3"], sort=False, as_index=False)
    return groups.agg(
        y=("y", "mean"), n=("y", "size"), rounding=("rounding", "mean"), travel=("travel", "first")
    )


def _solve_pairs(pairs: pd.DataFrame, noise: dict[str, float], ends: tuple[float, float]) -> pd.DataFrame:
    start = np.where(pairs["direction"] == "+", *ends)
    stop = np.where(pairs["direction"] == "+", *ends[::-1])
    counts = np.exp(pairs["y_loaded"].to_numpy())
    gamma0 = pairs["travel_unloaded"].to_numpy() / np.exp(pairs["y_unloaded"].to_numpy())
    count_error, gamma0_error = (
        _mean_relative_error(pairs, which, noise) for which in ("loaded", "unloaded")
    )
    swing = np.ones(len(pairs)), np.full(len(pairs), -np.pi / 2), start, stop

    d = solve_load_coefficient(counts, gamma0, *swing)
    by_count = solve_load_coefficient(counts * np.exp(count_error), gamma0, *swing) - d
    by_gamma0 = solve_load_coefficient(counts, gamma0 * np.exp(gamma0_error), *swing) - d
    path = iterate_load_coefficient(counts, gamma0, start, stop, THESIS_ITERATIONS)
    table = pairs[["session", "direction", "q3"]].assign(
        gamma0=gamma0,
        gamma0_error=gamma0 * gamma0_error,
        delta=np.abs(stop - start) / counts - gamma0,
        d=d,
        d_error=np.hypot(by_count, by_gamma0),
    )
    for step, values in enumerate(path):
        table[f"iteration_{step}"] = values
    return table.assign(quadratic=load_coefficient_from_quadratic(table["delta"]))


def _mean_relative_error(pairs: pd.DataFrame, which: str, noise: dict[str, float]) -> np.ndarray:
    """Standard error of the mean of n replicates: repeatability and rounding."""
    variance = pairs["direction"].map(noise) ** 2 + pairs[f"rounding_{which}"]
    return np.sqrt(variance / pairs[f"n_{which}"]).to_numpy(float)
