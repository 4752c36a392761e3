"""The noise of a table whose rows are samples of a signal: its autocorrelation, and what is not noise.

What the law may lack must not count as noise: the effects that causes and smooth functions may have, each
session's own course in time, and a strict period.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes import table_library
from stickslip_fit.causes.generic import GenericCause
from stickslip_fit.causes.periodic import PeriodicTime
from stickslip_fit.diagnosis.autocorrelation import MIN_LENGTH, Autocorrelation, price
from stickslip_fit.diagnosis.hypotheses import (
    FiniteEffects,
    Hypothesis,
    compute_finite_effects,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit, rms
from stickslip_fit.diagnosis.mean_structure import (
    MAX_BESIDE_OWN,
    MAX_COURSE_DIRECTIONS,
    MIN_ADVANTAGE,
    Mean,
    find_mean_effects,
    find_session_courses,
)
from stickslip_fit.diagnosis.periodicity import find_period
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.table_alternatives import MIN_CYCLES, TableAlternatives

MAX_MEAN_DIRECTIONS, ROWS_PER_MEAN_DIRECTION = 30, 12  # of candidates, while the noise is estimated
DIRECTION_TOL = 1e-3  # of the largest singular value
MAX_MOMENTS = 100  # of sudden changes, at the same time


def with_samples(
    problem: DiagnosisProblem, alternatives: TableAlternatives, sample: IntArray, time_unit: str | None = None
) -> DiagnosisProblem:
    """The problem with rows that are samples of a signal, numbered as by `number_samples`.

    With a unit of the time a strict period is one more candidate.
    """
    linearized = problem.linearize()
    finite, n = compute_finite_effects(linearized, problem.causes), len(problem)
    whole = {one: linearized.project(np.nan_to_num(one.changes)) for one in finite if not one.version.session}
    shapes: list[Array] = []
    for one, changes in whole.items():
        shapes += [changes] if one.version.combine_trials else np.split(changes, changes.shape[1], axis=1)
    # Waves are looked for apart, at finer periods, and with harmonics.
    shapes += [one.directions for one in alternatives.shapes(linearized) if isinstance(one, Hypothesis)]
    plain = Mean.of(linearized, np.zeros((n, 0)), sample)
    wave, begun = _find_wave(problem, linearized, plain, time_unit)
    mean = begun
    for tried in (shapes, _spread_changes(linearized, finite)):
        mean = find_mean_effects(linearized, tried, mean)
    # Who offers causes of his own expects them; generic ones are at work in few tables.
    generic = {cause.name for cause in problem.causes if isinstance(cause, GenericCause)}
    offered = {one: changes for one, changes in whole.items() if one.cause not in generic}
    others = {one: changes for one, changes in whole.items() if one.cause in generic}
    most = max(min(MAX_MEAN_DIRECTIONS, linearized.df // ROWS_PER_MEAN_DIRECTION), 0)
    own, possible = _leading_directions(offered, n, most), _leading_directions(others, n, most)
    n_courses = MAX_COURSE_DIRECTIONS if alternatives.roles.time else 0
    if own.shape[1]:
        alone = plain.extend(linearized, own)
        mean = alone if mean is plain else mean.extend(linearized, own)
        # Courses of many sessions would take the place of what causes explain in all of them.
        if alone.value - price(own) > plain.value + MIN_ADVANTAGE:
            n_courses = min(n_courses, MAX_BESIDE_OWN)
    beside, degree = find_session_courses(linearized, mean, n_courses)
    problem = replace(problem, alternatives=replace(alternatives, course_degree=degree))
    if wave is None and beside is not begun:
        wave, beside = _find_wave(problem, linearized, beside, time_unit)
    size = np.sqrt(n) * float(problem.repeatability[0])
    certain = size * beside.columns / np.maximum(np.linalg.norm(beside.columns, axis=0), np.finfo(float).tiny)
    noise = Autocorrelation(sample, certain, possible_effects=size * possible)
    causes = problem.causes if wave is None else (*problem.causes, wave)
    return replace(problem, autocorrelation=noise, causes=causes)


def weigh_rows(problem: DiagnosisProblem, sd: Array) -> DiagnosisProblem:
    """The problem with other standard deviations of its rows, shape (n,), relative to each other; refitted.

    A fit with weights begins at that without: started elsewhere it may end far from either.
    """
    weighted = replace(problem, relative_sd=sd / rms(sd), autocorrelation=None)
    weighted = replace(weighted, parts=weighted.fit_extended().parts)
    linearized = weighted.linearize()
    left = float(np.sqrt(np.sum(linearized.residual**2) / max(linearized.df, 1)))
    sds = np.maximum(left * weighted.repeatability, weighted.least_sd)
    weighted = replace(weighted, repeatability=sds)
    if problem.autocorrelation is None:
        return weighted
    assert isinstance(weighted.alternatives, TableAlternatives)
    return with_samples(weighted, weighted.alternatives, problem.autocorrelation.sample)


def _spread_changes(linearized: LinearizedFit, effects: Sequence[FiniteEffects]) -> list[Array]:
    """Effects of causes of one session, such as sudden changes, at some of their moments; projected."""
    sessions, columns = split_sessions(linearized), []
    trials = [(one, k) for one in effects if one.version.session for k in range(len(one.trials))]
    for one, k in trials[:: len(trials) // MAX_MOMENTS + 1]:
        change = np.zeros((len(linearized), 1))
        change[sessions[one.version.session].rows, 0] = np.nan_to_num(one.changes[:, k])
        columns.append(linearized.project(change))
    return columns


def _leading_directions(effects: Mapping[FiniteEffects, Array], n: int, most: int) -> Array:
    """Directions that carry most of what causes do, each of which counts alike, shape (n, m)."""
    by_cause: dict[str, list[Array]] = {}
    for one, changes in effects.items():
        by_cause.setdefault(one.cause, []).append(changes)
    columns = [np.zeros((n, 0)), *(np.concatenate(own, axis=1) for own in by_cause.values())]
    lengths = [float(np.linalg.norm(one)) or 1.0 for one in columns]
    alike = np.concatenate([one / length for one, length in zip(columns, lengths, strict=True)], axis=1)
    left, singular, _ = svd(alike)
    known = singular > DIRECTION_TOL * max(float(singular.max(initial=0.0)), MIN_LENGTH)
    return np.asarray(left[:, known][:, :most])


def _find_wave(
    problem: DiagnosisProblem, linearized: LinearizedFit, mean: Mean, time_unit: str | None
) -> tuple[PeriodicTime | None, Mean]:
    """The strict period of a signal of one session as a candidate cause, if it has one; the new mean."""
    if problem.rows["session"].nunique() > 1 or time_unit is None:
        return None, mean
    seconds = problem.rows["session_seconds"].to_numpy(float)
    period, harmonics = find_period(linearized, mean, seconds, float(seconds.max()) / MIN_CYCLES)
    if not harmonics:
        return None, mean
    size = table_library.TRIAL_SHARE * float(np.std(problem.responses))
    unit = str(problem.parts[0].law.response_unit)
    wave = PeriodicTime(period=period, harmonics=harmonics, unit=unit, size=size, time_unit=time_unit)
    functions = linearized.project(linearized.whiten(wave.functions(problem.rows)))
    return wave, mean.extend(linearized, functions)
