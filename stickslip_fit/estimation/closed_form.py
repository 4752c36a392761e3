"""Closed-form calibration: as many traverses as parameters, solved exactly (thesis Eqs. 6.2 to 6.4).

The load coefficient d of a rotary joint solves N = integral of dq / (gamma0 + d u(q)) for the counted
steps N. `solve_load_coefficient` finds it by bracketed root finding. For comparison: the iteration of
the thesis, and its quadratic in delta = travel / N - gamma0 (Eq. 6.6).
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd
from scipy.linalg import qr

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.estimation._groups import Groups, group_rows, mean_step_sizes, usable_rows
from stickslip_fit.estimation._optimize import RANK_TOL
from stickslip_fit.estimation._problem import DEFAULT_OPTIONS, single_problem
from stickslip_fit.estimation.identifiability import (
    configuration_rows,
    describe_configuration,
    identifiable_parameters,
    is_full,
)
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.estimation.load_coefficient import solve_load_coefficient
from stickslip_fit.estimation.noise import (
    Flag,
    NoiseLevel,
    estimate_from_replicates,
    flag_missing_error_bars,
    interval_half_widths,
    quadratic_interval,
    row_variance,
)
from stickslip_fit.estimation.result import JointFit, Result, build_provenance
from stickslip_fit.estimation.reweighting import flag_outliers
from stickslip_fit.estimation.travel import driven_stretches
from stickslip_fit.estimation.with_causes import (
    FixedCauseLaw,
    FixedCauses,
    difference_sensitivity,
    fixed_cause_effect,
    fixed_causes,
    flag_same_log,
    law_without_causes,
    release_causes,
    solve_with_fixed_causes,
)
from stickslip_fit.laws import ConstantStep, Laws, Prismatic, Rotary, StepLaw, choose_laws, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine

FEATURE_TOL = 1e-6
NOMINAL_SHARE = 0.02  # of the scales
NOMINAL_STEPS = 10_000  # over a joint's whole range
POSITION_TOL = 1e-9  # of the range
MIN_DF = 4  # degrees of freedom; with fewer an interval is several times too wide to be of use


def fit_closed_form(
    log: Log, *, laws: Laws | None = None, causes_from: Result | None = None, command: str = ""
) -> Result:
    """Calibrate every session and direction from the first traverse of each calibration configuration.

    Parameters
    ----------
    log : Log
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    causes_from : Result, optional
        Of another log: its causes are taken as known, and their uncertainty goes into the error bars.
    command : str, optional
        Kept in the result's provenance.

    Returns
    -------
    Result
        Error bars come from the repeatability that the log's replicates show, or failing those what a
        least-squares fit leaves over, carried through the calibration equations to first order.

    Raises
    ------
    InputError
        If the log has no usable traverse, or `causes_from` is of another machine or knows no causes.
    """
    chosen = choose_laws(usable_rows(log), log.machine, laws)
    known = None
    if causes_from is not None:
        known = fixed_causes(causes_from, log.machine)
        chosen = known.hold(chosen)
    result = flag_outliers(solve_calibration(log, chosen, "closed-form", known=known, command=command), log)
    return flag_same_log(result, causes_from)


def solve_calibration(
    log: Log,
    laws: dict[int, StepLaw],
    method: str,
    *,
    companion_laws: dict[int, StepLaw] | None = None,
    known: FixedCauses | None = None,
    command: str = "",
) -> Result:
    """Solve the calibration equations of each joint's law, with its causes where these are fixed.

    A law uses the first traverses of its own calibration, as many as it has parameters, or of the calibration
    of its joint's law in `companion_laws`.
    """
    rows = usable_rows(log)
    joints, residuals, flags = {}, [], []
    for joint, law in laws.items():
        subset = rows[rows["joint"] == joint]
        groups = group_rows(subset)
        companion = companion_laws[joint] if companion_laws else law
        picked = pick_calibration(companion, subset, groups, log.machine)[:, : len(law.parameters)]
        joints[joint] = _calibrate_joint(law, subset, groups, picked, log.machine, known)
        residuals.append(_residual_table(joints[joint], subset, groups, picked))
        flags += _flag_missing_traverses(law, groups, picked, joints[joint])
        flags += flag_missing_error_bars(law, groups.table, joints[joint].repeatability)
    return Result(
        method=method,
        machine=log.machine,
        joints=joints,
        residuals=pd.concat(residuals).sort_index(),
        flags=tuple(flags),
        provenance=build_provenance(log, command),
    )


def pick_calibration(law: StepLaw, rows: pd.DataFrame, groups: Groups, machine: Machine) -> IntArray:
    """Position in `rows` of each group's first full traverse in each calibration configuration, (g, p).

    A traverse serves if it has the configuration's features: the base may lie on either side. -1 for none.
    Of a law that names no configurations, the traverses that together determine its parameters best.
    """
    if not law.calibration():
        return _pick_most_informative(law_without_causes(law), rows, groups, machine)
    full = is_full(rows, machine.span(law.joint), POSITION_TOL).to_numpy()
    features = law.features(rows)
    wanted = law.features(configuration_rows(law.calibration(), law.joint, "+", machine))
    picked = np.full((len(groups), len(wanted)), -1)
    for index, target in enumerate(wanted):
        scale = np.maximum(np.max(np.abs(wanted), axis=0), FEATURE_TOL)
        serves = np.flatnonzero(full & np.all(np.abs(features - target) < FEATURE_TOL * scale, axis=1))
        group, first = np.unique(groups.of_row[serves], return_index=True)
        picked[group, index] = serves[first]
    return picked


def _pick_most_informative(law: StepLaw, rows: pd.DataFrame, groups: Groups, machine: Machine) -> IntArray:
    """Rows of each group whose responses determine the parameters best, by QR with pivoting, (g, p).

    -1 beyond the rank. The counts are not looked at: the law has its start values for a usual step.
    """
    usual = np.array([machine.span(law.joint) / NOMINAL_STEPS])
    p, scales = len(law.parameters), law.scales(usual)[0]
    # Off the start values, where an amplitude of 0 would hide its phase.
    slopes = law.jacobian(rows, law.start_values(usual)[0] + NOMINAL_SHARE * scales) * scales
    picked = np.full((len(groups), p), -1)
    for group in range(len(groups)):
        own = np.flatnonzero((groups.of_row == group) & np.isfinite(slopes).all(axis=1))
        if len(own):
            triangle, order = qr(slopes[own].T, mode="r", pivoting=True)
            size = np.abs(np.diag(triangle))
            rank = int(np.sum(size > 100 * RANK_TOL * size[0]))
            picked[group, :rank] = own[order[:rank]]
    return picked


def _calibrate_joint(
    law: StepLaw,
    rows: pd.DataFrame,
    groups: Groups,
    picked: IntArray,
    machine: Machine,
    known: FixedCauses | None,
) -> JointFit:
    y, rounding = law.response(rows)
    steps = np.where(picked >= 0, np.exp(y)[picked], np.nan)
    mean_step = mean_step_sizes(groups, rows, y)

    def solve(law: StepLaw) -> Array:
        if isinstance(law, FixedCauseLaw):
            published = partial(_solve_parameters, law.law, rows, machine, picked)
            return solve_with_fixed_causes(law, rows, picked, steps, mean_step, published)
        return _solve_parameters(law, rows, machine, picked, steps)

    values = solve(law)
    effect = fixed_cause_effect(law, rows, values[groups.of_row], mean_step[groups.of_row])
    repeatability = _estimate_noise(law, rows, picked, machine, effect)
    variance = row_variance(rows, rounding, repeatability)
    covariance = _propagate_covariance(law, rows, picked, values, variance)
    df = np.array([repeatability[direction].df for direction in groups.table["direction"]])
    covariance[df < 1] = np.nan
    interval = quadratic_interval(values, covariance, interval_half_widths(groups.table, repeatability))
    identified, travel = np.isfinite(values), driven_stretches(rows)
    fit = JointFit(law, groups.table, values, identified, covariance, interval, repeatability, travel=travel)
    if known is None:
        return fit
    return release_causes(fit, known, difference_sensitivity(fit, known, solve))


def _estimate_noise(
    law: StepLaw, rows: pd.DataFrame, picked: IntArray, machine: Machine, effect: Array | float
) -> dict[str, NoiseLevel]:
    """From replicates not used for calibration, so that an estimate and its error bar are independent.

    A direction with too few of those takes the residuals of a least-squares fit, and failing that all
    replicates, those used for calibration among them.
    """
    unused = np.setdiff1d(np.arange(len(rows)), picked)
    effect = np.broadcast_to(effect, len(rows))
    of_unused = estimate_from_replicates(law, rows.iloc[unused], effect[unused])
    if all(noise.df >= MIN_DF for noise in of_unused.values()):
        return of_unused
    sources = (of_unused, fit_joint(law, rows, machine)[0].repeatability)
    return {
        direction: next((source[direction] for source in sources if source[direction].df >= MIN_DF), noise)
        for direction, noise in estimate_from_replicates(law, rows, effect).items()
    }


def _solve_parameters(
    law: StepLaw, rows: pd.DataFrame, machine: Machine, picked: IntArray, steps: Array
) -> Array:
    """Parameters from the steps of each calibration traverse, (g, p) -> (g, p); NaN in, NaN out."""
    gamma = traverse_length(rows)[picked] / steps
    if isinstance(law, ConstantStep):
        return gamma
    if isinstance(law, Prismatic):
        plain, recoiling, loaded = gamma.T
        return np.stack([plain, 1.0 - recoiling / plain, plain * (1.0 - loaded / recoiling)], axis=-1)
    if isinstance(law, Rotary):
        return _solve_rotary(law, rows, machine, picked, steps, gamma)
    return _solve_numerically(law, rows, picked, steps)


def _solve_numerically(law: StepLaw, rows: pd.DataFrame, picked: IntArray, steps: Array) -> Array:
    """The same equations for a law without a closed form, (g, m) -> (g, p), by least squares."""
    made = (picked >= 0) & np.isfinite(steps)
    values = np.full((len(picked), len(law.parameters)), np.nan)
    if made.any():
        traverses = rows.iloc[picked[made]].assign(steps=steps[made], check_every=1)
        problem = single_problem(law, traverses, DEFAULT_OPTIONS)
        minimum = problem.minimize(np.ones(len(traverses)), problem.start)
        known, _, _ = identifiable_parameters(minimum.curvature, problem.scales)
        known &= minimum.converged[:, None]
        values[made.any(axis=1)] = np.where(known, minimum.values, np.nan)
    return values


def _solve_rotary(
    law: Rotary, rows: pd.DataFrame, machine: Machine, picked: IntArray, steps: Array, gamma: Array
) -> Array:
    m = picked.shape[1] // 2
    gamma0, loaded = gamma[:, :m], picked[:, m:]
    amplitude, phase = law.swing(rows)
    start, stop = (rows[name].to_numpy()[loaded].ravel() for name in ("start", "stop"))
    d = solve_load_coefficient(
        steps[:, m:].ravel(), gamma0.ravel(), amplitude[loaded].ravel(), phase[loaded].ravel(), start, stop
    ).reshape(gamma0.shape)
    unloaded = law.calibration()[:m]
    inverse = np.linalg.inv(law.basis(configuration_rows(unloaded, law.joint, "+", machine)))
    # A missing traverse makes only the parameters that need it NaN: 0 times NaN counts as 0 here.
    needed = np.abs(inverse) > FEATURE_TOL * np.max(np.abs(inverse))
    both = [np.sum(np.where(needed, inverse * part[:, None, :], 0.0), axis=2) for part in (gamma0, d)]
    return np.concatenate(both, axis=1)


def _propagate_covariance(
    law: StepLaw, rows: pd.DataFrame, picked: IntArray, values: Array, variance: Array
) -> Array:
    """Covariance of the parameters: the counts' variances through the inverse of the law's Jacobian."""
    covariance = np.full((*values.shape, values.shape[1]), np.nan)
    known, made = np.isfinite(values), picked >= 0
    patterns, pattern_of = np.unique(np.concatenate([known, made], axis=1), axis=0, return_inverse=True)
    for index, pattern in enumerate(patterns):
        groups = np.flatnonzero(pattern_of == index)
        names, traverses = (np.flatnonzero(half) for half in np.split(pattern, 2))
        taken = picked[np.ix_(groups, traverses)]
        # A traverse that depends on an unknown parameter, 0 here, tells nothing of the others.
        filled = np.repeat(np.nan_to_num(values[groups]), len(traverses), axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = law.jacobian(rows.iloc[taken.ravel()], filled).reshape(*taken.shape, values.shape[1])
        finite = np.isfinite(slopes).all(axis=(0, 2))
        inverse = np.linalg.pinv(slopes[:, finite][:, :, names])
        block = np.einsum("gik,gk,gjk->gij", inverse, variance[taken[:, finite]], inverse)
        covariance[np.ix_(groups, names, names)] = block
    return covariance


def _residual_table(fit: JointFit, rows: pd.DataFrame, groups: Groups, picked: IntArray) -> pd.DataFrame:
    y, _ = fit.law.response(rows)
    used = np.zeros(len(rows), dtype=bool)
    used[picked[picked >= 0]] = True
    residual = y - fit.law.predict(rows, fit.values[groups.of_row])
    return pd.DataFrame({"joint": fit.law.joint, "residual": residual, "used": used}, index=rows.index)


def _flag_missing_traverses(law: StepLaw, groups: Groups, picked: IntArray, fit: JointFit) -> list[Flag]:
    flags = []
    names = [parameter.name for parameter in fit.law.parameters]
    for index in np.flatnonzero(~fit.known.all(axis=1)):
        session, direction = groups.table.loc[index, ["session", "direction"]]
        unknown = tuple(name for name, fine in zip(names, fit.known[index], strict=True) if not fine)
        configurations, absent = law.calibration(), np.flatnonzero(picked[index] < 0)
        reason = "no step size above zero gives the counts of its calibration traverses; repeat them"
        if len(absent):
            reason = "the session's traverses do not determine them one by one"
            if configurations:
                missing = [describe_configuration(configurations[k]) for k in absent]
                reason = f"missing: {'; '.join(missing)}"
        text = f"{', '.join(unknown)} cannot be calibrated; {reason}"
        flags.append(Flag.at("not_identified", law.joint, direction, session, unknown, text))
    return flags
