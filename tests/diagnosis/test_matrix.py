"""What a plan can tell before any data."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from stickslip_fit.causes import library
from stickslip_fit.diagnosis.extension import assess_residuals
from stickslip_fit.diagnosis.hypotheses import build_candidates, compute_finite_effects
from stickslip_fit.diagnosis.misfit import weigh_evidence
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.separability import assess_design, problem_from_plan
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

LAW = Path(__file__).parents[2] / "data" / "reference" / "law.toml"
MACHINE = load_machine()
N_BOOTSTRAP = 400

HEAD = """
order = "{order}"
replicates = {replicates}
[sessions]
{sessions}
[noise]
repeatability_pct = 0.3
"""
ONE = "dates = [2012-03-05]"
FIVE = "first_date = 2012-03-05\ncount = 5"
GUIDE_CALIBRATION = """
[[sweep]]
joint = 3
q2_deg = -90
[[sweep]]
joint = 3
q2_deg = 0
theta_deg = [-90, 0]
"""
ARM = """
[[sweep]]
joint = 2
q3_mm = [0, 6, 12]
theta_deg = [0, -45, -90]
[[sweep]]
joint = 2
q3_mm = 6
psi_deg = [-60, -30, 30, 60]
"""
HALF_LOADS = """
[[sweep]]
joint = 3
q2_deg = -90
psi_deg = [-30, 30]
"""
MANY_LOADS = """
[[sweep]]
joint = 3
q2_deg = -90
psi_deg = [-90, -75, -60, -45, -30, -15, 15, 30, 45, 60, 75, 90]
[[sweep]]
joint = 3
q2_deg = 0
theta_deg = [-75, -60, -45, -30, -15]
"""
BETWEEN = """
[[sweep]]
joint = 3
q2_deg = [-30, -60, -120, -150]
"""
TURNED = """
[[sweep]]
joint = 3
q1_deg = [0, 90]
q2_deg = -90
theta_deg = [0, -45, -90]
ranges_mm = [[0, 12], [0, 4], [4, 8], [8, 12]]
"""


@cache
def of_plan(sweeps: str, sessions: str = ONE, replicates: int = 2, order: str = "random"):
    """The separability matrix of a plan, and its problem."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "plan.toml")
        path.write_text(HEAD.format(order=order, replicates=replicates, sessions=sessions) + sweeps, "utf-8")
        plan = read_plan(path, MACHINE)
    problem, untestable = problem_from_plan(plan, read_law_values(LAW, MACHINE), MACHINE)
    return assess_design(problem, untestable, 0.05, N_BOOTSTRAP, np.random.default_rng(1)), problem


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("one", "other"), [("drift", "thermal-warm-up"), ("drift", "wear"), ("thermal-warm-up", "wear")]
)
def test_a_single_short_session_confuses_drift_warm_up_and_wear_and_several_long_ones_do_not(one, other):
    short, _ = of_plan(GUIDE_CALIBRATION, ONE, 3)
    long, _ = of_plan(GUIDE_CALIBRATION + ARM, FIVE, 3)
    assert short.strength_needed(one, other) > 15
    assert short.pair_confusion(one, other, 8.0) > 0.15
    assert long.strength_needed(one, other) < 8


@pytest.mark.slow
def test_side_load_and_a_bent_response_need_many_loads():
    few, _ = of_plan(GUIDE_CALIBRATION + HALF_LOADS)
    many, _ = of_plan(GUIDE_CALIBRATION + MANY_LOADS)
    assert few.strength_needed("side-load", "load-nonlinearity") > 20
    assert few.pair_confusion("side-load", "load-nonlinearity", 8.0) > 0.25
    assert many.strength_needed("side-load", "load-nonlinearity") < 14


@pytest.mark.slow
def test_only_recoil_tells_an_offset_of_psi_from_one_of_q2():
    arm, _ = of_plan(ARM)
    both, _ = of_plan(ARM + GUIDE_CALIBRATION + BETWEEN)
    assert arm.strength_needed("psi-offset", "q2-offset") == np.inf
    assert arm.pair_confusion("psi-offset", "q2-offset", 8.0) == pytest.approx(0.5, abs=0.01)
    assert not arm.are_separable("psi-offset", "q2-offset")
    assert both.are_separable("psi-offset", "q2-offset")


