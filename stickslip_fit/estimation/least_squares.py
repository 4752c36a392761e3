"""fit_least_squares: parameters of every session and direction from all traverses. Start reading here.

Order of reading: `_problem`, `_optimize`, `noise`, `result`. How rows are weighted is in two files:
`reweighting.iterate_weights` repeats the fit with the weights that its residuals give, which are
`Likelihood.irls_weight` over `row_variance` in `noise`. Profile-likelihood intervals are after D. Bates and
D. Watts, Nonlinear Regression Analysis and Its Applications (Wiley, 1988), Ch. 6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import format_value, join_words, pluralize
from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._groups import Groups, group_rows, mean_step_sizes, usable_rows
from stickslip_fit.estimation._optimize import RANK_TOL, Minimum, minimize
from stickslip_fit.estimation._problem import DEFAULT_OPTIONS, FitOptions, JointProblem, single_problem
from stickslip_fit.estimation.identifiability import (
    configuration_rows,
    describe_combinations,
    describe_configuration,
    identifiable_parameters,
)
from stickslip_fit.estimation.noise import (
    GAUSSIAN,
    Flag,
    Likelihood,
    flag_doubtful_repeatability,
    flag_missing_error_bars,
    interval_half_widths,
    one_sided_intervals,
    quadratic_interval,
    row_variance,
    t_quantile,
)
from stickslip_fit.estimation.result import JointFit, Result, build_provenance
from stickslip_fit.estimation.reweighting import ConvergedFit, flag_outliers, from_residuals, iterate_weights
from stickslip_fit.estimation.shared_estimate import Covariances, SharedCovariance
from stickslip_fit.estimation.travel import driven_stretches
from stickslip_fit.estimation.with_causes import (
    FixedCauseLaw,
    fixed_causes,
    flag_causes,
    flag_same_log,
    problems_with_causes,
    published_problem,
    release_causes,
)
from stickslip_fit.laws import Configuration, Laws, StepLaw, choose_laws
from stickslip_fit.laws.base import Model
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine

FITTING_SHARE = 0.5  # of the time; the rest looks for outlying counts


def fit_least_squares(
    log: Log,
    *,
    laws: Laws | None = None,
    causes: Sequence[Cause] = (),
    causes_from: Result | None = None,
    likelihood: Likelihood = GAUSSIAN,
    shared: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    repeatability: Mapping[tuple[int, str], float] | None = None,
    noise_ratio: Array | None = None,
    command: str = "",
    progress: ProgressCallback = ignore_progress,
) -> Result:
    """Fit the law of every joint to all usable traverses of a log.

    Parameters
    ----------
    log : Log
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    causes : sequence of Cause, optional
        Departures from the laws to fit with them: one set of parameters for the whole campaign,
        the same for all joints, directions and sessions.
    causes_from : Result, optional
        Of another log: its causes are taken as known, and their uncertainty goes into the error bars.
    likelihood : Likelihood, optional
        `StudentT` where an end stop may have been misheard now and then.
    shared : sequence of str, optional
        Parameters that are the same in all sessions, e.g. ``("b",)``: one value for each direction.
    bounds : dict of str to (float, float), optional
        Lowest and highest value of a parameter, SI.
    repeatability : dict of (int, str) to float, optional
        By joint and direction, relative: known beforehand, not estimated from this log.
    noise_ratio : array, shape (n,), optional
        Standard deviation of the noise of each usable traverse, in any unit, where those of a joint and
        direction differ, as `diagnose` finds out.
    command : str, optional
        Kept in the result's provenance.
    progress : callable, optional
        Called with each step that begins and the share of the work that is done.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If the log has no usable traverse or cannot show a cause, no law has a parameter that is named,
        `noise_ratio` is not a positive number for each usable traverse, or `causes_from` is of another
        machine, knows no causes, or stands beside `causes` or `shared`.

    Notes
    -----
    The response is log(steps), so that the errors are relative, as the repeatability is. Its variance
    is the repeatability's, pooled over the log by joint and direction, plus the rounding's. With a
    `noise_ratio` the repeatability is the root mean square over the traverses of a joint and direction.
    """
    rows = usable_rows(log)
    chosen = choose_laws(rows, log.machine, laws)
    by_joint = {joint: rows[rows["joint"] == joint] for joint in chosen}
    noise = None if noise_ratio is None else _label_noise(noise_ratio, rows)
    options = FitOptions(likelihood, tuple(shared), bounds or {}, repeatability or {}, noise)
    known = None
    if causes_from is not None:
        if causes or shared:
            raise InputError("known causes stand neither beside causes to fit nor beside shared parameters")
        known = fixed_causes(causes_from, log.machine)
        chosen = known.hold(chosen)
    if causes:
        progress("fitting", 0.0)
        problems, combined = problems_with_causes(causes, chosen, by_joint, log.machine, options)
        fits = [iterate_weights(problems, combined, options)]
    else:
        options.check(chosen.values())
        problems = [single_problem(chosen[joint], subset, options) for joint, subset in by_joint.items()]
        fits = []
        for problem in problems:
            progress("fitting", FITTING_SHARE * len(fits) / len(problems))
            fits.append(iterate_weights([problem], problem, options))
    joints = [joint for fit in fits for joint in _joint_results(fit, log.machine, options)]
    if known is not None:
        joints = [
            (release_causes(own, known, _differentiate_minimum(fit, own)), residual, flags)
            for fit, (own, residual, flags) in zip(fits, joints, strict=True)
        ]
    flags = [flag for _, _, flags in joints for flag in flags]
    if causes:
        at_bound = [fits[0].minimum_of(number).at_bound for number in range(len(problems))]
        flags += flag_causes([fit for fit, _, _ in joints], at_bound)
    residuals = [
        pd.DataFrame({"joint": joint, "residual": residual, "used": True}, index=subset.index)
        for (joint, subset), (_, residual, _) in zip(by_joint.items(), joints, strict=True)
    ]
    result = Result(
        method=likelihood.method if noise_ratio is None else f"weighted-{likelihood.method}",
        machine=log.machine,
        joints={fit.law.joint: fit for fit, _, _ in joints},
        residuals=pd.concat(residuals).sort_index(),
        flags=tuple(flags),
        provenance=build_provenance(log, command),
    )
    progress("looking for outlying counts", FITTING_SHARE)
    return flag_same_log(flag_outliers(result, log), causes_from)


def _differentiate_minimum(fit: ConvergedFit, joint: JointFit) -> Array:
    """Change of a joint's parameters with each size of its fixed causes, shape (g, p, q).

    At a minimum of W (y - f)^2 it is -(J' W J)^-1 J' W K, of slopes J by parameters and K by sizes.
    """
    law, (problem,), own = joint.law, fit.joints, joint.values.shape[1]
    assert isinstance(law, FixedCauseLaw)
    slopes = law.extended.model(problem.rows)(law.whole(joint.values[problem.groups.of_row]))[1]
    fall = [problem.gradient(slopes[:, :own], fit.information * slope) for slope in slopes[:, own:].T]
    return -np.asarray(joint.covariance) @ np.stack(fall, axis=-1)


def _label_noise(noise_ratio: Array, rows: pd.DataFrame) -> pd.Series:
    values = np.asarray(noise_ratio, dtype=float)
    if values.shape != (len(rows),) or not np.all((values > 0) & np.isfinite(values)):
        raise InputError(
            f"noise_ratio must be {len(rows)} positive numbers, one for each usable traverse of the log"
        )
    return pd.Series(values, rows.index)


def fit_joint(law: StepLaw, rows: pd.DataFrame, machine: Machine) -> tuple[JointFit, Array, list[Flag]]:
    """Fit one joint's law to its rows; also the residuals, shape (n,), and the flags."""
    problem = single_problem(law, rows, DEFAULT_OPTIONS)
    fit = iterate_weights([problem], problem, DEFAULT_OPTIONS)
    (joint,) = _joint_results(fit, machine, DEFAULT_OPTIONS)
    return joint


def _joint_results(
    fit: ConvergedFit, machine: Machine, options: FitOptions
) -> list[tuple[JointFit, Array, list[Flag]]]:
    """Each joint's fit, its residuals, shape (n,), and the flags on it."""
    whole, minimum, of_row = fit.whole, fit.minimum, fit.whole.groups.of_row
    slopes = whole.model(minimum.values[of_row])[1]
    estimate: _Estimate
    if whole.has_more_than_rows and not minimum.at_bound.any():
        estimate = _ByRows(*whole.estimate_shared(slopes, fit.information))
    else:
        estimate = _ByCurvature(whole.curvature(slopes * ~minimum.at_bound[of_row], fit.information))
    unbounded = estimate
    if minimum.at_bound.any():
        unbounded = _ByCurvature(whole.curvature(slopes, fit.information))
    gradient = whole.gradient(slopes, fit.weight * minimum.residual)
    common = _common_half_widths(fit, slopes)
    return [
        _joint_result(fit, number, common, estimate, unbounded, gradient, machine, options)
        for number in range(len(fit.joints))
    ]


_OfJoint = tuple[BoolArray, Covariances, Array]
"""Which parameters are known, their covariance, and the curvature by them, of each of a joint's groups."""


class _Estimate(Protocol):
    """What is known of the parameters of all joints' groups."""

    def of_joint(self, place: slice, columns: IntArray, scales: Array) -> _OfJoint:
        """Of a joint's groups and columns, with the scales of its parameters."""


@dataclass(frozen=True, eq=False)
class _ByCurvature:
    """By the curvature, shape (g, p, p)."""

    curvature: Array

    def of_joint(self, place: slice, columns: IntArray, scales: Array) -> _OfJoint:
        """See `_Estimate`."""
        curvature = self.curvature[place][:, columns[:, None], columns]
        known, _, covariance = identifiable_parameters(curvature, scales)
        return known, covariance, curvature


@dataclass(frozen=True, eq=False)
class _ByRows:
    """By the rows, of which there are fewer than parameters; see `Problem.estimate_shared`."""

    known: BoolArray
    covariance: SharedCovariance
    own: Array

    def of_joint(self, place: slice, columns: IntArray, scales: Array) -> _OfJoint:
        """See `_Estimate`; the curvature is that by the joint's own parameters only."""
        first = columns[: len(columns) - len(self.covariance.shared)]
        own = self.own[place][:, first[:, None], first]
        return self.known[place][:, columns], self.covariance.select(place, first), own


def _common_half_widths(fit: ConvergedFit, slopes: Array) -> Array:
    """Half-widths of the intervals of the causes' parameters in standard errors, shape (q,).

    Their degrees of freedom are those of the noise of all joints and directions, each with its share of the
    information (F. E. Satterthwaite, Biometrics Bulletin 2, 110, 1946).
    """
    if isinstance(fit.whole, JointProblem):
        return np.zeros(0)
    squares = fit.information[:, None] * slopes[:, fit.whole.sharing.parameters] ** 2
    total, spread = np.zeros((2, squares.shape[1]))
    for number, problem in enumerate(fit.joints):
        for direction, level in fit.repeatability[number].items():
            if level.df > 0:  # else its rows take the noise of others
                own = squares[fit.rows(number)][(problem.rows["direction"] == direction).to_numpy()].sum(
                    axis=0
                )
                total, spread = total + own, spread + own**2 / level.df
    seen = spread > 0  # what no count shows, such as the moment of a jump, has no error to reach
    return np.array([t_quantile(df) for df in np.where(seen, total**2 / np.where(seen, spread, 1.0), 1.0)])


def _joint_result(
    fit: ConvergedFit,
    number: int,
    common: Array,
    estimate: _Estimate,
    all_unbounded: _Estimate,
    all_gradient: Array,
    machine: Machine,
    options: FitOptions,
) -> tuple[JointFit, Array, list[Flag]]:
    """See `_joint_results`; estimates with and without active bounds, and gradient, are of all joints.

    `common` are the half-widths of the last parameters' intervals, shape (q,), which are those of all joints.
    """
    problem, minimum, repeatability = fit.joints[number], fit.minimum_of(number), fit.repeatability[number]
    law, groups, values, at_bound = problem.law, problem.groups, minimum.values, minimum.at_bound
    place, columns = fit.groups(number), fit.columns(number)
    known, covariance, curvature = estimate.of_joint(place, columns, problem.scales)
    known |= at_bound | _not_applicable(law)
    by_group = interval_half_widths(groups.table, repeatability)
    without_bars = np.isnan(by_group[:, 0])
    if isinstance(covariance, SharedCovariance):
        covariance = replace(covariance, unknown=without_bars)
    else:
        covariance *= ~(at_bound[:, :, None] | at_bound[:, None, :])
        covariance[without_bars] = np.nan
    reach = np.tile(by_group, values.shape[1])
    reach[:, values.shape[1] - len(common) :] = common
    interval = quadratic_interval(values, covariance, reach)
    if at_bound.any():
        _, unbounded, _ = all_unbounded.of_joint(place, columns, problem.scales)
        interval[at_bound] = one_sided_intervals(
            values, at_bound, problem.lower, all_gradient[place, columns], np.asarray(unbounded), reach
        )
    shared = tuple(parameter.name for parameter in law.parameters if parameter.name in options.shared)
    travel = driven_stretches(problem.rows)
    joint = JointFit(law, groups.table, values, known, covariance, interval, repeatability, shared, travel)
    published = published_problem(problem)
    own, information = slice(0, len(published.law.parameters)), fit.information[fit.rows(number)]
    flags = _flag_unidentified(
        published, machine, known[:, own], curvature[:, own, own], information, values[:, own]
    )
    flags += _flag_at_bound(published, values[:, own], at_bound[:, own])
    flags += _flag_not_converged(law, groups, minimum)
    flags += flag_missing_error_bars(law, groups.table, repeatability)
    estimated = from_residuals(problem, minimum, options.likelihood)
    flags += flag_doubtful_repeatability(law, options.known_noise(law.joint), estimated)
    return joint, minimum.residual, flags


def _flag_unidentified(
    problem: JointProblem,
    machine: Machine,
    known: npt.NDArray[np.bool_],
    curvature: Array,
    information: Array,
    values: Array,
) -> list[Flag]:
    """For each group with unknown parameters, a flag naming them and the traverses to make.

    `known` and `values` have shape (g, p), `curvature` (g, p, p), and the rows' Fisher `information` (n,).
    """
    law, groups, flags = problem.law, problem.groups, []
    names = np.array([parameter.name for parameter in law.parameters])
    for group in np.flatnonzero(~known.all(axis=1)):
        session, direction = groups.table.loc[group, ["session", "direction"]]
        scales = problem.scales[group]
        eigenvalue, vector = np.linalg.eigh(curvature[group] * scales[:, None] * scales)
        root = np.sqrt(np.maximum(eigenvalue, 0.0))[:, None] * vector.T  # slopes that have this curvature
        seen = root / np.sqrt(np.mean(information))
        wanted = _missing_configurations(law, machine, direction, seen, values[group], scales)
        missing = f"missing: {'; '.join(map(describe_configuration, wanted))}"
        if not wanted:
            missing = describe_combinations(law, curvature[group], scales)
        count, shared = pluralize(int(groups.sizes[group]), "usable traverse"), problem.sharing.parameters
        for where, rows, subset in ((str(session), count, ~shared), ("", "the whole campaign", shared)):
            unknown = tuple(names[~known[group] & subset])
            together = " one by one" if len(unknown) > 1 else ""
            text = f"{join_words(unknown)} cannot be known{together} from {rows}; {missing}"
            flag = Flag.at("not_identified", law.joint, direction, where, unknown, text)
            if unknown and flag not in flags:
                flags.append(flag)
    return flags


def _missing_configurations(
    law: StepLaw, machine: Machine, direction: str, slopes: Array, values: Array, scales: Array
) -> tuple[Configuration, ...]:
    """The smallest choice of the law's calibration that makes every parameter known."""
    candidates = law.calibration()
    if not candidates:
        return ()
    rows = configuration_rows(candidates, law.joint, direction, machine)
    # Where the fit left a law that stalls in a candidate, any law of ordinary effect serves to find the rank.
    gained = law.jacobian(rows, values) * scales
    if not np.all(np.isfinite(gained)):
        ordinary = law.start_values(np.array([np.max(np.abs(scales))]))[0]
        gained = law.jacobian(rows, ordinary) * scales
    for size in range(1, len(candidates)):
        for choice in combinations(range(len(candidates)), size):
            singular = np.linalg.svd(np.vstack([slopes, gained[list(choice)]]), compute_uv=False)
            if len(singular) == len(scales) and singular[-1] > 100 * RANK_TOL * singular[0]:
                return tuple(candidates[index] for index in choice)
    return candidates


def _flag_at_bound(problem: JointProblem, values: Array, at_bound: BoolArray) -> list[Flag]:
    """A flag for each parameter on a bound, one for all sessions if they share it."""
    law, flags = problem.law, {}
    for index, k in np.argwhere(at_bound):
        group, parameter = problem.groups.table.loc[index], law.parameters[k]
        session, direction = str(group["session"]), group["direction"]
        session = "" if problem.sharing.parameters[k] else session
        bound = format_value(values[index, k], parameter.unit, 4)
        text = (
            f"{parameter.name} is held back by its bound at {bound}; the counts would have it beyond, and "
            "the other error bars take the bound for true"
        )
        flags[session, direction, k] = Flag.at(
            "at_bound", law.joint, direction, session, (parameter.name,), text
        )
    return list(flags.values())


def _not_applicable(law: StepLaw) -> npt.NDArray[np.bool_]:
    """Parameters that need no slope in a joint's rows: sudden, or without effect there; shape (p,)."""
    if not isinstance(law, ExtendedLaw):
        return np.zeros(len(law.parameters), dtype=bool)
    sudden = np.array(
        [False] * len(law.law.parameters) + [parameter.sudden for parameter in law.cause_parameters]
    )
    return ~law.affects_joint | sudden


def _flag_not_converged(law: StepLaw, groups: Groups, minimum: Minimum) -> list[Flag]:
    names = tuple(parameter.name for parameter in law.parameters)
    text = "the fit has not converged; look for an outlier among this session's counts"
    return [
        Flag.at("not_converged", law.joint, group.direction, group.session, names, text)
        for group in groups.table[~minimum.converged].itertuples()
    ]


INTERVAL_DIFFERENCE = 0.1  # of the quadratic interval's half-width
MAX_ROOT_PASSES = 8
ROOT_TOL = 1e-4  # of the distance to the interval's end


def profile_intervals(log: Log, result: Result) -> pd.DataFrame:
    """The parameters of a least-squares fit with both intervals of 95 % beside each other.

    Parameters
    ----------
    result : Result
        The log's least-squares fit.

    Returns
    -------
    DataFrame
        `Result.si.parameters` with profile_low and profile_high, and differs: whether an end is off by
        more than a tenth of the quadratic interval's half-width, so that the quadratic one misleads.

    Raises
    ------
    InputError
        If `result` is no least-squares fit of `log`, or sessions share parameters, as those of causes.
    """
    if result.method != "least-squares" or result.provenance.log_sha256 != log.sha256:
        raise InputError("profile intervals need the least-squares fit of this very log; fit it again")
    if any(fit.shared or fit.cause_parameters for fit in result.joints.values()):
        raise InputError("profile intervals are for fits in which each session has all its own parameters")
    rows = usable_rows(log)
    ends = [_profile_joint(fit, rows[rows["joint"] == joint]) for joint, fit in result.joints.items()]
    table = result.si.parameters
    table[["profile_low", "profile_high"]] = np.concatenate([end.reshape(-1, 2) for end in ends])
    half = (table["high"] - table["low"]) / 2
    off = np.fmax((table["profile_low"] - table["low"]).abs(), (table["profile_high"] - table["high"]).abs())
    table["differs"] = (off > INTERVAL_DIFFERENCE * half).to_numpy(dtype=bool, na_value=False)
    return table


def _profile_joint(fit: JointFit, rows: pd.DataFrame) -> Array:
    """Ends of each parameter's interval, shape (g, p, 2); NaN where it is not known."""
    groups, law = group_rows(rows), fit.law
    y, rounding = law.response(rows)
    weight = 1.0 / row_variance(rows, rounding, fit.repeatability)
    scales = law.scales(mean_step_sizes(groups, rows, y))
    model = law.model(rows)
    least = groups.sums(weight * (y - model(fit.values[groups.of_row])[0]) ** 2)
    reach = interval_half_widths(groups.table, fit.repeatability)[:, 0]
    ends = np.full((*fit.values.shape, 2), np.nan)
    for index in range(fit.values.shape[1]):
        for side, sign in enumerate((-1.0, 1.0)):
            ends[:, index, side] = _solve_end(
                fit, model, y, weight, groups, scales, least, index, sign * reach
            )
    free = np.diagonal(fit.covariance, axis1=1, axis2=2) > 0
    return np.where((fit.known & free)[:, :, None], ends, np.nan)


def _solve_end(
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
    for _ in range(MAX_ROOT_PASSES):
        fixed = fit.values[:, index] + distance
        start = fit.values[:, others] + along * distance[:, None]
        others_model = _fix_parameter(model, index, fixed[groups.of_row], fit.known[groups.of_row])
        minimum = minimize(others_model, y, weight, groups, start, scales[:, others], damping=0.0)
        excess = np.sqrt(np.maximum(groups.sums(weight * minimum.residual**2) - least, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            stretch = np.where(excess > 0, np.abs(reach) / excess, 1.0)
        distance = distance * np.clip(np.nan_to_num(stretch, nan=1.0), 0.5, 2.0)
        if np.nanmax(np.abs(stretch - 1.0)) < ROOT_TOL:
            break
    return fit.values[:, index] + distance


def _fix_parameter(model: Model, index: int, fixed: Array, known: npt.NDArray[np.bool_]) -> Model:
    """The model with one parameter fixed, as a function of the others; unknown ones have no slope."""

    def others_model(values: Array) -> tuple[Array, Array]:
        response, jacobian = model(np.insert(values, index, fixed, axis=1))
        return response, np.delete(jacobian * known, index, axis=1)

    return others_model
