"""Fits along the directions of coefficients that the rows see, against fits of all coefficients."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from stickslip_fit.diagnosis import penalized_fit
from stickslip_fit.diagnosis.averaged_forms import average_forms
from stickslip_fit.diagnosis.linearized import fit_extended, seen_directions
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from tests.diagnosis.test_averaged_forms import SESSIONS, draw, make_problem, term_of


def fit(problem, fitter, versions, start):
    return fitter(problem.table, problem.parts, problem.responses, problem.scale, versions, start)


@pytest.mark.parametrize(("length", "size"), [(0.1, 0.05), (0.03, 0.6)])
def test_it_is_the_fit_of_all_coefficients(tmp_path, length, size):
    """Of functions by which steps differ by half, too, where slopes at the start are not those at the end."""
    rng = np.random.default_rng(8)
    functions = {key: draw(rng, length, size) for key in product(SESSIONS, "+-")}
    problem = make_problem(tmp_path, rng, functions, traverses=12)
    linearized = problem.linearize()
    term = average_forms(term_of(linearized), linearized, linearized.residual)
    start = np.zeros(len(term.parameters))
    assert len(start) > len(problem)
    ours, whole = (fit(problem, one, [term], start) for one in (penalized_fit.fit_penalized, fit_extended))
    assert ours.converged
    assert whole.converged
    error = np.sqrt(whole.covariance.diagonal())
    assert np.max(np.abs(ours.values - whole.values) / error) < 0.004
    assert np.max(np.abs(ours.residual - whole.residual) / problem.scale) < 0.01
    np.testing.assert_allclose(np.sqrt(ours.covariance.diagonal()), error, rtol=1e-3)
    scaled = (ours.covariance - whole.covariance) / np.outer(error, error)
    assert np.abs(scaled).max() < 1e-3
    for own, other in zip(ours.parts, whole.parts, strict=True):
        assert own.law.parameters == other.law.parameters
        level = np.log(own.values[:, 0] / other.values[:, 0])
        assert np.max(np.abs(level) / problem.scale[own.rows]) < 0.01
    np.testing.assert_array_equal(ours.prior_sd, whole.prior_sd)


def test_few_coefficients_are_fitted_as_they_are(tmp_path):
    rng = np.random.default_rng(8)
    problem = make_problem(tmp_path, rng, {key: draw(rng, 0.1, 0.1) for key in product(SESSIONS, "+-")})
    term = term_of(problem.linearize()).for_all
    assert len(term.parameters) < penalized_fit.MIN_COEFFICIENTS
    ours, whole = (
        fit(problem, one, [term], np.zeros(len(term.parameters)))
        for one in (penalized_fit.fit_penalized, fit_extended)
    )
    np.testing.assert_array_equal(ours.values, whole.values)


@pytest.mark.parametrize("shape", [(5, 9), (9, 5)])
def test_directions_are_those_of_the_singular_values(shape):
    rng = np.random.default_rng(1)
    effects = rng.standard_normal(shape) * 0.1
    axes = seen_directions(effects, 0.2)
    _, singular, right = np.linalg.svd(effects)
    kept = right[: np.count_nonzero(singular > 0.2)]
    assert 0 < len(kept) < 5
    np.testing.assert_allclose(axes @ axes.T, kept.T @ kept, atol=1e-12)


@pytest.mark.parametrize(("start", "fits"), [(0.0, 1), (0.01, 3)])
def test_a_fit_from_zero_effect_is_not_repeated_from_there(tmp_path, monkeypatch, start, fits):
    """What does not converge is tried again nearer to zero effect."""
    rng = np.random.default_rng(8)
    problem = make_problem(tmp_path, rng, {key: draw(rng, 0.1, 0.1) for key in product(SESSIONS, "+-")}, 8)
    term, starts, fit_once = term_of(problem.linearize()).for_all, [], DiagnosisProblem._fit

    def fail(own, versions, begin):
        starts.append(begin)
        return replace(fit_once(own, versions, begin), converged=False)

    monkeypatch.setattr(DiagnosisProblem, "_fit", fail)
    problem.fit_extended([term], np.full(len(term.parameters), start))
    assert len(np.unique(starts, axis=0)) == len(starts) == fits
