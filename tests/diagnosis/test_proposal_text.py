"""What is said and drawn of structure without a name: what is proposed, what it gains, what tests it."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import SizedParameter
from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.diagnosis import Finding, Gain, diagnose
from stickslip_fit.diagnosis._summary import write_headline
from stickslip_fit.diagnosis._unknown_summary import (
    describe_share,
    describe_stand_in,
    describe_test,
    name_carriers,
)
from stickslip_fit.diagnosis.residuals import compare_residuals, finding_shape
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.machine import load_machine
from stickslip_fit.plotting.diagnosis import plot_residuals
from stickslip_fit.plotting.residuals import concatenate_sessions, draw_finding, finding_picture
from stickslip_fit.units import Interval
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

BY_SESSION = pd.DataFrame({"session": ["a"], "baseline": [0.02], "extended": [0.004], "traverses": [9]})
GAIN = Gain(0.0186, 0.0041, 0.0029, 0.013, 0.0155, BY_SESSION)
SIZE = Interval(0.008, 0.008 - 1.96 * 0.001, 0.008 + 1.96 * 0.001)


@pytest.fixture(scope="module")
def hidden():
    """Steps that shrink or grow with the square of psi."""
    return hide("session", ("unknown:angle",), 25, seed=3, forms={"unknown:angle": "square of psi"})


@pytest.fixture(scope="module")
def proposed(hidden):
    diagnosis = diagnose(read_hidden(hidden, (2, 3)), gain=False)
    assert [finding.cause for finding in diagnosis.findings] == ["unknown"]
    assert diagnosis.findings[0].version is not None
    return diagnosis


def with_finding(diagnosis, **changes):
    return replace(diagnosis, findings=(replace(diagnosis.findings[0], **changes),))


def test_a_term_is_proposed_with_its_formula_its_size_and_its_gain(proposed):
    sized = (SizedParameter("k", "%", SIZE),)
    shown = with_finding(proposed, term="k psi^2", parameters=sized, gain=GAIN, joints=(3,))
    first, second = write_headline(shown)
    assert first == (
        "Joint 3's steps follow psi in a way that no known cause describes; a term is proposed: k psi^2, "
        "k = 0.80 ± 0.10 %; it lowers the held-out error from 1.9 % to 0.41 %."
    )
    assert "find out what the term stands for" in second
    in_doubt = with_finding(shown, gain=replace(GAIN, low=-0.001))
    assert write_headline(in_doubt)[0].endswith(
        "from 1.9 % to 0.41 %, though a replicate might gain nothing."
    )
    text = " ".join(str(shown).split())
    assert "Parameters of what was named or proposed" in text
    assert "unknown: proposed term" in text
    # Without a gain, the size of its effect.
    assert "its effect is" in write_headline(with_finding(shown, gain=None))[0]


def test_two_errors_that_look_alike_are_not_told_as_a_gain(proposed):
    for low, told in ((-0.0018, "held-out errors stay at 2.2 %"), (0.0001, "error of 2.2 % by 0.03 %")):
        alike = replace(GAIN, baseline=0.0220, extended=0.0217, low=low, high=0.0035)
        first = write_headline(with_finding(proposed, gain=alike))[0]
        assert told in first
        assert "from 2.2 % to 2.2 %" not in first
        assert "might gain nothing" not in first


def test_what_has_numbers_for_names_is_told_by_name_and_what_is_not_known_is_no_extreme(proposed):
    selection, version = proposed.selection, SmoothTerm(("before_joint",))
    change = np.abs(finding_shape(selection, selection.selected[-1]))
    rows = selection.problem.rows.assign(before_joint=np.where(change > np.median(change), np.nan, 2.0))
    logged = replace(
        proposed, selection=replace(selection, problem=replace(selection.problem, table=RowTable(rows)))
    )
    sentence = describe_test(replace(proposed.findings[0], version=version), logged)
    assert len(re.findall(r"joint \d after joint 2 \(steps [+−]?[\d.]+ %\)", sentence)) == 2


def test_without_a_formula_it_is_a_smooth_function_and_its_coefficients_are_not_shown(proposed):
    sized = (SizedParameter("c1", "%", SIZE),)
    shown = with_finding(proposed, term="", parameters=sized, joints=(1, 2))
    assert write_headline(shown)[0].startswith(
        "The steps of joints 1 and 2 follow psi in a way that no known"
    )
    assert "c1" not in str(shown)


def test_a_product_is_named_with_both_of_its_columns_in_words():
    version = SmoothTerm(("load", "session_seconds"), sessions=("a", "b"))
    assert name_carriers(Finding("unknown", version, (), 0.001, (3,), SIZE, ())) == (
        "the load and the time in the session together, differently in each session,"
    )
    only = SmoothTerm(("load",), sessions=("a",))
    assert name_carriers(Finding("unknown", only, (), 0.001, (3,), SIZE, ())) == "the load"
    opposite = SmoothTerm(("covariate:lamp",), mode="opposite")
    assert name_carriers(Finding("unknown", opposite, (), 0.001, (3,), SIZE, ())) == (
        "lamp, with opposite signs in the two directions,"
    )


@pytest.mark.parametrize(
    ("version", "told"),
    [
        (SmoothTerm(("psi",)), False),
        (SmoothTerm(("psi",), mode="opposite"), True),
        (SmoothTerm(("psi",), on=((3, "+"), (3, "-"))), False),
        (SmoothTerm(("psi",), on=((3, "+"),)), True),
        (SmoothTerm(("psi",), on=((3, "+"), (3, "-")), each=True), True),
    ],
)
def test_the_direction_of_a_test_is_told_where_it_matters(proposed, version, told):
    sentence = describe_test(replace(proposed.findings[0], version=version), proposed)
    assert bool(re.search(r"joint \d [+−] at", sentence)) == told


def test_the_traverses_that_test_it_are_those_where_its_effect_is_at_its_extremes(hidden, proposed):
    """The square of psi, after recalibration: at psi of the log where the hidden effect is so, too."""
    sentence = describe_test(proposed.findings[0], proposed)
    told = re.findall(r"joint (\d)(?: [+−])? at psi = (−?\d+)° \(steps ([+−]?[\d.]+) %\)", sentence)
    assert len(told) == 2
    steps = 100 * np.expm1(-hidden.effect("unknown:angle"))
    psi, said = (np.array([each[k].replace("−", "-") for each in told], dtype=float) for k in (1, 2))
    true = np.array([steps[hidden.table["psi_deg"] == each].mean() for each in psi])
    assert abs(np.diff(true)) > 0.7 * np.ptp(steps)
    assert np.diff(said) == pytest.approx(np.diff(true), rel=0.15)


def test_the_closest_causes_say_what_their_equation_and_what_a_bent_form_would_take_away(proposed):
    explains = {"drift": 0.36, "wear": 0.05, "side-load": 0.75, "worn-spot": 0.004}
    by_equation, size = {"side-load": 0.21, "drift": 0.36}, Interval(0.01, 0.009, 0.011)
    shown = with_finding(proposed, explains=explains, explains_by_equation=by_equation, effect=size)
    text = str(shown)
    table = text[text.index("The closest causes") :].splitlines()
    rows = [re.split(r"\s{2,}", line.strip()) for line in table[3:6]]
    # 1 % with 75 % of its square explained leaves half of it.
    assert rows == [
        ["drift", "36", "36", "0.80"],
        ["side-load", "21", "75", "0.50"],
        ["wear", "–", "5", "0.97"],
    ]
    assert "worn-spot  " not in "\n".join(table[:8])
    # Almost any curve can be bent into another one: that is no evidence for the cause.
    assert "(the closest known cause, drift, explains 36 % of it)" in " ".join(text.split())
    assert (describe_share(shown.findings[0], "side-load")) == (
        "explains 21 % of it, 75 % if its form may bend as the data ask"
    )


def test_a_cause_that_explains_next_to_nothing_is_not_called_the_closest(proposed):
    (finding,) = proposed.findings
    for explains, by_equation, said in (
        ({"drift": 0.012, "wear": 0.001}, {"drift": 0.012}, "more than 2 % of it)"),
        (
            {"drift": 0.03, "wear": 0.86},
            {"drift": 0.03, "wear": 0.07},
            "more than 7 % of it by its equation)",
        ),
    ):
        told = replace(finding, explains=explains, explains_by_equation=by_equation)
        assert describe_stand_in(told).endswith(f"(no known cause explains {said}")


def test_causes_that_show_only_together_say_so(named):
    (drift,) = named.findings
    together = replace(drift, together_with=("wear",))
    assert write_headline(replace(named, findings=(together,)))[0].endswith(
        "; found together with wear: neither is the likeliest alone."
    )
    three = replace(drift, together_with=("wear", "humidity"))
    besides = write_headline(replace(named, findings=(drift, three)))[2]
    assert besides.endswith(
        "(drift); found together with wear and humidity: none of them is the likeliest alone."
    )


def test_the_figure_shows_what_is_left_without_the_proposal_the_proposal_and_what_is_left_with_it(proposed):
    figure = plot_residuals(proposed, 0)
    comparison = compare_residuals(proposed.selection, proposed.seed)
    shape = finding_shape(proposed.selection, proposed.selection.selected[-1])
    axes, joints = figure.axes, proposed.findings[0].joints
    assert len(axes) == 2 * len(joints)
    psi = np.degrees(comparison.rows["psi"].to_numpy(float))
    for column, joint in enumerate(joints):
        without, left = axes[column], axes[len(joints) + column]
        subset = ((comparison.rows["joint"] == joint) & (comparison.rows["direction"] == "+")).to_numpy()
        (dashed, _) = (line for line in without.lines if line.get_linestyle() == "--")
        for x, y in zip(dashed.get_xdata(), dashed.get_ydata(), strict=True):
            inside = subset & np.isclose(psi, x)
            assert y == pytest.approx(100 * shape[inside].mean(), abs=1e-9)
        means = [
            container.lines[0].get_ydata()[0] for container in (without.containers[0], left.containers[0])
        ]
        first = subset & np.isclose(psi, psi[subset].min())
        assert means[0] - means[1] == pytest.approx(100 * shape[first].mean(), abs=1e-9)
        assert left.get_xlabel() == "psi (°)"
    # With the proposal the residuals are as noise alone would leave them: without it they were not.
    assert np.std(comparison.after) < 0.8 * np.std(comparison.after + shape)


def test_the_picture_shows_the_proposal_and_the_answer_calls_it_no_cause(proposed):
    shown, selection = with_finding(proposed, term="k psi^2"), proposed.selection
    selected, comparison = selection.selected[-1], compare_residuals(selection, proposed.seed)
    shape = finding_shape(selection, selected)
    picture = finding_picture(shown.findings[0], selected, shape, comparison, load_machine())
    assert picture.title == "What is proposed: k psi^2"
    assert picture.caption.startswith("Residuals over psi (°). Points: traverses")
    assert "dashed: the term as fitted" in picture.caption
    text = " ".join(str(shown).split())
    assert "it is no cause" in text
    assert "is not put into the law" not in text


def test_a_proposal_along_the_travel_is_drawn_over_each_joint_s_own_position(proposed):
    selected, comparison = proposed.selection.selected[-1], compare_residuals(proposed.selection, 0)
    along, finding = replace(selected, version=SmoothTerm()), replace(proposed.findings[0], joints=(2, 3))
    label, figure = draw_finding(finding, along, comparison.after, comparison, load_machine())
    assert label == "own position (° or mm)"
    middle = (comparison.rows["start"] + comparison.rows["stop"]) / 2
    for axis, joint, scale in zip(figure.axes, (2, 3), (180 / np.pi, 1e3), strict=False):
        drawn = np.concatenate([line.get_xdata() for line in axis.lines if line.get_marker() == "o"])
        own = scale * middle[comparison.rows["joint"] == joint]
        assert drawn.min() == pytest.approx(own.min(), abs=1e-6)
        assert drawn.max() == pytest.approx(own.max(), abs=1e-6)


def test_a_session_begins_at_a_dotted_line(proposed):
    selected, comparison = proposed.selection.selected[-1], compare_residuals(proposed.selection, 0)
    clock = comparison.rows["session_seconds"]
    noon = clock.iloc[len(clock) // 2]
    rows = comparison.rows.assign(session=np.where(clock < noon, "am", "pm"))
    rows["session_seconds"] = clock.where(clock < noon, clock - noon)
    shape, comparison = np.where(clock < noon, -1.0, 1.0), replace(comparison, rows=rows)
    label, figure = draw_finding(proposed.findings[0], selected, shape, comparison, load_machine())
    assert label == "hours, all sessions"
    for axis in figure.axes:
        (begin,) = [line.get_xdata()[0] for line in axis.lines if line.get_linestyle() == ":"]
        assert begin == pytest.approx(concatenate_sessions(rows)[rows["session"] == "pm"].min())


def test_structure_without_a_law_has_no_proposal(unnamed):
    bare = with_finding(unnamed, version=None, term="")
    text = " ".join(str(bare).split())
    assert "propos" not in text
    assert "Structure without a name is not put into the law" in text


def test_a_finding_of_no_columns_has_no_test(proposed):
    none = Finding("unknown", object(), (), 0.001, (3,), SIZE, ())
    assert describe_test(none, proposed) == ""
