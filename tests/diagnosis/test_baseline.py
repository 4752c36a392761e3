"""The noise of the baseline, estimated anew without structure, and when its evidence is known already."""

import numpy as np
import pytest

from stickslip_fit.causes import library
from stickslip_fit.diagnosis.baseline import reestimate_noise
from stickslip_fit.diagnosis.extension import compute_evidence
from stickslip_fit.diagnosis.problem import problem_from_log
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

CAUSES = [one for one in library() if one.name in ("drift", "thermal-warm-up", "session-jump")]


def baseline_of(**effect):
    problem, _ = problem_from_log(read_hidden(hide("thesis", seed=1, **effect)), CAUSES)
    return problem, reestimate_noise(problem)


@pytest.mark.slow
def test_where_nothing_is_wrong_the_evidence_is_that_in_the_noise_it_was_estimated_with():
    problem, baseline = baseline_of()
    assert baseline.misfit is not None
    assert np.array_equal(baseline.problem.scale, problem.scale)
    assert np.array_equal(baseline.problem.noise_ratio, problem.noise_ratio)
    anew = compute_evidence(baseline.problem.linearize(), baseline.problem, effects=baseline.effects)
    assert baseline.misfit.log_evidence_by_cause == pytest.approx(anew.log_evidence_by_cause, rel=1e-9)


@pytest.mark.slow
def test_beside_an_effect_the_noise_is_smaller_and_its_evidence_another():
    problem, baseline = baseline_of(effects=("thermal-warm-up",), strength=25.0)
    assert baseline.misfit is None
    assert np.median(baseline.problem.scale) < 0.9 * np.median(problem.scale)
    found = baseline.weigh().log_evidence_by_cause
    before = compute_evidence(problem.linearize(), problem, effects=baseline.effects).log_evidence_by_cause
    assert max(found, key=found.get) == "thermal-warm-up"
    assert found["thermal-warm-up"] != pytest.approx(before["thermal-warm-up"], rel=1e-3)
