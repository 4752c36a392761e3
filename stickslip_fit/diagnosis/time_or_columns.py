"""What a sampled table shows in its columns, where that is likelier than what it shows in its time.

Where a column is swept up and down, each function of it is one of time, too, and a wave where it is swept
several times. Smooth functions of time and waves are flexible enough to stand for several effects at once,
each of which alone explains less; the search, which adds one effect after the other, then takes the time. So
it is made once more without them, and the penalised likelihood decides (G. Schwarz, Ann. Stat. 6:461, 1978):
that of the law with what was selected, in the noise that is likeliest beside that law alone, whose
coefficients count, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from stickslip_fit.causes.periodic import PeriodicTime
from stickslip_fit.causes.table_terms import SmoothTableTerm
from stickslip_fit.diagnosis.autocorrelation import Autocorrelation
from stickslip_fit.diagnosis.extension import Extension
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.refits import penalised_likelihood
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.diagnosis.table_alternatives import TableAlternatives
from stickslip_fit.diagnosis.table_noise import with_samples

Search = Callable[[DiagnosisProblem], Diagnosis]


def prefer_columns(problem: DiagnosisProblem, found: Diagnosis, search: Search) -> Diagnosis:
    """The diagnosis of a table, or one without smooth functions of time and waves if that is likelier.

    Both have to be alarms, so that there are no more of these than without a choice.
    """
    alternatives, noise = problem.alternatives, problem.autocorrelation
    if noise is None or not isinstance(alternatives, TableAlternatives):
        return found
    if not any(_is_flexible_in_time(one.version) for one in found.selection.law_causes):
        return found
    roles = replace(alternatives.roles, time=None)
    alternatives = replace(alternatives, roles=roles, sampled=False, course_degree=0)
    causes = tuple(one for one in problem.causes if not _is_flexible_in_time(one))
    independent = replace(problem, alternatives=alternatives, causes=causes, autocorrelation=None)
    other = search(with_samples(independent, alternatives, noise.sample))
    if other.findings and _is_likelier(other.selection, found.selection):
        return replace(other, p_value=max(found.p_value, other.p_value))
    return found


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
