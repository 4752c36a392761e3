"""All parameters from all sweeps: nonlinear least squares for each session and direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.at_bound import at_bound_remarks, one_sided_intervals
from stickslip_fit.fit.groups import Groups, usable_rows
from stickslip_fit.fit.identifiability import explain_unknown, known_parameters
from stickslip_fit.fit.intervals import quadratic_interval, reaches
from stickslip_fit.fit.levenberg_marquardt import Minimum
from stickslip_fit.fit.likelihood import Likelihood
from stickslip_fit.fit.problem import Problem, lay_out
from stickslip_fit.fit.provenance import provenance
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.repeatability import (
    GAUSSIAN,
    Repeatability,
    doubts,
    pooled,
    variance_of,
    without_error_bars,
)
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.fit.terms import NO_TERMS, Terms
from stickslip_fit.fit.wild_counts import name_wild_counts
from stickslip_fit.laws import StepLaw, published_law
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine

Array = npt.NDArray[np.float64]

# The first pass weighs all traverses alike; then the rounding's share of the variance, and under heavy tails
# the residuals themselves, change the weights until they settle.
MOST_PASSES = 100
SETTLED = 1e-6


def least_squares(
    log: Log,
    *,
    likelihood: Likelihood = GAUSSIAN,
    shared: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    repeatability: Mapping[tuple[int, str], float] | None = None,
    command: str = "",
) -> Result:
    """Fit the published law of every joint to all usable traverses of a log.

    Parameters
    ----------
    log : Log
    likelihood : Likelihood, optional
        `StudentT` where an end stop may have been misheard now and then.
    shared : sequence of str, optional
        Parameters that are the same in all sessions, e.g. ``("b",)``: one value for each direction.
    bounds : dict of str to (float, float), optional
        Lowest and highest value of a parameter, SI.
    repeatability : dict of (int, str) to float, optional
        By joint and direction, relative: known beforehand, not estimated from this log.
    command : str, optional
        Kept in the result's provenance.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If the log has no usable traverse, or no law has a parameter that is named.

    Notes
    -----
    The response is log(steps), so that the errors are relative, as the repeatability is. Its variance
    is the repeatability's, pooled over the log by joint and direction, plus the rounding's.
    """
    rows = usable_rows(log)
    by_joint = {joint: rows[rows["joint"] == joint] for joint in log.joints}
    by_joint = {joint: mine for joint, mine in by_joint.items() if len(mine)}
    laws = {joint: published_law(joint, mine, log.machine) for joint, mine in by_joint.items()}
    terms = Terms(likelihood, tuple(shared), bounds or {}, repeatability or {})
    terms.check(laws.values())
    joints, residuals, remarks = {}, [], []
    for joint, mine in by_joint.items():
        joints[joint], residual, said = fit_joint(laws[joint], mine, log.machine, terms)
        residuals.append(pd.DataFrame({"joint": joint, "residual": residual, "used": True}, index=mine.index))
        remarks += said
    result = Result(
        method=likelihood.method,
        machine=log.machine,
        joints=joints,
        residuals=pd.concat(residuals).sort_index(),
        remarks=tuple(remarks),
        provenance=provenance(log, command),
    )
    return name_wild_counts(result, log)


def fit_joint(
    law: StepLaw, rows: pd.DataFrame, machine: Machine, terms: Terms = NO_TERMS
) -> tuple[JointFit, Array, list[Remark]]:
    """Fit one joint's law to its rows; also the residuals, shape (n,), and what is to be said."""
    problem = lay_out(law, rows, terms)
    found, repeatability, weight, information = _settle(problem, terms)
    groups, values = problem.groups, found.values
    slopes = problem.model(values[groups.of_row])[1]
    curvature = problem.curvature(slopes * ~found.at_bound[groups.of_row], information)
    known, _, covariance = known_parameters(curvature, problem.scales)
    known |= found.at_bound
    covariance *= ~(found.at_bound[:, :, None] | found.at_bound[:, None, :])
    covariance = _with_error_bars(covariance, groups, repeatability)
    interval = quadratic_interval(values, covariance, groups.table, repeatability)
    if found.at_bound.any():
        _, _, unbound = known_parameters(problem.curvature(slopes, information), problem.scales)
        uphill, reach = problem.uphill(slopes, weight * found.residual), reaches(groups.table, repeatability)
        one_sided = one_sided_intervals(values, found.at_bound, problem.lower, uphill, unbound, reach)
        interval[found.at_bound] = one_sided
    shared = tuple(parameter.name for parameter in law.parameters if parameter.name in terms.shared)
    fit = JointFit(law, groups.table, values, known, covariance, interval, repeatability, shared)
    remarks = explain_unknown(problem, machine, known, curvature, information, values)
    remarks += at_bound_remarks(problem, values, found.at_bound) + _not_converged(law, groups, found)
    remarks += without_error_bars(law, groups.table, repeatability)
    estimated = _from_residuals(problem, found, terms.likelihood)
    remarks += doubts(law, terms.given(law.joint), estimated)
    return fit, found.residual, remarks


def _settle(problem: Problem, terms: Terms) -> tuple[Minimum, dict[str, Repeatability], Array, Array]:
    """Minimise, weigh the rows by what is left over, and so on until the weights settle.

    Returns
    -------
    found : Minimum
    repeatability : dict of str to Repeatability
    weight, information : array, shape (n,)
        Of each row in the search, and of what it tells about the parameters.
    """
    likelihood, start, weight = terms.likelihood, problem.start, np.ones(len(problem.y))
    for _ in range(MOST_PASSES):
        found = problem.minimise(weight, start)
        repeatability = _from_residuals(problem, found, likelihood) | terms.given(problem.law.joint)
        scale2 = variance_of(problem.rows, problem.rounding, repeatability, likelihood)
        before, weight = weight, likelihood.share(found.residual**2 / scale2) / scale2
        start = found.values
        if np.max(np.abs(weight / before - 1.0)) < SETTLED:
            break
    return found, repeatability, weight, likelihood.information / scale2


def _from_residuals(problem: Problem, found: Minimum, likelihood: Likelihood) -> dict[str, Repeatability]:
    """Repeatability of each direction from what the fit leaves over."""
    repeatability = {}
    for way in ("+", "-"):
        mine = (problem.rows["direction"] == way).to_numpy()
        freedom = int(mine.sum() - found.rank[problem.ways == way].sum())
        repeatability[way] = pooled(
            found.residual[mine], problem.rounding[mine], freedom, "residuals", likelihood
        )
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
