"""Causes that change friction, under a physical law: against that law with its friction changed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import Humidity, PayloadChange, SessionJump, Wear
from stickslip_fit.causes.friction import StageEffect
from stickslip_fit.causes.parameters import candidate_moments
from stickslip_fit.laws import published_law
from stickslip_fit.laws.physical import FRICTION_LIMITED, PhysicalElbow, PhysicalPrismatic
from stickslip_fit.machine import load_machine

MACHINE = load_machine()
SHARE, CHANGE = 0.1, 0.08
LAWS = {3: PhysicalPrismatic, 2: lambda ratios: PhysicalElbow(MACHINE, ratios)}
SIZE = {3: 976e-9, 2: 95e-6}


def rows_of(joint):
    out = np.array([1, -1, 1, -1])
    table = {"q1": 0.0, "q2": -1.2, "q3": 0.006, "theta": 0.2, "psi": [-1.0, -1.0, 1.0, 1.0]}
    low, high = MACHINE.ranges[joint]
    return pd.DataFrame(
        {
            **table,
            "joint": joint,
            "start": np.where(out > 0, low, high),
            "stop": np.where(out > 0, high, low),
            "steps_before": 1e5 * np.expm1(1.0),
            "humidity": 0.0,
        }
    )


def values_of(law, friction=1.0):
    """Parameters with friction times a factor, the load the same with the arm in and out."""
    limited = np.mean(law.ratios) > 1.0
    first = SIZE[law.joint] * (friction if limited else 1.0)
    others = [SHARE / friction if one.name.startswith("r") else 0.0 for one in law.parameters[1:]]
    return np.array([first, *others])


@pytest.mark.parametrize("joint", LAWS)
@pytest.mark.parametrize(("ratio", "accuracy"), [(FRICTION_LIMITED, 1e-9), (0.4, 2e-4)])
def test_wear_is_a_change_of_friction(joint, ratio, accuracy):
    """One e-fold of steps: friction is 8 % larger."""
    rows, law = rows_of(joint), LAWS[joint]((ratio, ratio))
    after = LAWS[joint]((max(ratio / (1 + CHANGE), 2.0) if ratio > 1 else ratio / (1 + CHANGE),) * 2)
    expected = after.predict(rows, values_of(after, 1 + CHANGE))
    extended = Wear().extend(law)
    worn = extended.predict(rows, np.append(values_of(law), [CHANGE, 1e5]))
    assert np.ptp(expected - law.predict(rows, values_of(law))) > 10 * accuracy  # the load has a say
    assert worn == pytest.approx(expected, abs=accuracy)
    trial = Wear().changes(law, rows, np.tile(values_of(law), (4, 1)), np.array([[CHANGE, 1e5]]))
    assert trial[:, 0] == pytest.approx(worn - law.predict(rows, values_of(law)), abs=1e-9)


@pytest.mark.parametrize("ratio", [FRICTION_LIMITED, 0.4])
def test_its_derivatives_are_those_of_the_counts(ratio):
    rows, law = rows_of(3), PhysicalPrismatic((ratio, ratio))
    extended, values = Wear().extend(law), np.append(values_of(law), [CHANGE, 1e5])
    slope, step = extended.jacobian(rows, values)[:, -2], np.array([0.0, 0.0, 0.0, 1e-6, 0.0])
    change = extended.predict(rows, values + step) - extended.predict(rows, values - step)
    assert slope == pytest.approx(change / 2e-6, rel=1e-4)


def test_under_the_published_law_it_multiplies_the_step():
    law = published_law(3, rows_of(3), MACHINE)
    assert Humidity().under(law) == Humidity()
    assert isinstance(Humidity().under(PhysicalPrismatic()), StageEffect)


# What each quantity of the stage times 1 + CHANGE makes of a_f T1^2, r and lambda.
QUANTITIES = {"friction": (1, -1, -1), "voltage": (0, 0, 1), "ramp time": (2, 0, -2)}


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize(("ratio", "accuracy"), [(FRICTION_LIMITED, 1e-9), (0.4, 4e-4)])
def test_a_jump_is_one_of_a_quantity_of_the_stage(quantity, ratio, accuracy):
    """Against the physical law of a stage in which that quantity is 8 % larger."""
    unit_power, share_power, ratio_power = QUANTITIES[quantity]
    rows = rows_of(3).assign(session="a", session_seconds=[0.0, 10.0, 20.0, 30.0])
    law = PhysicalPrismatic((ratio, ratio))
    later = ratio * (1 + CHANGE) ** ratio_power
    after = PhysicalPrismatic((later, later))
    values = values_of(law)
    unit = values[0] / min(ratio, 1.0) * (1 + CHANGE) ** unit_power
    changed = np.array([unit * min(later, 1.0), values[1], values[2] * (1 + CHANGE) ** share_power])
    before, expected = law.predict(rows, values), after.predict(rows, changed)
    jump = SessionJump(session="a", form=quantity)
    extended = jump.extend(law).predict(rows, np.append(values, [CHANGE, 15.0]))
    assert extended[:2] == pytest.approx(before[:2], abs=1e-12)
    assert extended[2:] == pytest.approx(expected[2:], abs=accuracy)
    if (quantity, ratio) != ("voltage", FRICTION_LIMITED):
        assert np.abs(expected[2:] - before[2:]).max() > 5 * accuracy
    trial = jump.changes(law, rows, np.tile(values, (4, 1)), np.array([[CHANGE, 15.0]]))
    assert trial[:, 0] == pytest.approx(extended - before, abs=1e-9)


def test_forms_are_tried_where_a_law_tells_them_apart():
    published = published_law(3, rows_of(3), MACHINE)
    assert SessionJump().for_laws([published]) == SessionJump()
    limited, other = PhysicalPrismatic((10.0, 10.0)), PhysicalPrismatic((0.4, 0.4))
    assert SessionJump().for_laws([limited]).tried == ("step", "friction")
    assert SessionJump().for_laws([other]).tried == ("step", "friction", "voltage")
    assert SessionJump().for_laws([limited, other]).tried == ("step", "friction", "voltage", "ramp time")


def test_finer_trials_have_every_moment_between_candidates():
    """Of 160 traverses every other moment is a candidate; about one of them, none is left out."""
    seconds = np.arange(160) * 100.0
    rows = pd.DataFrame({"session": "a", "session_seconds": seconds})
    coarse = candidate_moments(rows)[0][1]
    assert np.diff(coarse).min() == 200.0
    for cause in (SessionJump(session="a"), PayloadChange(session="a")):
        finer = cause.finer_trials(rows, np.array([0.05, coarse[30]]))
        assert finer[:, 1].tolist() == (coarse[30] + np.array([-200.0, -100.0, 0.0, 100.0, 200.0])).tolist()
        assert np.all(finer[:, 0] == 0.05)
