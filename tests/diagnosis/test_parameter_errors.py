"""Standard errors of a cause's parameters: those of the fit that was made, under the noise that there is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis.effect_interval import expected_covariance, fit_beside, linearize_unweighted
from stickslip_fit.diagnosis.effect_size import size_findings
from stickslip_fit.diagnosis.finding import shown_size
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.selection import empty_selection
from tests.hidden.generate import UnreachableError, hide
from tests.hidden.reading import read_hidden
from tests.hidden.study import DESIGNS, NOISES

SIZES = {"thermal-warm-up": "A", "drift": "k", "end-stop-latency": "L"}


def design_matrix(selection):
    """Slopes of every response with each block's own parameters, and with the causes'; shape (n, p + q)."""
    problem, q, blocks = selection.problem, len(selection.fit.values), []
    shared = np.zeros((len(problem), q))
    for part in selection.fit.parts:
        slopes = part.law.jacobian(problem.rows.iloc[part.rows], part.values)
        shared[part.rows] = slopes[:, -q:]
        for block in np.unique(part.block):
            columns = np.zeros((len(problem), slopes.shape[1] - q))
            columns[part.rows[part.block == block]] = slopes[part.block == block, :-q]
            blocks.append(columns / np.abs(columns).max(axis=0))
    return np.concatenate([*blocks, shared], axis=1)


def test_errors_are_those_of_weighted_least_squares_under_other_noise(named, monkeypatch):
    """Rows weighted as in the fit, noise twice as large in a third of them."""
    selection = named.selection
    problem, q = selection.problem, len(selection.fit.values)
    times = np.where(np.random.default_rng(1).random(len(problem)) < 1 / 3, 2.0, 1.0)
    noisy = replace(problem, noise_ratio=times * problem.noise_ratio)
    monkeypatch.setitem(vars(selection), "expected", noisy)
    estimator = np.linalg.pinv(design_matrix(selection) / problem.scale[:, None])[-q:] / problem.scale
    by_hand = estimator * noisy.scale @ (estimator * noisy.scale).T
    assert expected_covariance(selection) == pytest.approx(by_hand, rel=1e-6)
    (finding,) = size_findings(selection, problem, named.alpha)
    half = [(one.size.high - one.size.low) / 2 for one in finding.parameters]
    assert half == pytest.approx(1.959964 * np.sqrt(np.diag(by_hand)), rel=1e-4)


@pytest.mark.nightly
def test_beside_memory_errors_are_those_under_correlated_noise(monkeypatch):
    """A cause that changes little from one traverse to the next is known less well.

    Memory of both is likelier than the cause alone, but not than the cause and memory of the rest.
    """
    hidden = hide("session", ("recoil-axis", "unknown:memory"), 20.0, seed=1)
    found = diagnose(read_hidden(hidden), gain=False)
    selection = found.selection
    assert [one.cause for one in selection.selected] == ["recoil-axis", "unknown"]
    for one, true in zip(found.findings, hidden.truth["effects"], strict=True):
        assert one.effect.low < true["effect_rms_pct"] / 100 < one.effect.high
    problem, q = selection.problem, len(selection.fit.values)
    monkeypatch.setitem(vars(selection), "expected", problem)
    coefficient = selection.selected[1].misfit.best_hypothesis("unknown").coefficient
    distance = np.abs(np.subtract.outer(np.arange(len(problem)), np.arange(len(problem))))  # of one session
    estimator = np.linalg.pinv(design_matrix(selection) / problem.scale[:, None])[-q:]
    # The law has what carries over, so that the noise of the problem is that of the innovations.
    by_hand = estimator @ coefficient**distance @ estimator.T / (1 - coefficient**2)
    assert found.findings[1].carrier == "memory"
    assert expected_covariance(selection) == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.nightly
def test_intervals_of_parameters_hold_their_truth():
    """Of single causes at strength 12 in each noise, where one of those below is named."""
    inside = []
    for seed in range(300):
        cause = list(SIZES)[seed % 3]
        case = DESIGNS[seed % 2], (cause,), 12.0, NOISES[seed // 6 % 3]
        try:
            hidden = hide(*case, seed=seed, forms={cause: "table"})
        except UnreachableError:
            continue
        found = diagnose(read_hidden(hidden), seed=seed, gain=False).findings
        if not found or found[0].cause != cause:
            continue
        truth = {one["name"]: one["value"] for one in hidden.truth["effects"][0]["parameters"]}
        (parameter,) = (one for one in found[0].parameters if one.name == SIZES[cause])
        size = shown_size(parameter)
        inside.append(size.low <= truth[SIZES[cause]] <= size.high)
    assert len(inside) > 200
    assert binom.ppf(0.001, len(inside), 0.93) <= sum(inside) <= binom.ppf(0.999, len(inside), 0.97)


def test_laws_that_stall_without_their_causes_are_linearized_about_their_own_values():
    """A cause may hold up a joint that would stand still without it at the values that both have together."""
    problem, _ = problem_from_log(read_hidden(hide("session", seed=3)), [])
    joint3 = [part.law.joint == 3 for part in problem.parts]
    stalled = [
        replace(part, values=part.values * ([1.0, 1.0, 9.0] if own else 1.0))
        for part, own in zip(problem.parts, joint3, strict=True)
    ]
    whole, nothing = empty_selection(problem), SimpleNamespace(version=None)
    found, same = (
        linearize_unweighted(
            problem, fit_beside(replace(whole, fit=replace(whole.fit, parts=parts)), nothing)
        )
        for parts in (stalled, problem.parts)
    )
    assert any(joint3)
    np.testing.assert_allclose(found.residual, same.residual, atol=1e-12)


@pytest.mark.slow
def test_no_interval_reaches_beyond_a_parameter_s_bounds():
    """The steps after which wear slows down are known to within a factor of ten, and are never negative."""
    (finding,) = diagnose(read_hidden(hide("session", ("wear",), 9.0, seed=0), (2,)), gain=False).findings
    bounds = {one.name: (one.lower, one.upper) for one in finding.version.parameters}
    for one in finding.parameters:
        low, high = bounds[one.name]
        assert low <= one.size.low < one.size.estimate < one.size.high <= high
