"""Effect sizes: from selected causes to findings with parameters and 95 % intervals.

The effect of a cause is estimated in the fitted form and in its alternative forms, as rms over all rows
(`effect_interval`), and far above the noise with what these may lack (`lack_of_fit`); what unknown structure
adds to the law, and what that leaves, in `unknown_size`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import betaincinv, ndtri, softmax

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes import OfJoints, SizedParameter
from stickslip_fit.causes.levels import LevelCause
from stickslip_fit.causes.proposed import CarryOverTerm, PeriodicTerm
from stickslip_fit.causes.table_terms import PeriodicTableTerm
from stickslip_fit.diagnosis.cause_set import SPECIAL_CASE_ODDS
from stickslip_fit.diagnosis.effect_interval import (
    MAX_CONDITIONAL_STRENGTH,
    QUANTILES_95,
    LawEffect,
    detection_threshold,
    estimate_effect,
    expected_covariance,
)
from stickslip_fit.diagnosis.extension import SelectedCause
from stickslip_fit.diagnosis.finding import Finding, joints_of_laws
from stickslip_fit.diagnosis.hypotheses import Hypothesis, acts_on
from stickslip_fit.diagnosis.lack_of_fit import N_DRAWS, LackOfFit
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.selection import Selection, predict_departures
from stickslip_fit.diagnosis.separability import is_distinguishable
from stickslip_fit.diagnosis.travel_profile import find_travel_profiles
from stickslip_fit.diagnosis.unknown_size import size_unknown
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.units import CREDIBLE, Z_95, Interval

MIN_SQUARE = 1e-300
NORMAL_SCORES = ndtri((np.arange(400) + 0.5) / 400)  # a standard normal distribution, by its quantiles
MIN_RIVAL = 0.05  # probability of a rival that is told, even if other data of this design would exclude it


def size_findings(selection: Selection, problem: DiagnosisProblem, alpha: float) -> tuple[Finding, ...]:
    """Findings of all selected causes and of unknown structure, see `order_findings`.

    `problem` is the one from which was selected, outlying rows included; `alpha` the false-alarm rate.
    """
    covariance = expected_covariance(selection)
    findings = []
    for selected in selection.selected:
        if selected.cause == problem.outlier_cause:
            findings.append(_size_outliers(selection, problem, selected))
        elif selected.cause == UNKNOWN:
            finding = size_unknown(selection, selected, alpha)
            if selected.version is not None:
                finding = _with_law(finding, selection, selected, covariance)
            findings.append(finding)
        else:
            findings.append(_size_cause(selection, selected, covariance, alpha))
    return order_findings(findings)


def order_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings, largest effect first; last what all leave without a name, for which there is no law."""

    def place(one: Finding) -> tuple[bool, float]:
        return one.cause == UNKNOWN and one.version is None, -one.effect.estimate

    return tuple(sorted(findings, key=place))


def _size_cause(selection: Selection, selected: SelectedCause, covariance: Array, alpha: float) -> Finding:
    place = selection.place_of(selected.version)
    values = selection.fit.values[place]
    effect = estimate_effect(selection, selected)
    size = effect.interval(detection_threshold(selected, selection.problem.linearize().df, alpha))
    if effect.strength > MAX_CONDITIONAL_STRENGTH:
        size = _with_lack(size, effect, selection)
    strength = size.estimate * effect.strength / effect.rms
    misfit, probability = selected.test, selected.cause_set.probability
    # Whatever the data, a general form does what its special case does, which suffices where it is likelier.
    general = selected.version.special_case_of
    suffices = probability.get(selected.cause, 0.0) > SPECIAL_CASE_ODDS * probability.get(general, 0.0)
    rivals = tuple(
        rival
        for rival in selected.cause_set.rivals
        if not (rival == general and suffices)
        and (
            rival in selected.cause_set.by_refit
            or probability.get(rival, 0.0) >= MIN_RIVAL
            or not is_distinguishable(misfit.best_hypothesis(selected.cause), misfit, rival, strength)
        )
    )
    parameters = _size_parameters(selected.version, selected.cause, values, covariance[place, place])
    rows, joints = selection.problem.rows, _joints_of(selected.version, selection)
    return Finding(
        selected.cause,
        selected.version,
        rivals,
        selected.p_value,
        joints,
        size,
        _bound_moment(parameters, selected.version, misfit, rows),
        together_with=selected.together_with,
        travel=find_travel_profiles(selected.version, values, covariance[place, place], joints, rows),
    )


