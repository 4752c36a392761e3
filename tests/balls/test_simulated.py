"""Drops whose truth is known: what is hidden is named, what cannot be told apart is said to be so."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.stats import binom

from stickslip_fit.diagnosis.cross_validation import compute_held_out_errors
from stickslip_fit.diagnosis.effect_size import size_findings
from stickslip_fit.diagnosis.gain import estimate_gain, select_in_fold
from stickslip_fit.diagnosis.pipeline import diagnose_problem
from tests.balls.causes import LinearDrag, QuadraticDrag
from tests.balls.fall import Fall, G
from tests.balls.problem import later_half_of_the_last_drop, make_problem
from tests.balls.simulated import FRAME, NUMBER, RELEASED, drops, fall

ALPHA = 0.01
DEGENERATE = {"another-g", "camera-scale", "buoyancy"}


def free(_):
    return -G


def quadratic(velocity):
    return -G - 0.02 * velocity * abs(velocity)


def linear(velocity):
    return -G - 0.3 * velocity


def filmed(acceleration, seed):
    falls = [fall(*released, acceleration) for released in RELEASED]
    return drops(falls, np.random.default_rng(seed))


def selection(rows, alpha=ALPHA):
    return select_in_fold(make_problem(rows)[0], np.random.default_rng(0), alpha)


@pytest.mark.parametrize(
    ("cause", "acceleration", "size"), [(QuadraticDrag(), quadratic, 0.02), (LinearDrag(), linear, 0.3)]
)
def test_falls_are_integrated_as_by_scipy(cause, acceleration, size):
    """To a tenth of a millimetre; and slopes are the differences between falls."""
    law, seconds = cause.extend(Fall()), FRAME * np.arange(NUMBER)
    values = np.array([*RELEASED[1], size])
    heights, slopes = law.model({"seconds": seconds})(values)
    assert heights == pytest.approx(fall(*RELEASED[1], acceleration), abs=1e-4)
    apart = [
        law.predict({"seconds": seconds}, values + step) - law.predict({"seconds": seconds}, values - step)
        for step in np.diag([1e-3, 1e-3, 1e-4])
    ]
    assert slopes == pytest.approx(np.transpose(apart) / [2e-3, 2e-3, 2e-4], rel=1e-3, abs=1e-3)


def false_alarms(number, alpha):
    return sum(selection(filmed(free, seed), alpha).p_value < alpha for seed in range(number))


def test_free_fall_is_nothing_wrong():
    assert false_alarms(40, 0.05) <= binom.ppf(0.999, 40, 0.05)


@pytest.mark.nightly
def test_free_fall_is_nothing_wrong_at_the_stated_rate():
    assert false_alarms(1000, ALPHA) <= binom.ppf(0.99, 1000, ALPHA)


@pytest.mark.parametrize(
    ("name", "acceleration", "size"), [("quadratic-drag", quadratic, 0.02), ("linear-drag", linear, 0.3)]
)
def test_drag_is_named_with_its_size(name, acceleration, size):
    covered = 0
    for seed in range(6):
        rows = filmed(acceleration, seed)
        search = selection(rows)
        (found,) = size_findings(search, make_problem(rows)[0], ALPHA)
        assert (found.cause, found.equivalent) == (name, ())
        covered += found.parameters[0].size.low < size < found.parameters[0].size.high
    assert covered >= binom.ppf(0.001, 6, 0.95)


def test_another_g_the_cameras_scale_and_buoyancy_cannot_be_told_apart():
    found = diagnose_problem(*make_problem(filmed(lambda _: -1.05 * G, 1)), alpha=ALPHA)
    (finding,) = found.findings
    assert found.verdict == "cannot tell apart"
    assert {finding.cause, *finding.equivalent} == DEGENERATE
    assert {frozenset(pair) for pair in found.aliased_causes} == {
        frozenset(("another-g", "camera-scale")),
        frozenset(("another-g", "buoyancy")),
        frozenset(("buoyancy", "camera-scale")),
    }


def test_what_release_absorbs_and_what_was_not_written_down_is_untestable():
    rows = filmed(quadratic, 2).assign(weight=np.nan)
    found = diagnose_problem(*make_problem(rows), alpha=ALPHA)
    assert set(found.untestable) == {"clock-offset", "buoyancy"}
    assert "recalibrated" in found.untestable["clock-offset"]
    assert "written down" in found.untestable["buoyancy"]


def test_a_camera_that_sways_is_no_cause_of_the_library():
    rows = filmed(free, 3)
    swaying = 0.15 * np.sin(2 * np.pi * rows["seconds"] / 0.9 + (rows["session"] == "drop 2"))
    found = selection(rows.assign(height=rows["height"] + swaying)).selected
    assert [each.cause for each in found] == ["unknown"]


def test_a_drop_held_out_is_predicted_to_within_the_noise():
    rows = filmed(quadratic, 4)
    search = selection(rows)
    named = size_findings(search, make_problem(rows)[0], ALPHA)
    splits = later_half_of_the_last_drop(rows)
    worth, _ = estimate_gain(
        search, named, splits, partial(select_in_fold, alpha=ALPHA), alpha=ALPHA, workers=1
    )
    assert worth.baseline > 20 * worth.noise_floor
    assert worth.extended < 2 * worth.noise_floor


def test_what_is_held_out_takes_no_part():
    """A metre more in it is a metre further off."""
    rows = filmed(quadratic, 5)
    problem = make_problem(rows)[0]
    (split,) = later_half_of_the_last_drop(rows)
    named = size_findings(selection(rows), problem, ALPHA)
    higher = rows["height"] + np.isin(np.arange(len(rows)), split.held_out)
    other = make_problem(rows.assign(height=higher))[0]
    before, after = (
        compute_held_out_errors(each, split, named, partial(select_in_fold, alpha=ALPHA), (0,))
        for each in (problem, other)
    )
    assert after == pytest.approx(before + 1.0, abs=1e-4)
