"""Which change of the stage stands behind a change of an actuator: logs of stages before and after it."""

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit.changes import detect_changes, read_stage_difference
from stickslip_fit.changes._summary import summarize_changes
from stickslip_fit.laws.physical import PhysicalPrismatic
from stickslip_fit.step import step_size

GRAVITY = 9.80665
# Of a stage: friction over mass, ramp time, travel of the foot over what friction allows.
FRICTION, RAMP = 45.0, 1.45e-4
RATIO = {"friction-limited": 3.0, "velocity-limited": 0.5, "limited under some loads": 1.05}
SIZE = 0.1
FRICTION_OR_MASS = {"friction", "mass"}
CASES = {  # what changed, in which regime: what is told
    ("friction", "friction-limited"): FRICTION_OR_MASS,
    ("ramp time", "friction-limited"): {"ramp time"},
    ("voltage", "velocity-limited"): {"voltage"},
    ("friction", "velocity-limited"): {*FRICTION_OR_MASS, "ramp time"},
}


def stage(regime, quantity="", factor=1.0):
    """The law of a stage and its values: step without load, recoil, weight over friction."""
    throw = RATIO[regime] * FRICTION * RAMP**2
    each = {"friction": FRICTION, "ramp time": RAMP, "voltage": throw}
    friction, ramp, throw = (value * (factor if name == quantity else 1.0) for name, value in each.items())
    ratio = throw / friction / ramp**2
    return PhysicalPrismatic((ratio, ratio)), np.array(
        [step_size(friction, ramp, throw), 0.3, GRAVITY / friction]
    )


def compare(make_log, before, after, laws=None, psi="0"):
    old, new = make_log(6, truth=before, psi=psi), make_log(6, month=4, seed=1, truth=after, psi=psi)
    return detect_changes(old, new, laws=laws)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quantity", "regime", "laws"),
    [
        *((*case, None) for case in CASES),
        *(
            pytest.param(
                *case,
                {3: ssf.physical_law},
                marks=[] if case == ("voltage", "velocity-limited") else [pytest.mark.nightly],
            )
            for case in CASES
        ),
    ],
)
def test_a_change_of_the_stage_is_read(make_log, quantity, regime, laws):
    changes = compare(make_log, stage(regime), stage(regime, quantity, 1 + SIZE), laws)
    found = read_stage_difference(changes)
    expected = CASES[quantity, regime]
    assert {one.quantity for one in found.credible} == expected
    assert found.regime == regime
    (read,) = (one for one in found.credible if one.quantity == quantity)
    assert read.size.low < SIZE < read.size.high
    assert read.size.high - read.size.low < 0.1
    assert f"{regime} steps" in summarize_changes(changes).headline[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quantity", "factor"),
    [
        pytest.param("friction", 0.9, marks=pytest.mark.nightly),
        pytest.param("ramp time", 1.1, marks=pytest.mark.nightly),
        ("voltage", 0.9),
    ],
)
def test_a_change_that_takes_some_loads_into_the_other_regime_is_read(make_log, quantity, factor):
    """lambda is not the same before and after it, and one for both logs fits neither."""
    regime = "limited under some loads"
    before, after = stage(regime), stage(regime, quantity, factor)
    changes = compare(make_log, before, after, {3: ssf.physical_law}, psi="-90, -45, 0, 45, 90")
    found = read_stage_difference(changes)
    assert {one.quantity for one in found.credible} == {
        "friction": FRICTION_OR_MASS,
        "ramp time": {"ramp time"},
        "voltage": {"voltage"},
    }[quantity]
    (read,) = (one for one in found.credible if one.quantity == quantity)
    assert read.size.low < factor - 1 < read.size.high


def test_both_logs_have_one_lambda(make_log):
    """Chosen by each for itself it would make another law of r."""

    def choose(joint, rows, machine):
        months = {session[5:7] for session in rows["session"]}
        return PhysicalPrismatic(({1: 0.4, 2: 0.5}[len(months)],) * 2)

    changes = compare(make_log, stage("velocity-limited"), stage("velocity-limited"), {3: choose})
    assert changes.laws[3].ratios == (0.5, 0.5)


@pytest.mark.slow
def test_a_change_of_one_direction_alone_is_no_change_of_the_stage(make_log):
    changes = detect_changes(make_log(6), make_log(6, month=4, seed=1, change=0.1))
    assert changes.significant
    assert read_stage_difference(changes).credible == ()
    assert summarize_changes(changes).headline[-1].startswith("No single change of friction")


def test_where_nothing_changed_nothing_is_read(make_log):
    assert read_stage_difference(detect_changes(make_log(6), make_log(6, month=4, seed=1))) is None
