"""All parameters from all sweeps: nonlinear least squares for each session and direction."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.curvature import moments_of
from stickslip_fit.fit.groups import Groups, group_rows, mean_steps, usable_rows
from stickslip_fit.fit.identifiability import explain_unknown, known_parameters
from stickslip_fit.fit.intervals import quadratic_interval
from stickslip_fit.fit.levenberg_marquardt import Minimum, minimise
from stickslip_fit.fit.likelihood import Likelihood
from stickslip_fit.fit.provenance import Provenance, versions
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.repeatability import GAUSSIAN, Repeatability, pooled, variance_of, without_error_bars
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.laws import StepLaw, published_law
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# The first pass weighs all traverses alike; then the rounding's share of the variance, and under heavy tails
# the residuals themselves, change the weights until they settle.
MOST_PASSES = 100
SETTLED = 1e-6


def least_squares(log: Log, *, likelihood: Likelihood = GAUSSIAN, command: str = "") -> Result:
    """Fit the published law of every joint to all usable traverses of a log.

    Parameters
    ----------
    log : Log
    likelihood : Likelihood, optional
        `StudentT` where an end stop may have been misheard now and then.
    command : str, optional
        Kept in the result's provenance.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If the log has no usable traverse.

    Notes
    -----
    The response is log(steps), so that the errors are relative, as the repeatability is. Its variance
    is the repeatability's, pooled over the log by joint and direction, plus the rounding's.
    """
    rows = usable_rows(log)
    joints, residuals, remarks = {}, [], []
    for joint in log.joints:
        mine = rows[rows["joint"] == joint]
        if len(mine):
            law = published_law(joint, mine, log.machine)
            joints[joint], residual, said = fit_joint(law, mine, log.machine, likelihood)
            residuals.append(
                pd.DataFrame({"joint": joint, "residual": residual, "used": True}, index=mine.index)
            )
            remarks += said
    return Result(
        method=likelihood.method,
        machine=log.machine,
        joints=joints,
        residuals=pd.concat(residuals).sort_index(),
        remarks=tuple(remarks),
        provenance=provenance(log, command),
    )


def fit_joint(
    law: StepLaw, rows: pd.DataFrame, machine: Machine, likelihood: Likelihood = GAUSSIAN
) -> tuple[JointFit, Array, list[Remark]]:
    """Fit one joint's law to its rows; also the residuals, shape (n,), and what is to be said."""
    groups = group_rows(rows)
    y, rounding = law.response(rows)
    mean_step = mean_steps(groups, rows, y)
    values, scales = law.start_values(mean_step), law.scales(mean_step)
    model, weight = law.model(rows), np.ones(len(y))
    for _ in range(MOST_PASSES):
        found = minimise(model, y, weight, groups, values, scales, damping=0.0)
        _, rank, _ = known_parameters(found.curvature, scales)
        repeatability = _from_residuals(rows, found, rounding, rank, groups, likelihood)
        scale2 = variance_of(rows, rounding, repeatability, likelihood)
        before, weight = weight, likelihood.share(found.residual**2 / scale2) / scale2
        values = found.values
        if np.max(np.abs(weight / before - 1.0)) < SETTLED:
            break
    information = likelihood.information / scale2
    curvature = moments_of(model, y, information, groups, values, scales).curvature(scales)
    known, _, covariance = known_parameters(curvature, scales)
    covariance = _with_error_bars(covariance, groups, repeatability)
    interval = quadratic_interval(values, covariance, groups.table, repeatability)
    fit = JointFit(law, groups.table, values, known, covariance, interval, repeatability)
    remarks = explain_unknown(law, machine, groups, known, rows, found.values, scales)
    remarks += _not_converged(law, groups, found) + without_error_bars(law, groups.table, repeatability)
    return fit, found.residual, remarks


def provenance(log: Log, command: str) -> Provenance:
    """Where a fit of `log` comes from."""
    return Provenance(
        log_files=tuple(name for name, _ in log.sources),
        log_sha256=log.sha256,
        machine_name=log.machine.name,
        machine_sha256=log.machine.sha256,
        versions=versions(),
        command=command,
    )


def _from_residuals(
    rows: pd.DataFrame, found: Minimum, rounding: Array, rank: Indices, groups: Groups, likelihood: Likelihood
) -> dict[str, Repeatability]:
    """Repeatability of each direction from what the fit leaves over."""
    ways = groups.table["direction"].to_numpy()
    repeatability = {}
    for way in ("+", "-"):
        mine = (rows["direction"] == way).to_numpy()
        freedom = int(mine.sum() - rank[ways == way].sum())
        repeatability[way] = pooled(found.residual[mine], rounding[mine], freedom, "residuals", likelihood)
    return repeatability


def _with_error_bars(covariance: Array, groups: Groups, repeatability: dict[str, Repeatability]) -> Array:
    freedom = np.array([repeatability[way].freedom for way in groups.table["direction"]])
    return np.where((freedom > 0)[:, None, None], covariance, np.nan)


def _not_converged(law: StepLaw, groups: Groups, found: Minimum) -> list[Remark]:
    names = tuple(parameter.name for parameter in law.parameters)
    return [
        Remark(
            "not_converged", law.joint, group.direction, group.session, names,
            f"joint {law.joint}, direction {group.direction}, session {group.session}: the fit has not "
            "settled; look at this session's counts for one that is wildly off",
        )
        for group in groups.table[~found.converged].itertuples()
    ]  # fmt: skip
