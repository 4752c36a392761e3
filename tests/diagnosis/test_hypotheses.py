"""Hypotheses as subspaces."""

import numpy as np

from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.extension import compute_evidence, extend_problem, make_selected
from stickslip_fit.diagnosis.problem import problem_from_log
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden


def test_functions_of_each_session_explain_no_more_than_there_is():
    """Also beside a cause that the sessions share, and its other forms."""
    log = read_hidden(hide("thesis", ("inertia-quadratic",), 12.0, seed=1))
    problem, _ = problem_from_log(log, None, None)
    misfit = compute_evidence(problem.linearize(), problem)
    cause = make_selected(misfit, form_cause_set(misfit, "inertia-quadratic"))
    extended, _, linearized = extend_problem(problem, [cause])
    functions = [one for one in extended.alternatives(linearized) if one.cause == "unknown:time"]
    assert functions
    for one in functions:
        residual = linearized.project(one.directions)
        explained = np.array([np.sum(one.coefficients(column) ** 2) for column in residual.T])
        assert np.all(explained <= np.sum(residual**2, axis=0) * (1 + 1e-9))
