"""All parameters from all sweeps: nonlinear least squares for each session and direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.fit.at_bound import at_bound_remarks, one_sided_intervals
from stickslip_fit.fit.fitting import Fitting, Settled, by_itself, from_residuals, settle
from stickslip_fit.fit.groups import Groups, usable_rows
from stickslip_fit.fit.identifiability import explain_unknown, known_parameters
from stickslip_fit.fit.intervals import quadratic_interval, reaches
from stickslip_fit.fit.levenberg_marquardt import Minimum
from stickslip_fit.fit.likelihood import Likelihood
from stickslip_fit.fit.outliers import flag_outliers
from stickslip_fit.fit.problem import lay_out
from stickslip_fit.fit.provenance import provenance
from stickslip_fit.fit.remark import Remark
from stickslip_fit.fit.repeatability import GAUSSIAN, Repeatability, doubts, without_error_bars
from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.fit.terms import NO_TERMS, Terms
from stickslip_fit.fit.with_causes import lay_out_with, own_part, remarks_on_causes
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
    terms = Terms(likelihood, tuple(shared), bounds or {}, repeatability or {})
    if causes:
        fittings = [lay_out_with(causes, laws, by_joint, log.machine, terms)]
    else:
        terms.check(laws.values())
        fittings = [by_itself(lay_out(laws[joint], mine, terms)) for joint, mine in by_joint.items()]
    found = [each for fitting in fittings for each in _fit(fitting, log.machine, terms)]
    remarks = [remark for each in found for remark in each.remarks]
    if causes:
        remarks += remarks_on_causes([each.fit for each in found], [each.at_bound for each in found])
    residuals = [
        pd.DataFrame({"joint": joint, "residual": each.residual, "used": True}, index=mine.index)
        for (joint, mine), each in zip(by_joint.items(), found, strict=True)
    ]
    result = Result(
        method=likelihood.method,
        machine=log.machine,
        joints={each.fit.law.joint: each.fit for each in found},
        residuals=pd.concat(residuals).sort_index(),
        remarks=tuple(remarks),
        provenance=provenance(log, command),
    )
    return flag_outliers(result, log)


def fit_joint(
    law: StepLaw, rows: pd.DataFrame, machine: Machine, terms: Terms = NO_TERMS
) -> tuple[JointFit, Array, list[Remark]]:
    """Fit one joint's law to its rows; also the residuals, shape (n,), and what is to be said."""
    (found,) = _fit(by_itself(lay_out(law, rows, terms)), machine, terms)
    return found.fit, found.residual, found.remarks


@dataclass(frozen=True, eq=False)
class _Found:
    """What a fit says of one joint."""

    fit: JointFit
    residual: Array
    at_bound: npt.NDArray[np.bool_]
    remarks: list[Remark]


@dataclass(frozen=True, eq=False)
class _Said:
    """What all rows of a fitting say of each group's parameters.

    Attributes
    ----------
    curvature, unbound : array, shape (g, p, p)
        With parameters held by a bound, and as if there were none.
    uphill : array, shape (g, p)
    """

    curvature: Array
    unbound: Array
    uphill: Array


def _fit(fitting: Fitting, machine: Machine, terms: Terms) -> list[_Found]:
    settled = settle(fitting, terms)
    whole, found, of_row = fitting.whole, settled.found, fitting.whole.groups.of_row
    slopes = whole.model(found.values[of_row])[1]
    said = _Said(
        whole.curvature(slopes * ~found.at_bound[of_row], settled.information),
        whole.curvature(slopes, settled.information),
        whole.uphill(slopes, settled.weight * found.residual),
    )
    return [
        _of_joint(fitting, number, settled, said, machine, terms) for number in range(len(fitting.problems))
    ]


def _of_joint(
    fitting: Fitting, number: int, settled: Settled, said: _Said, machine: Machine, terms: Terms
) -> _Found:
    problem, found = fitting.problems[number], fitting.part(settled.found, number)
    law, groups, values, at_bound = problem.law, problem.groups, found.values, found.at_bound
    repeatability = settled.repeatability[number]
    curvature = fitting.square(said.curvature, number)
    known, _, covariance = known_parameters(curvature, problem.scales)
    known |= at_bound | _beside_the_point(law)
    covariance *= ~(at_bound[:, :, None] | at_bound[:, None, :])
    covariance = _with_error_bars(covariance, groups, repeatability)
    interval = quadratic_interval(values, covariance, groups.table, repeatability)
    if at_bound.any():
        _, _, unbound = known_parameters(fitting.square(said.unbound, number), problem.scales)
        uphill = said.uphill[fitting.groups(number), fitting.columns[number]]
        reach = reaches(groups.table, repeatability)
        interval[at_bound] = one_sided_intervals(values, at_bound, problem.lower, uphill, unbound, reach)
    shared = tuple(parameter.name for parameter in law.parameters if parameter.name in terms.shared)
    fit = JointFit(law, groups.table, values, known, covariance, interval, repeatability, shared)
    published, own = own_part(problem), slice(0, len(own_part(problem).law.parameters))
    information = settled.information[fitting.rows(number)]
    remarks = explain_unknown(
        published, machine, known[:, own], curvature[:, own, own], information, values[:, own]
    )
    remarks += at_bound_remarks(published, values[:, own], at_bound[:, own])
    remarks += _not_converged(law, groups, found) + without_error_bars(law, groups.table, repeatability)
    estimated = from_residuals(problem, found, terms.likelihood)
    remarks += doubts(law, terms.given(law.joint), estimated)
    return _Found(fit, found.residual, at_bound, remarks)


def _beside_the_point(law: StepLaw) -> npt.NDArray[np.bool_]:
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