@pytest.mark.slow
def test_a_plan_says_what_it_cannot_see():
    at_q1_0, _ = of_plan(GUIDE_CALIBRATION + MANY_LOADS)
    turned, _ = of_plan(GUIDE_CALIBRATION + TURNED)
    assert "q1" in at_q1_0.untestable["q1-gravity"]
    assert {"worn-spot", "guide-gradient", "temperature", "bearing-runout"} <= set(at_q1_0.untestable)
    assert not {"q1-gravity", "worn-spot", "guide-gradient"} & set(turned.untestable)
    for found in (at_q1_0, turned):
        every = {*found.causes, *found.scatter_only, *found.untestable}
        assert every == {cause.name for cause in library()}


def test_confusion_is_how_often_noise_makes_one_shape_look_like_the_other():
    found, problem = of_plan(GUIDE_CALIBRATION, ONE, 6)
    study = problem.linearize()
    by_name = {cause.name: cause for cause in problem.causes}
    (one,) = build_candidates(study, compute_finite_effects(study, [by_name["drift"]])).hypotheses
    others = build_candidates(study, compute_finite_effects(study, [by_name["wear"]])).hypotheses
    rivals = np.concatenate([each.directions for each in others], axis=1)
    nearest = rivals[:, [np.argmax(np.abs(one.directions[:, 0] @ rivals))]]
    nearest *= np.sign(nearest.T @ one.directions)
    rng = np.random.default_rng(3)
    seen = study.project(8.0 * one.directions + rng.standard_normal((len(study), 20_000)))
    wrong = np.mean(seen.T @ nearest > seen.T @ one.directions)
    assert found.confusion("drift", "wear", 8.0) == pytest.approx(wrong, abs=0.012)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect", ["drift", "psi-offset", pytest.param("side-load", marks=pytest.mark.nightly)]
)
def test_sizes_and_strengths_are_those_of_logs_that_hide_the_effect(effect):
    hidden = hide("thesis", (effect,), strength=8.0, seed=2)
    causes = [cause for cause in library() if cause.name == effect]
    problem, missing = problem_from_log(read_hidden(hidden), causes)
    found = assess_design(problem, missing, 0.05, N_BOOTSTRAP, np.random.default_rng(1))
    (parameter,) = hidden.truth["effects"][0]["parameters"]
    size = abs(parameter["value"]) * {"%/h": 1 / 360_000, "deg": np.pi / 180, "%": 0.01}[parameter["unit"]]
    assert size * found.detectability(effect).per_size == pytest.approx(8.0, rel=0.15)


@pytest.mark.slow
def test_nine_in_ten_logs_raise_the_alarm_at_the_smallest_size():
    found, problem = of_plan(GUIDE_CALIBRATION + MANY_LOADS)
    study = problem.linearize()
    shape = build_candidates(
        study, compute_finite_effects(study, [cause for cause in problem.causes if cause.name == "side-load"])
    ).hypotheses[0]
    rng = np.random.default_rng(5)
    seen = shape.directions[:, 0] * found.detectability("side-load").detection_strength
    first = assess_residuals(study, problem, N_BOOTSTRAP, rng)
    alarms = 0
    for _ in range(100):
        noise = study.project(rng.standard_normal(len(study)))
        misfit = weigh_evidence(replace(study, residual=seen + noise), first.hypotheses)
        alarms += np.logaddexp.reduce(list(misfit.log_evidence_by_cause.values())) > first.critical_value(
            0.025
        )
    assert 78 <= alarms <= 100


def test_a_plan_with_too_few_traverses_says_what_would_do():
    with pytest.raises(InputError, match="plan has too few traverses to test: 6"):
        of_plan(GUIDE_CALIBRATION, ONE, 1)