def _joints_of(version: Any, selection: Selection) -> tuple[int, ...]:
    """The joints on which a cause acts."""
    return joints_of_laws(part.law for part in selection.problem.parts if acts_on(version, part.law))


def _with_lack(size: Interval, effect: LawEffect, selection: Selection) -> Interval:
    """The size of an effect, its upper end with what its form in the law may lack, which only adds."""
    problem = selection.problem
    lack = LackOfFit.of(problem.linearize_extended(selection.fit), effect)
    if lack is None:
        return size
    error = (size.high - size.low) / (2.0 * Z_95)
    draws = size.estimate + error * np.random.default_rng(0).standard_normal(N_DRAWS)
    high = np.quantile(lack.add_to(np.maximum(draws, 0.0), problem.scale), QUANTILES_95[-1])
    return Interval(size.estimate, size.low, max(size.high, float(high)))


def _size_parameters(
    version: Any, cause: str, values: Array, covariance: Array
) -> tuple[SizedParameter, ...]:
    """A cause's parameters with intervals, none beyond its bounds; of a smooth function its rms alone."""
    if hasattr(version, "summarize"):
        return tuple(version.summarize(values, covariance))
    if cause.startswith(COVARIATE_PREFIX) and not isinstance(version, LevelCause):
        return ()
    sudden = [getattr(parameter, "sudden", False) for parameter in version.parameters]
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    error = np.where((error > 0) & ~np.array(sudden), error, np.nan)
    return tuple(
        SizedParameter(
            parameter.name,
            parameter.unit,
            Interval(value, max(value - Z_95 * sd, parameter.lower), min(value + Z_95 * sd, parameter.upper)),
            parameter.joint,
            parameter.direction,
            parameter.session,
        )
        for parameter, value, sd, jumps in zip(version.parameters, values, error, sudden, strict=True)
        if np.isfinite(sd) or jumps
    )


def _bound_moment(
    parameters: tuple[SizedParameter, ...], version: Any, misfit: Misfit, rows: pd.DataFrame
) -> tuple[SizedParameter, ...]:
    """Parameters with the interval of the moment of a sudden change, if there is one.

    It holds the likeliest moments that share 95 % of the evidence, all of them equally likely before.
    """
    sudden = [one for one in version.parameters if getattr(one, "sudden", False)]
    tried = [
        (moment, evidence)
        for one, evidence in zip(misfit.hypotheses, misfit.log_evidence, strict=True)
        if isinstance(one, Hypothesis) and (moment := _tried_moment(one, version)) is not None
    ]
    if not sudden or not tried:
        return parameters
    moments, place = np.unique([moment for moment, _ in tried], return_inverse=True)
    probability = np.bincount(place, softmax([evidence for _, evidence in tried]))
    order = np.argsort(-probability)
    likely = order[: int(np.searchsorted(np.cumsum(probability[order]), CREDIBLE)) + 1]
    inside = rows["session"].astype(object) == (version.session or sudden[0].session)
    # Rows that were set aside may have been the first or the last ones.
    times = np.unique(np.concatenate([rows["session_seconds"][inside].to_numpy(float), moments[[0, -1]]]))
    low, high = _stretch_of(moments, likely, times)
    return tuple(
        replace(
            one, size=replace(one.size, low=min(low, one.size.estimate), high=max(high, one.size.estimate))
        )
        if one.name == sudden[0].name
        else one
        for one in parameters
    )


def _tried_moment(shape: Hypothesis, version: Any) -> float | None:
    """The moment of a sudden change in a shape of a version, the last of its parameters, else None."""
    if isinstance(version, OfJoints) and version.others and isinstance(shape.version, OfJoints):
        same = replace(shape.version, others=version.others) == version
        return shape.version.others[-1] if same and shape.version.others else None
    return None if shape.values is None or shape.version != version else float(shape.values[-1])


def _stretch_of(moments: Array, some: IntArray, times: Array) -> tuple[float, float]:
    """Times of the rows between which some of the tried moments lie, each with half the way to the next one.

    A change may have been anywhere between the row before and the row after it; before the first and after
    the last moment, anywhere in the session, as none was tried there.
    """
    first, last = int(some.min()), int(some.max())
    low, high = times[0], times[-1]
    if first:
        halfway = (moments[first - 1] + moments[first]) / 2
        low = max(times[times > moments[first - 1]][0], times[times <= halfway][-1])
    if last + 1 < len(moments):
        halfway = (moments[last] + moments[last + 1]) / 2
        high = min(times[times < moments[last + 1]][-1], times[times >= halfway][0])
    return float(low), float(high)


