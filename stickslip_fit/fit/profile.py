"""Profile-likelihood intervals: how far a parameter can go while the others make the best of it.

D. M. Bates and D. G. Watts, Nonlinear Regression Analysis and Its Applications, Wiley, 1988, Ch. 6.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.fit.groups import Groups, group_rows, mean_steps, usable_rows
from stickslip_fit.fit.intervals import reaches
from stickslip_fit.fit.levenberg_marquardt import minimise
from stickslip_fit.fit.repeatability import variance_of
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.laws.law import Model
from stickslip_fit.logs import Log

Array = npt.NDArray[np.float64]

DIFFERS = 0.1  # of the quadratic interval's half-width
PASSES = 8
SETTLED = 1e-4  # of the distance to the interval's end


def profile_intervals(log: Log, result: Result) -> pd.DataFrame:
    """The parameters of a least-squares fit with both intervals of 95 % beside each other.

    Parameters
    ----------
    log : Log
        The one that was fitted.
    result : Result
        Its least-squares fit.

    Returns
    -------
    DataFrame
        `Result.parameters` with profile_low and profile_high, SI, and differs: whether an end is off by
        more than a tenth of the quadratic interval's half-width, so that the quadratic one misleads.

    Raises
    ------
    InputError
        If `result` is no least-squares fit of `log`.
    """
    if result.method != "least-squares" or result.provenance.log_sha256 != log.sha256:
        raise InputError("profile intervals need the least-squares fit of this very log; fit it again")
    if any(fit.shared for fit in result.joints.values()):
        raise InputError("profile intervals are for fits in which each session has all its own parameters")
    rows = usable_rows(log)
    ends = [_profile_joint(fit, rows[rows["joint"] == joint]) for joint, fit in result.joints.items()]
    table = result.parameters
    table[["profile_low", "profile_high"]] = np.concatenate([end.reshape(-1, 2) for end in ends])
    half = (table["high"] - table["low"]) / 2
    off = np.fmax((table["profile_low"] - table["low"]).abs(), (table["profile_high"] - table["high"]).abs())
    table["differs"] = (off > DIFFERS * half).to_numpy(dtype=bool, na_value=False)
    return table


def _profile_joint(fit: JointFit, rows: pd.DataFrame) -> Array:
    """Ends of each parameter's interval, shape (g, p, 2); NaN where it is not known."""
    groups, law = group_rows(rows), fit.law
    y, rounding = law.response(rows)
    weight = 1.0 / variance_of(rows, rounding, fit.repeatability)
    scales = law.scales(mean_steps(groups, rows, y))
    model = law.model(rows)
    least = groups.sums(weight * (y - model(fit.values[groups.of_row])[0]) ** 2)
    reach = reaches(groups.table, fit.repeatability)
    ends = np.full((*fit.values.shape, 2), np.nan)
    for index in range(fit.values.shape[1]):
        for side, sign in enumerate((-1.0, 1.0)):
            ends[:, index, side] = _end(fit, model, y, weight, groups, scales, least, index, sign * reach)
    free = np.diagonal(fit.covariance, axis1=1, axis2=2) > 0
    return np.where((fit.known & free)[:, :, None], ends, np.nan)


def _end(
    fit: JointFit,
    model: Model,
    y: Array,
    weight: Array,
    groups: Groups,
    scales: Array,
    least: Array,
    index: int,
    reach: Array,
) -> Array:
    """Where the root of the excess cost is as large as `reach`, its sign saying on which side; shape (g,)."""
    others = np.arange(fit.values.shape[1]) != index
    covariance = np.nan_to_num(fit.covariance)
    error = np.sqrt(covariance[:, index, index])
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.nan_to_num(covariance[:, others, index] / error[:, None] ** 2)
    distance = np.nan_to_num(reach * error)
    for _ in range(PASSES):
        fixed = fit.values[:, index] + distance
        start = fit.values[:, others] + along * distance[:, None]
        held = _hold(model, index, fixed[groups.of_row], fit.known[groups.of_row])
        found = minimise(held, y, weight, groups, start, scales[:, others], damping=0.0)
        excess = np.sqrt(np.maximum(groups.sums(weight * found.residual**2) - least, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            stretch = np.where(excess > 0, np.abs(reach) / excess, 1.0)
        distance = distance * np.clip(np.nan_to_num(stretch, nan=1.0), 0.5, 2.0)
        if np.nanmax(np.abs(stretch - 1.0)) < SETTLED:
            break
    return fit.values[:, index] + distance


def _hold(model: Model, index: int, fixed: Array, known: npt.NDArray[np.bool_]) -> Model:
    """The model with one parameter held, as a function of the others; those not known stay where they are."""

    def held(values: Array) -> tuple[Array, Array]:
        response, jacobian = model(np.insert(values, index, fixed, axis=1))
        return response, np.delete(jacobian * known, index, axis=1)

    return held
