"""Joint 2's gamma0 and d at each q3 of a log, d by exact solving and in the thesis's two ways (its 6.3)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit.fit import Result, d_from_quadratic, iterate_d, solve_d
from stickslip_fit.laws import Elbow, expected_steps, rounding_variance, travel
from stickslip_fit.logs import Log
from stickslip_fit.report.figures.traverses import is_full, repeatability_of

ITERATIONS = 3
NO_LOAD = 1e-6  # cos(theta) of a base on its side


def load_coefficients(log: Log, calibration: Result, fit: Result) -> pd.DataFrame:
    """gamma0 and d wherever a session has joint 2's full traverse with and without load.

    Replicates are averaged; errors are one repeatability carried through the solution.

    Returns
    -------
    DataFrame
        session, direction, q3, gamma0, gamma0_error, delta (change of the mean step under the full
        load), d, d_error, iteration_0 ... iteration_3 (the thesis's iteration) and quadratic (its
        Eq. 6.6); rad and m. Empty where the log has no such pair.
    """
    joint = Elbow.joint
    rows = log.usable
    rows = rows[(rows["joint"] == joint) & (np.abs(rows["psi"]) < NO_LOAD)]
    rows = rows[is_full(rows, log.machine.span(joint))]
    swing = np.abs(np.cos(rows["theta"].to_numpy(float)))
    unloaded = _averaged(rows[swing < NO_LOAD])
    loaded = _averaged(rows[np.abs(rows["theta"]) < NO_LOAD])
    pairs = unloaded.merge(loaded, on=["session", "direction", "q3"], suffixes=("_unloaded", "_loaded"))
    if pairs.empty:
        return pairs
    order = np.lexsort((pairs["direction"], pairs["q3"], pd.factorize(pairs["session"])[0]))
    noise = {way: repeatability_of(joint, way, calibration, fit).value for way in ("+", "-")}
    return _solved(pairs.iloc[order], noise, log.machine.ranges[joint])


def _averaged(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean log steps of each session, direction and q3, with their number and the rounding's variance."""
    work = rows[["session", "direction", "q3"]].astype({"session": object, "direction": object})
    work["y"] = np.log(expected_steps(rows["steps"], rows["check_every"]))
    work["rounding"] = rounding_variance(rows["steps"], rows["check_every"])
    work["travel"] = travel(rows)
    groups = work.groupby(["session", "direction", "q3"], sort=False, as_index=False)
    return groups.agg(
        y=("y", "mean"), n=("y", "size"), rounding=("rounding", "mean"), travel=("travel", "first")
    )


def _solved(pairs: pd.DataFrame, noise: dict[str, float], ends: tuple[float, float]) -> pd.DataFrame:
    start = np.where(pairs["direction"] == "+", *ends)
    stop = np.where(pairs["direction"] == "+", *ends[::-1])
    counts = np.exp(pairs["y_loaded"].to_numpy())
    gamma0 = pairs["travel_unloaded"].to_numpy() / np.exp(pairs["y_unloaded"].to_numpy())
    count_error, gamma0_error = (_relative_error(pairs, which, noise) for which in ("loaded", "unloaded"))
    swing = np.ones(len(pairs)), np.full(len(pairs), -np.pi / 2), start, stop

    d = solve_d(counts, gamma0, *swing)
    by_count = solve_d(counts * np.exp(count_error), gamma0, *swing) - d
    by_gamma0 = solve_d(counts, gamma0 * np.exp(gamma0_error), *swing) - d
    path = iterate_d(counts, gamma0, start, stop, ITERATIONS)
    table = pairs[["session", "direction", "q3"]].assign(
        gamma0=gamma0,
        gamma0_error=gamma0 * gamma0_error,
        delta=np.abs(stop - start) / counts - gamma0,
        d=d,
        d_error=np.hypot(by_count, by_gamma0),
    )
    for step, values in enumerate(path):
        table[f"iteration_{step}"] = values
    return table.assign(quadratic=d_from_quadratic(table["delta"]))


def _relative_error(pairs: pd.DataFrame, which: str, noise: dict[str, float]) -> np.ndarray:
    """Of the mean of n replicates: repeatability and rounding."""
    variance = pairs["direction"].map(noise) ** 2 + pairs[f"rounding_{which}"]
    return np.sqrt(variance / pairs[f"n_{which}"]).to_numpy(float)
