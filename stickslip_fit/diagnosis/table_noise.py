"""The noise of a table whose rows are samples of a signal: its autocorrelation, and what is not noise.

What the law may lack must not count as noise: the effects that causes and smooth functions may have, and a
strict period.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes import table_library
from stickslip_fit.causes.periodic import PeriodicTime
from stickslip_fit.diagnosis.autocorrelation import Autocorrelation
from stickslip_fit.diagnosis.hypotheses import Hypothesis, compute_finite_effects
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.mean_structure import find_mean_effects, find_session_courses
from stickslip_fit.diagnosis.periodicity import find_period
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.table_alternatives import MIN_CYCLES, TableAlternatives, leading_directions

MAX_MEAN_DIRECTIONS, ROWS_PER_MEAN_DIRECTION = 30, 12  # of candidates, while the noise is estimated


def with_samples(
    problem: DiagnosisProblem, alternatives: TableAlternatives, sample: IntArray, time_unit: str | None = None
) -> DiagnosisProblem:
    """The problem with rows that are samples of a signal, numbered as by `number_samples`.

    With a unit of the time a strict period is one more candidate.
    """
    linearized = problem.linearize()
    effects: dict[str, list[Array]] = {}
    shapes: list[Array] = []
    for one in compute_finite_effects(linearized, problem.causes):
        if not one.version.session:
            changes = linearized.project(np.nan_to_num(one.changes))
            effects.setdefault(one.cause, []).append(changes)
            shapes += [changes] if one.version.combine_trials else np.split(changes, changes.shape[1], axis=1)
    most = min(MAX_MEAN_DIRECTIONS, max(linearized.df, 0) // ROWS_PER_MEAN_DIRECTION)
    columns = [np.concatenate(own, axis=1) for own in effects.values()]
    directions = leading_directions(columns, most) if columns else np.zeros((len(problem), 0))
    # Waves are looked for apart, at finer periods, and with harmonics.
    shapes += [one.directions for one in alternatives.shapes(linearized) if isinstance(one, Hypothesis)]
    wave, mean = None, np.zeros((len(problem), 0))
    for step in ("wave", "effects", "courses", "wave"):
        if step == "effects":
            mean = np.concatenate([mean, find_mean_effects(linearized, shapes, mean, sample)], axis=1)
        elif step == "courses":
            courses = find_session_courses(linearized, mean, sample)
            mean = np.concatenate([mean, courses], axis=1)
            if courses.shape[1]:
                problem = replace(problem, alternatives=replace(alternatives, courses=True))
        elif wave is None and time_unit is not None:
            wave = _find_wave(problem, linearized, mean, sample, time_unit)
            if wave is not None:
                functions = linearized.whiten(wave.functions(problem.rows))
                mean = np.concatenate([mean, linearized.project(functions)], axis=1)
    mean = np.concatenate([mean, find_mean_effects(linearized, [directions], mean, sample)], axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=0), np.finfo(float).tiny)
    scaled = mean * np.sqrt(len(problem)) * float(problem.repeatability[0])
    causes = problem.causes if wave is None else (*problem.causes, wave)
    return replace(problem, autocorrelation=Autocorrelation(sample, scaled), causes=causes)


def _find_wave(
    problem: DiagnosisProblem, linearized: LinearizedFit, effects: Array, sample: IntArray, time_unit: str
) -> PeriodicTime | None:
    """The strict period of a signal of one session as a candidate cause; None where it has none."""
    if problem.rows["session"].nunique() > 1:
        return None
    seconds = problem.rows["session_seconds"].to_numpy(float)
    longest = float(seconds.max()) / MIN_CYCLES
    period, harmonics = find_period(linearized, effects, sample, seconds, longest)
    if not harmonics:
        return None
    size = table_library.TRIAL_SHARE * float(np.std(problem.responses))
    unit = str(problem.parts[0].law.response_unit)
    return PeriodicTime(period=period, harmonics=harmonics, unit=unit, size=size, time_unit=time_unit)