def _with_law(finding: Finding, selection: Selection, selected: SelectedCause, covariance: Array) -> Finding:
    """A finding of unknown structure with the term or smooth function that extends the law."""
    version, place = selected.version, selection.place_of(selected.version)
    formula = getattr(version, "formula", "")
    is_of_columns = formula and not isinstance(version, CarryOverTerm)
    carrier = " and ".join(version.carriers) if is_of_columns else finding.carrier
    carrier = str(version) if isinstance(version, PeriodicTerm | PeriodicTableTerm) else carrier
    values = selection.fit.values[place]
    errors = covariance[place, place]
    parameters = _size_parameters(version, UNKNOWN, values, errors) if formula else ()
    joints = _joints_of(version, selection)
    travel = find_travel_profiles(version, values, errors, joints, selection.problem.rows)
    # A wave may be of fewer joints than it was found in.
    of_wave = isinstance(version, PeriodicTerm) and version.on
    return replace(
        finding,
        version=version,
        joints=joints if of_wave else finding.joints,
        term=formula,
        carrier=carrier,
        parameters=parameters,
        travel=travel,
    )


def _size_outliers(selection: Selection, problem: DiagnosisProblem, selected: SelectedCause) -> Finding:
    rows, n = selection.outliers, len(problem)
    every_departure = predict_departures(selection, problem, rows)
    # Without them a session with few rows may have no law that says by how much they are off.
    known = np.isfinite(every_departure)
    departure = every_departure[known]
    sizes = np.abs(departure)
    covariance = _departure_covariance(selection, problem, rows[known])
    square = float(departure @ departure)
    rms = float(np.sqrt(max(square - np.trace(covariance), 0.0) / n))
    error = Z_95 * float(np.sqrt(departure @ covariance @ departure / max(square * n, MIN_SQUARE)))
    share = Interval(
        len(rows) / n,
        float(betaincinv(len(rows), n - len(rows) + 1, 0.025)),
        float(betaincinv(len(rows) + 1, n - len(rows), 0.975)),
    )
    # Of what a departure may be: they differ among each other, and each is known within its error.
    errors = np.sqrt(np.diag(covariance))
    within = np.maximum(sizes[:, None] + errors[:, None] * NORMAL_SCORES, 0.0)
    typical, effect = Interval(np.nan, np.nan, np.nan), Interval(np.nan, np.nan, np.nan)
    if known.any():
        low, high = map(float, np.quantile(within, (QUANTILES_95[0], QUANTILES_95[-1])))
        typical = Interval(float(np.median(sizes)), low, high)
        effect = Interval(rms, max(rms - error, 0.0), rms + error)
    unit = getattr(problem.parts[0].law, "response_unit", "%")  # a table's response has one of its own
    return Finding(
        selected.cause,
        None,
        (),
        selected.p_value,
        joints_of_laws(part.law for part in problem.parts if np.isin(part.rows, rows).any()),
        effect,
        (SizedParameter("share", "%", share), SizedParameter("size", unit, typical)),
        traverses=problem.rows.iloc[rows].assign(departure=every_departure),
    )


def _departure_covariance(selection: Selection, problem: DiagnosisProblem, outliers: IntArray) -> Array:
    """Of the departures of outlying rows from a fit without them: their noise, and the error of the fit.

    Rows of one block share the error of its own parameters, which few rows may have determined.
    """
    smaller, n_shared = selection.problem, problem.n_shared + len(selection.fit.values)
    relative = np.broadcast_to(problem.relative_sd, len(problem))[outliers]
    typical = smaller.repeatability[problem.noise_group[outliers]] * relative
    typical = typical**2 * np.mean(smaller.noise_ratio**2)
    covariance = np.diag(typical + problem.rounding[outliers])
    for part, fitted in zip(problem.parts, selection.fit.parts, strict=True):
        _, slopes = fitted.law.model(smaller.rows.iloc[fitted.rows])(fitted.values)
        slopes = slopes[:, : slopes.shape[1] - n_shared] / smaller.scale[fitted.rows, None]
        for block in np.unique(part.block[np.isin(part.rows, outliers)]):
            known = fitted.block == block
            rows = part.rows[(part.block == block) & np.isin(part.rows, outliers)]
            if not known.any():
                continue
            values = np.tile(fitted.values[known][0], (len(rows), 1))
            _, beyond = fitted.law.model(problem.rows.iloc[rows])(values)
            predictor = beyond[:, : slopes.shape[1]] @ np.linalg.pinv(slopes[known])
            place = np.searchsorted(outliers, rows)
            covariance[np.ix_(place, place)] += predictor @ predictor.T
    return covariance
