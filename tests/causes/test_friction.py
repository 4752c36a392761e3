"""Causes that change friction, under a physical law: against that law with its friction changed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import Humidity, Wear
from stickslip_fit.causes.friction import StageEffect
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
