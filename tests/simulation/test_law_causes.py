"""Causes written into a law file, beside their equations by hand."""

import numpy as np
import pytest

from stickslip_fit.causes import ExtendedLaw, extend
from stickslip_fit.causes.proposed import CarryOverTerm
from stickslip_fit.errors import InputError
from stickslip_fit.simulation import LawValues, simulate

QUIET = {"repeatability": 1e-9, "check_every": 1}
WARM = '[[cause]]\nname = "thermal-warm-up"\nA = "3 %"\ntau = "20 min"\n'
REVERSED = '[[cause]]\nname = "reversal-loss"\nL = "80 steps"\n'
BENT = '[[cause]]\nname = "load-nonlinearity"\nform = "cube"\nk = {"3-" = "2 %"}\n'
KNOCKED = '[[cause]]\nname = "session-jump"\nsession = "2012-03-06"\nA = "1 %"\nmoment = "5 min"\n'


def test_a_simulated_log_departs_as_the_causes_say(rows_of):
    plain, rows = rows_of(**QUIET), rows_of(more=WARM + REVERSED, **QUIET)
    warm = 1 + 0.03 * (1 - np.exp(-rows["session_seconds"] / 1200))
    turned = (rows["before_direction"] != "") & (rows["before_direction"] != rows["direction"])
    assert turned.any()
    # A whole step each from two roundings.
    assert np.all(np.abs(rows["steps"] - (plain["steps"] / warm + 80 * turned)) < 1.5)


def test_a_profile_along_the_travel_is_one_of_a_joint_by_its_number(rows_of):
    profile = '[[cause]]\nname = "along-travel"\nf1 = {"3" = "5 %"}\nf2 = "0 %"\nf3 = {"3" = "-2 %"}\n'
    plain, rows = rows_of(**QUIET), rows_of(more=profile, **QUIET)
    share = np.linspace(rows["start"], rows["stop"], 2001) / 12e-3
    longer = np.trapezoid(1 / (1 + 0.05 * np.cos(np.pi * share) - 0.02 * np.cos(3 * np.pi * share)), axis=0)
    slides = rows["joint"] == 3
    expected = plain["steps"] * np.where(slides, longer / 2000, 1.0)
    assert slides.any()
    assert np.all(np.abs(rows["steps"] - expected) < 1.5)


def test_every_value_is_read_in_its_unit_and_each_drive_has_its_own(law_of):
    law = law_of(more=WARM + BENT + KNOCKED)
    extended = law.laws[3]
    assert isinstance(extended, ExtendedLaw)
    found = dict(zip((each.name for each in extended.parameters), law.values[3, "+", None], strict=True))
    wanted = {"thermal-warm-up.A": 0.03, "thermal-warm-up.tau": 1200.0, "load-nonlinearity.k[3-]": 0.02}
    wanted |= {"load-nonlinearity.k[3+]": 0.0, "session-jump.moment[2012-03-06]": 300.0}
    assert {name: found[name] for name in wanted} == pytest.approx(wanted)
    assert extended.causes[1].form == "cube"


def test_a_form_has_the_parameters_of_its_own(law_of):
    bent = BENT.replace('"cube"', '"square-and-cube"') + 'cubic = {"3+" = "-1 %"}\n'
    curved = '[[cause]]\nname = "temperature"\nform = "curved"\nk = "0.2 %/K"\nbend = "0.5"\nmean = "20 °C"\n'
    law = law_of(more=bent + curved)
    found = dict(zip((one.name for one in law.laws[3].parameters), law.values[3, "+", None], strict=True))
    wanted = {"load-nonlinearity.k[3-]": 0.02, "load-nonlinearity.cubic[3+]": -0.01}
    wanted |= {"temperature.k": 0.002, "temperature.bend": 0.5}
    assert {name: found[name] for name in wanted} == pytest.approx(wanted)
    with pytest.raises(InputError, match="is no key of this table"):
        law_of(more=bent.replace("square-and-cube", "square"))


FAULTS = [
    (WARM.replace("3 %", "3 min"), "cause 1 A", "3 min", 'e.g. "2 %": change of the step size once warm'),
    (WARM.replace('"3 %"', "3"), "cause 1 A", "3", "a number and its unit as text"),
    (WARM.replace('tau = "20 min"', ""), "cause 1 tau", None, "time constant"),
    (WARM.replace("20 min", "500 min"), "cause 1 tau", "500 min", "lies outside what is possible"),
    (
        WARM.replace("thermal", "termal"),
        "cause 1 name",
        "termal-warm-up",
        "give one of thermal-warm-up, drift",
    ),
    (WARM + "k = 1\n", "cause 1 k", "1", "is no key of this table"),
    (BENT.replace("cube", "bow"), "cause 1 form", "bow", "give one of square, cube, tanh"),
    (BENT.replace("3-", "4-"), "cause 1 k", "{'4-': '2 %'}", "name joints and directions as 1+, 1-"),
    (KNOCKED.replace("2012-03-06", ""), "cause 1 session", "", "give the session"),
]


@pytest.mark.parametrize(("written", "place", "value", "message"), FAULTS)
def test_a_fault_is_told_with_its_place_and_what_to_write(law_of, written, place, value, message):
    with pytest.raises(InputError) as caught:
        law_of(more=written)
    problem = next(each for each in caught.value.problems if message in each.message)
    assert (problem.column, problem.value) == (place, value)


def test_a_jump_in_a_session_that_is_not_planned_is_refused(plan_of, law_of, machine):
    law = law_of(more=KNOCKED.replace("03-06", "04-06"))
    with pytest.raises(InputError, match="session-jump happens in session '2012-04-06', which the plan does"):
        simulate(plan_of(), law, machine)


def test_what_a_traverse_departs_by_carries_over_to_the_next(plan_of, law_of, rows_of, machine):
    """The same noise with and without it."""
    plan, law = plan_of(replicates=4, order="random"), law_of()
    extended = extend(law.laws[3], CarryOverTerm(on=((3, "+"),)))
    values = {key: np.append(own, 0.6) for key, own in law.values.items()}
    rows = simulate(plan, LawValues({3: extended}, values), machine).rows
    plain = simulate(plan, law, machine).rows
    expected = rows_of(replicates=4, order="random", **QUIET)["steps"].to_numpy()
    departure = expected / (plain["steps"] - 2.5).to_numpy() - 1
    follows = (rows["direction"] == "+").to_numpy() & (rows["session_order"] > 0).to_numpy()
    carried = np.where(follows, 0.6 * np.r_[0.0, departure[:-1]], 0.0)
    assert np.std(carried[follows]) > 1e-3
    assert np.all(np.abs(rows["steps"] - plain["steps"] / (1 + carried)) <= 10)
