"""Causes that change friction, under a physical law: against that law with its friction changed."""

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


# What each quantity of the stage times 1 + CHANGE makes of a_f T1^2, r and lambda, to these powers.
QUANTITIES = {"friction": (1, -1, -1), "voltage": (0, 0, 1), "ramp time": (2, 0, -2)}
RATIOS = (FRICTION_LIMITED, 0.4, 0.95, 1.05)


def values_of(law, quantity="friction", change=0.0, share=SHARE):
    """Parameters at first, or after a quantity changed, the load the same with the arm in and out."""
    unit, by_share, by_ratio = ((1 + change) ** power for power in QUANTITIES[quantity])
    ratio = law.ratios[0]
    first = SIZE[law.joint] / min(ratio, 1.0) * unit * min(ratio * by_ratio, 1.0)
    others = [share * by_share if one.name.startswith("r") else 0.0 for one in law.parameters[1:]]
    return np.array([first, *others])


@pytest.mark.parametrize("joint", LAWS)
@pytest.mark.parametrize("ratio", RATIOS)
def test_wear_is_a_change_of_friction(joint, ratio):
    """One e-fold of steps: friction is 8 % larger."""
    rows, law = rows_of(joint), LAWS[joint]((ratio, ratio))
    after = LAWS[joint]((ratio / (1 + CHANGE),) * 2)
    expected = after.predict(rows, values_of(law, "friction", CHANGE))
    # Between the regimes the step has a kink, which is narrowed down to some 1e-5.
    accuracy = 1e-9 if ratio in (FRICTION_LIMITED, 0.4) else 2e-5
    extended = Wear().extend(law)
    worn = extended.predict(rows, np.append(values_of(law), [CHANGE, 1e5]))
    assert np.ptp(expected - law.predict(rows, values_of(law))) > 100 * accuracy  # the load has a say
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


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("ratio", RATIOS)
def test_a_jump_is_one_of_a_quantity_of_the_stage(quantity, ratio):
    """Against the physical law of a stage in which that quantity is 8 % larger."""
    rows = rows_of(3).assign(session="a", session_seconds=[0.0, 10.0, 20.0, 30.0])
    law = PhysicalPrismatic((ratio, ratio))
    later = ratio * (1 + CHANGE) ** QUANTITIES[quantity][2]
    values = values_of(law)
    before = law.predict(rows, values)
    expected = PhysicalPrismatic((later, later)).predict(rows, values_of(law, quantity, CHANGE))
    jump = SessionJump(session="a", form=quantity)
    extended = jump.extend(law).predict(rows, np.append(values, [CHANGE, 15.0]))
    assert extended[:2] == pytest.approx(before[:2], abs=1e-12)
    assert extended[2:] == pytest.approx(expected[2:], abs=1e-9)
    if quantity != "voltage" or ratio < 1.0:
        assert np.abs(expected[2:] - before[2:]).max() > 0.001
    trial = jump.changes(law, rows, np.tile(values, (4, 1)), np.array([[CHANGE, 15.0]]))
    assert trial[:, 0] == pytest.approx(extended - before, abs=1e-9)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_with_another_lambda_it_acts_as_there(quantity):
    """Where a log tells no regime: steps of one law, the change as of the other with the same response."""
    rows, share = rows_of(3).assign(session="a", session_seconds=0.0), 0.02
    limited, other = PhysicalPrismatic((FRICTION_LIMITED,) * 2), PhysicalPrismatic((0.4, 0.4))
    own, its_own = values_of(limited, share=share), values_of(other, share=share * 2.0 / 0.4)
    there = SessionJump(session="a", form=quantity).changes(
        other, rows, np.tile(its_own, (4, 1)), np.array([[CHANGE, -1.0]])
    )
    jump = SessionJump(session="a", form=quantity, assumed=((3, 0.4, 0.4),))
    assert jump.changes(limited, rows, np.tile(own, (4, 1)), np.array([[CHANGE, -1.0]])) == pytest.approx(
        there
    )
    # The own derivatives of the law are those of its counts.
    extended, values = jump.extend(limited), np.append(own, [CHANGE, -1.0])
    slope, step = extended.jacobian(rows, values)[:, 2], np.array([0.0, 0.0, 1e-6, 0.0, 0.0])
    change = extended.predict(rows, values + step) - extended.predict(rows, values - step)
    assert slope == pytest.approx(change / 2e-6, rel=1e-5)


def test_forms_are_tried_where_a_law_tells_them_apart():
    def tried(*laws):
        return tuple(quantity for quantity, _ in SessionJump().for_laws(laws).tried)

    assert SessionJump().for_laws([published_law(3, rows_of(3), MACHINE)]) == SessionJump()
    limited, other = PhysicalPrismatic((10.0, 10.0)), PhysicalPrismatic((0.4, 0.4))
    assert tried(limited) == ("step", "friction")
    assert tried(other) == ("step", "friction", "voltage")
    assert tried(limited, other) == ("step", "friction", "voltage", "ramp time")


def test_both_regimes_are_tried_where_a_log_tells_neither():
    law = PhysicalPrismatic((10.0, 10.0))
    assert Wear().for_laws([law]) == Wear()
    law.regimes = {"velocity-limited": (0.4, 10.0)}
    worn = [version.assumed for version, _ in Wear().for_laws([law]).trials(rows_of(3))]
    assert worn == [(), ((3, 0.4, 10.0),)]
    jumps = [(one, assumed[:1]) for one, assumed in SessionJump().for_laws([law]).tried]
    own, low = (), ((3, 0.4, 10.0),)
    mixed = [(quantity, low) for quantity in ("friction", "voltage", "ramp time")]
    assert jumps == [("step", own), ("friction", own), *mixed]


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
