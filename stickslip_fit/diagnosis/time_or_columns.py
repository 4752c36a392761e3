"""What a sampled table shows in its columns, where that is likelier than what it shows in its time.

Where a column is swept up and down, each function of it is one of time, too, and a wave where it is swept
several times. Smooth functions of time and waves are flexible enough to stand for several effects at once,
each of which alone explains less; the search, which adds one effect after the other, then takes the time. So
it is made once more without them, and the penalised likelihood decides (G. Schwarz, Ann. Stat. 6:461, 1978):
that of the law with what was selected, in the noise that is likeliest beside that law alone, whose
coefficients count, too. Where every setting of the columns comes back with the period of a wave, no data of
that design tell the two apart. What is set is the likelier reason, and the answer says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import format_duration, join_words
from stickslip_fit.causes.periodic import PeriodicTime
from stickslip_fit.causes.table_terms import SmoothTableTerm, name_settings
from stickslip_fit.diagnosis.autocorrelation import Autocorrelation
from stickslip_fit.diagnosis.extension import Extension
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.refits import penalised_likelihood
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.diagnosis.table_alternatives import TableAlternatives, numeric_columns
from stickslip_fit.diagnosis.table_noise import with_samples

Search = Callable[[DiagnosisProblem], Diagnosis]

MIN_REPEATS = 2.0  # of a setting, on average
# Of a wave's square that differs between rows with the same settings: a third of a radian in their phases.
MAX_WITHIN_SETTINGS = 0.05


def prefer_columns(problem: DiagnosisProblem, found: Diagnosis, search: Search) -> Diagnosis:
    """The diagnosis of a table, or one without smooth functions of time and waves if that is likelier.

    Both have to be alarms, so that there are no more of these than without a choice.
    """
    alternatives, noise = problem.alternatives, problem.autocorrelation
    if noise is None or not isinstance(alternatives, TableAlternatives):
        return found
    if not any(_is_flexible_in_time(one.version) for one in found.selection.law_causes):
        return found
    if not _has_columns(problem.causes, alternatives):
        return found
    waves = [one.version for one in found.selection.law_causes if isinstance(one.version, PeriodicTime)]
    settings = _settings(problem, alternatives)
    aliased = [wave for wave in waves if settings and _repeats_with(problem.rows, wave, settings)]
    roles = replace(alternatives.roles, time=None)
    alternatives = replace(alternatives, roles=roles, sampled=False, course_degree=0)
    causes = tuple(one for one in problem.causes if not _is_flexible_in_time(one))
    without_time = replace(problem, alternatives=alternatives, causes=causes)
    if not aliased:  # else noise that swings with the settings would take up what they do
        independent = replace(without_time, autocorrelation=None)
        without_time = with_samples(independent, alternatives, noise.sample)
    other = search(without_time)
    if other.findings and (aliased or _is_likelier(other.selection, found.selection)):
        notes = (*other.notes, *(_describe_alias(wave, settings) for wave in aliased))
        return replace(other, notes=notes, p_value=max(found.p_value, other.p_value))
    return found


def _has_columns(causes: Sequence[Any], alternatives: TableAlternatives) -> bool:
    """Whether the response may depend on anything but time."""
    known = alternatives.columns or alternatives.halves or alternatives.roles.direction
    return bool(known) or any(set(one.columns) - {"session", "session_seconds"} for one in causes)


def _settings(problem: DiagnosisProblem, alternatives: TableAlternatives) -> list[str]:
    """Columns of what is set: those of the law, the direction, and columns of two texts."""
    own = numeric_columns(problem.rows, problem.parts[0].law, alternatives.roles, ())
    direction = [alternatives.roles.direction] if alternatives.roles.direction else []
    return list(dict.fromkeys([*own, *direction, *(name for name, _ in alternatives.halves)]))


def _repeats_with(rows: pd.DataFrame, wave: PeriodicTime, columns: Sequence[str]) -> bool:
    """Whether rows with the same settings of the columns have the same phase of a wave."""
    setting = pd.factorize(name_settings(rows, columns))[0]
    rows_of_each = np.bincount(setting)
    if len(setting) < MIN_REPEATS * len(rows_of_each):
        return False
    values = wave.functions(rows)
    means = np.stack([np.bincount(setting, own) for own in values.T], axis=1) / rows_of_each[:, None]
    within, total = values - means[setting], values - values.mean(axis=0)
    return bool(np.sum(within**2) < MAX_WITHIN_SETTINGS * np.sum(total**2))


def _describe_alias(wave: PeriodicTime, columns: Sequence[str]) -> str:
    period = format_duration(wave.period, wave.time_unit, 4)
    return (
        f"Each setting of {join_words(columns)} comes back every {period}: what the settings do is taken for "
        "the reason, and a wave in time with that period would look the same. Settings in another order "
        "would separate them."
    )


def _is_flexible_in_time(cause: Any) -> bool:
    """Whether the data choose the shape of a course in time."""
    return isinstance(cause, PeriodicTime | SmoothTableTerm) and "session_seconds" in cause.columns


def _is_likelier(one: Selection, other: Selection) -> bool:
    """Whether a selection is likelier than another, of the same rows."""
    same = np.array_equal(one.problem.responses, other.problem.responses)
    return same and _likelihood(one) > _likelihood(other)


def _likelihood(selection: Selection) -> float:
    """Penalised log likelihood of a selection's law in the noise that is likeliest beside that alone."""
    problem, versions = selection.problem, [one.version for one in selection.law_causes]
    assert problem.autocorrelation is not None
    alone = Autocorrelation(problem.autocorrelation.sample, np.zeros((len(problem), 0)))
    problem = replace(problem, autocorrelation=alone).with_autocorrelation(selection.fit)
    fit = problem.fit_extended(versions, selection.fit.values)
    linearized = problem.linearize_extended(fit)
    size = np.sqrt(np.sum(linearized.residual**2) / max(linearized.df, 1))
    problem = replace(problem, repeatability=size * problem.repeatability)
    assert problem.autocorrelation is not None
    price = 0.5 * problem.autocorrelation.n_free * float(np.log(len(problem)))
    return penalised_likelihood(Extension(problem, fit)) - price
