"""All parameters from all sweeps: nonlinear least squares for each session and direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.fit.at_bound import at_bound_remarks, one_sided_intervals
from stickslip_fit.fit.groups import Groups, usable_rows
from stickslip_fit.fit.identifiability import explain_unknown, known_parameters
from stickslip_fit.fit.intervals import quadratic_interval, reaches
from stickslip_fit.fit.levenberg_marquardt import Minimum
from stickslip_fit.fit.likelihood import Likelihood
from stickslip_fit.fit.outliers import flag_outliers
from stickslip_fit.fit.problem import single_problem
from stickslip_fit.fit.provenance import provenance
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.repeatability import GAUSSIAN, Repeatability, doubts, without_error_bars
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.fit.reweighting import ConvergedFit, from_residuals, iterate_weights
from stickslip_fit.fit.terms import DEFAULT_OPTIONS, FitOptions
from stickslip_fit.fit.with_causes import own_part, problems_with_causes, remarks_on_causes
from stickslip_fit.laws import StepLaw, published_law
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine

Array = npt.NDArray[np.float64]


def least_squares(
    log: Log,
    *,
    causes: Sequence[Cause] = (),
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
    causes : sequence of Cause, optional
        Departures from the published laws to fit with them: one set of parameters for the whole campaign,
        the same for all joints, directions and sessions.
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
        If the log has no usable traverse or cannot show a cause, or no law has a parameter that is named.

    Notes
    -----
    The response is log(steps), so that the errors are relative, as the repeatability is. Its variance
    is the repeatability's, pooled over the log by joint and direction, plus the rounding's.
    """
    rows = usable_rows(log)
    by_joint = {joint: rows[rows["joint"] == joint] for joint in log.joints}
    by_joint = {joint: mine for joint, mine in by_joint.items() if len(mine)}
    laws = {joint: published_law(joint, mine, log.machine) for joint, mine in by_joint.items()}
    options = FitOptions(likelihood, tuple(shared), bounds or {}, repeatability or {})
    if causes:
        problems, combined = problems_with_causes(causes, laws, by_joint, log.machine, options)
        fits = [iterate_weights(problems, combined, options)]
    else:
        options.check(laws.values())
        problems = [single_problem(laws[joint], mine, options) for joint, mine in by_joint.items()]
        fits = [iterate_weights([problem], problem, options) for problem in problems]
    joints = [joint for fit in fits for joint in _joint_results(fit, log.machine, options)]
    remarks = [remark for _, _, remarks in joints for remark in remarks]
    if causes:
        at_bound = [fits[0].minimum_of(number).at_bound for number in range(len(problems))]
        remarks += remarks_on_causes([fit for fit, _, _ in joints], at_bound)
    residuals = [
        pd.DataFrame({"joint": joint, "residual": residual, "used": True}, index=mine.index)
        for (joint, mine), (_, residual, _) in zip(by_joint.items(), joints, strict=True)
    ]
    result = Result(
        method=likelihood.method,
        machine=log.machine,
        joints={fit.law.joint: fit for fit, _, _ in joints},
        residuals=pd.concat(residuals).sort_index(),
        remarks=tuple(remarks),
        provenance=provenance(log, command),
    )
    return flag_outliers(result, log)


def fit_joint(
    law: StepLaw, rows: pd.DataFrame, machine: Machine, options: FitOptions = DEFAULT_OPTIONS
) -> tuple[JointFit, Array, list[Remark]]:
    """Fit one joint's law to its rows; also the residuals, shape (n,), and the remarks."""
    problem = single_problem(law, rows, options)
    (joint,) = _joint_results(iterate_weights([problem], problem, options), machine, options)
    return joint


def _joint_results(
    fit: ConvergedFit, machine: Machine, options: FitOptions
) -> list[tuple[JointFit, Array, list[Remark]]]:
    """Each joint's fit, its residuals, shape (n,), and the remarks on it."""
    whole, minimum, of_row = fit.whole, fit.minimum, fit.whole.groups.of_row
    slopes = whole.model(minimum.values[of_row])[1]
    curvature = whole.curvature(slopes * ~minimum.at_bound[of_row], fit.information)
    unbounded = curvature
    if minimum.at_bound.any():
        unbounded = whole.curvature(slopes, fit.information)
    gradient = whole.gradient(slopes, fit.weight * minimum.residual)
    return [
        _joint_result(fit, number, curvature, unbounded, gradient, machine, options)
        for number in range(len(fit.joints))
    ]


def _joint_result(
    fit: ConvergedFit,
    number: int,
    all_curvature: Array,
    all_unbounded: Array,
    all_gradient: Array,
    machine: Machine,
    options: FitOptions,
) -> tuple[JointFit, Array, list[Remark]]:
    """See `_joint_results`; curvature with and without active bounds, and gradient, are of all joints."""
    problem, minimum, repeatability = fit.joints[number], fit.minimum_of(number), fit.repeatability[number]
    law, groups, values, at_bound = problem.law, problem.groups, minimum.values, minimum.at_bound
    place, columns = fit.groups(number), fit.columns(number)
    curvature = all_curvature[place][:, columns[:, None], columns]
    known, _, covariance = known_parameters(curvature, problem.scales)
    known |= at_bound | _not_applicable(law)
    covariance *= ~(at_bound[:, :, None] | at_bound[:, None, :])
    covariance = _with_error_bars(covariance, groups, repeatability)
    interval = quadratic_interval(values, covariance, groups.table, repeatability)
    if at_bound.any():
        _, _, unbounded = known_parameters(all_unbounded[place][:, columns[:, None], columns], problem.scales)
        interval[at_bound] = one_sided_intervals(
            values, at_bound, problem.lower, all_gradient[place, columns], unbounded,
            reaches(groups.table, repeatability),
        )  # fmt: skip
    shared = tuple(parameter.name for parameter in law.parameters if parameter.name in options.shared)
    joint = JointFit(law, groups.table, values, known, covariance, interval, repeatability, shared)
    published, own = own_part(problem), slice(0, len(own_part(problem).law.parameters))
    remarks = explain_unknown(
        published, machine, known[:, own], curvature[:, own, own], fit.information[fit.rows(number)],
        values[:, own],
    )  # fmt: skip
    remarks += at_bound_remarks(published, values[:, own], at_bound[:, own])
    remarks += _not_converged(law, groups, minimum) + without_error_bars(law, groups.table, repeatability)
    estimated = from_residuals(problem, minimum, options.likelihood)
    remarks += doubts(law, options.given(law.joint), estimated)
    return joint, minimum.residual, remarks


def _not_applicable(law: StepLaw) -> npt.NDArray[np.bool_]:
    """Parameters of which a joint need not know anything by slopes, shape (p,)."""
    if not isinstance(law, ExtendedLaw):
        return np.zeros(len(law.parameters), dtype=bool)
    sudden = np.array([False] * len(law.law.parameters) + [parameter.sudden for parameter in law.common])
    return ~law.concerned | sudden


def _with_error_bars(covariance: Array, groups: Groups, repeatability: dict[str, Repeatability]) -> Array:
    freedom = np.array([repeatability[way].freedom for way in groups.table["direction"]])
    return np.where((freedom > 0)[:, None, None], covariance, np.nan)


def _not_converged(law: StepLaw, groups: Groups, found: Minimum) -> list[Remark]:
    names = tuple(parameter.name for parameter in law.parameters)
    return [
        Remark(
            "not_converged", law.joint, group.direction, group.session, names,
            f"joint {law.joint}, direction {group.direction}, session {group.session}: the fit has not "
            "settled; look for an outlier among this session's counts",
        )
        for group in groups.table[~found.converged].itertuples()
    ]  # fmt: skip
