"""What is said of a diagnosis: the right cause, sizes and cure, and never more than the log shows."""

import re
from copy import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import (
    GuideGradient,
    PayloadChange,
    SessionJump,
    SizedParameter,
    covariates,
    library,
)
from stickslip_fit.diagnosis import Finding, Gain, NextTraverse, diagnose
from stickslip_fit.diagnosis._log_words import LogWords, describe_effect, remedy_for
from stickslip_fit.diagnosis._summary import _gain_tables, _parameter_tables, write_headline
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.units import Interval
from tests.diagnosis.conftest import ALPHA, REPEATABILITY, changed, hours_in

WIDTH = 110
SLOPES = ((-4.0, "+"), (1.8, "-"))  # 1/m
BY_SESSION = pd.DataFrame({"session": ["a"], "baseline": [0.02], "extended": [0.004], "traverses": [9]})
GAIN = Gain(0.0186, 0.0041, 0.0029, 0.013, 0.0155, BY_SESSION)


@pytest.fixture(scope="module")
def guide(table):
    """Joint 3's traverses."""
    return table[table["joint"] == 3].reset_index(drop=True)


def told(diagnosis) -> str:
    return " ".join(write_headline(diagnosis))


def finding_of(version, size: float) -> Finding:
    """A finding of a cause, all its parameters known and as large."""
    if hasattr(version, "summarize"):
        q = len(version.parameters)
        sizes = version.summarize(np.full(q, size), np.full((q, q), (0.05 * size) ** 2))
        return Finding(version.name, version, (), 0.0005, (2, 3), Interval(0.01, 0.009, 0.011), sizes)
    sizes = tuple(
        SizedParameter(
            each.name,
            each.unit,
            Interval(size, 0.9 * size, 1.1 * size),
            each.joint,
            each.direction,
            each.session,
        )
        for each in version.parameters
    )
    return Finding(version.name, version, (), 0.0005, (2, 3), Interval(0.01, 0.009, 0.011), sizes)


def test_a_named_cause_comes_with_its_size_its_cure_and_the_repeatability(named):
    assert named.verdict == "cause named"
    first, second = write_headline(named)
    rate = re.fullmatch(r"Steps shrink by (\d\.\d+) %/h through each session\.", first)
    assert rate
    assert float(rate[1]) == pytest.approx(0.3, abs=0.05)
    assert second.startswith("Remedy: recalibrating within the session, or the extended law, which ")
    noise = re.search(r"the repeatability is (\d\.\d+) %\.$", second)
    assert float(noise[1]) / 100 == pytest.approx(REPEATABILITY, rel=0.15)


def test_a_parameter_at_the_end_of_its_range_is_not_told_as_if_it_were_known(named):
    """A warm-up whose time constant is the longest that is fitted may be slower."""
    version = next(one for one in library() if one.name == "thermal-warm-up")
    finding = finding_of(version, 0.03)
    for minutes, at_bounds in ((180.0, ("tau",)), (170.0, ())):
        tau = replace(finding.parameters[1], size=Interval(60.0 * minutes, 9000.0, 60.0 * minutes))
        own = replace(finding, parameters=(finding.parameters[0], tau))
        assert own.at_bounds == at_bounds
        (table,) = _parameter_tables(replace(named, findings=(own,)))
        assert ("tau of thermal-warm-up: at the end of the range searched" in table.note) == bool(at_bounds)


def test_what_depends_on_a_parameter_at_the_end_of_its_range_is_not_told_by_its_size():
    """Wear after so many steps as no joint has made has the size of nothing that was seen."""
    (wear,) = (each for each in library() if each.name == "wear")
    k, n0 = finding_of(wear, 0.58).parameters
    for steps, words in (
        (1e7, "The joints wear (k = 58 %), n0 at the end of the range searched, 10,000,000 steps"),
        (1e5, "Steps grow by 134 % for every tenfold of the steps that a joint has made, from 100,000 on"),
    ):
        own = (k, replace(n0, size=Interval(steps, 0.5 * steps, steps)))
        assert describe_effect(replace(finding_of(wear, 0.58), parameters=own)).startswith(words)


def test_a_cause_among_others_that_held_out_traverses_do_not_show_says_so(named):
    (drift,) = named.findings
    for gain, told in (
        (GAIN, "(drift)."),
        (replace(GAIN, low=-0.001), "(drift); held-out traverses do not show it for certain."),
        (replace(GAIN, extended=0.0186, low=-0.001), "(drift); it does not show in held-out traverses."),
    ):
        several = replace(named, findings=(drift, replace(drift, gain=gain)))
        assert write_headline(several)[2].endswith(told)
        # Of a single cause the remedy says it.
        alone = replace(named, gain=gain, findings=(replace(drift, gain=gain),))
        assert write_headline(alone)[0].endswith("through each session.")


def test_that_a_new_session_is_predicted_worse_is_said_first(named):
    worse = replace(GAIN, baseline=0.0192, extended=0.0210, low=-0.0033, high=-0.0004)
    said = told(replace(named, gain_new_session=worse))
    assert said.startswith(
        "The extended law predicts a new session worse than the published law does, with errors of 2.1 % in "
        "place of 1.9 %: it is for the sessions of this log only. Steps shrink by "
    )
    unsure = replace(worse, high=0.0002)
    assert told(replace(named, gain_new_session=unsure)).startswith("Steps shrink by ")


def test_joints_for_which_no_new_session_is_predicted_are_told(named, monkeypatch):
    """A gain of nothing there would be read as that of the cause."""
    joints = sorted(named.selection.problem.rows["joint"].unique())
    by_joint = pd.DataFrame({"joint": joints[-1:], "direction": "+"})

    def note(by_joint):
        gain = None if by_joint is None else replace(GAIN, by_joint=by_joint)
        tables = _gain_tables(replace(named, gain=GAIN, gain_new_session=gain), LogWords(named))
        return tables[0].note

    assert len(joints) > 1
    assert "is not predicted" not in note(None)  # two sessions, where one is not held out
    monkeypatch.setattr("stickslip_fit.diagnosis._summary.MIN_SESSIONS", 2)
    assert f"A new session is not predicted for joint {joints[0]}: " in note(by_joint)
    assert f"not predicted for joints {' and '.join(map(str, joints))}: " in note(None)
    assert "is not predicted" not in note(pd.DataFrame({"joint": joints, "direction": "+"}))


def test_a_law_that_predicts_no_better_is_not_said_to_cut_the_error(named):
    alike = replace(GAIN, baseline=0.0220, extended=0.0217, low=-0.0018, high=0.0035)
    assert "the extended law, which predicts held-out traverses no better, to 2.2 % rms; " in told(
        replace(named, gain=alike)
    )
    certain = replace(alike, low=0.0001)
    assert "cuts the prediction error on held-out traverses, 2.2 %, by 0.03 %; " in told(
        replace(named, gain=certain)
    )


def test_a_gain_has_no_digits_that_nobody_can_know(named):
    """Of the errors those of an rms of some hundred rows, of the gain those of its interval."""
    for gain, cells in (
        (
            Gain(0.0091037, 0.0091037, 0.0026, -0.000018, 0.0, BY_SESSION),
            "0.910 0.910 0.0000 −0.0018 to 0.0000",
        ),
        (Gain(0.0123, 0.0121, 0.0026, 0.00016, 0.00024, BY_SESSION), "1.230 1.210 0.020 0.016 to 0.024"),
        (GAIN, "1.86 0.41 1.45 1.30 to 1.55"),
    ):
        (finding,) = named.findings
        text = " ".join(str(replace(named, gain=gain, findings=(replace(finding, gain=gain),))).split())
        assert f"held-out traverses {cells}" in text


def test_what_was_gained_on_held_out_traverses_is_said_where_it_is_known(named):
    assert (
        "the extended law, which cuts the prediction error on held-out traverses from 1.9 % to 0.41 %; "
        in told(replace(named, gain=GAIN))
    )


@pytest.mark.slow
def test_of_nothing_wrong_it_says_what_could_not_have_been_seen(nothing):
    assert nothing.verdict == "nothing wrong"
    said = told(nothing)
    assert said.startswith("Nothing is wrong that this log can show")
    assert re.search(r"It could not have shown [a-z-]+, [a-z-]+", said)
    for cause, why in nothing.untestable.items():
        assert cause in str(nothing)
        assert " ".join(why.split()) in " ".join(str(nothing).split())


def test_what_cannot_be_told_apart_is_named_together(named):
    rivals = replace(named.findings[0], equivalent=("thermal-warm-up",))
    unsure = replace(named, findings=(rivals,), verdict="cannot tell apart")
    said = told(unsure)
    assert "steps drift through each session (drift) or the drive warms up (thermal-warm-up)" in said
    assert "No candidate traverse would separate them." in said
    assert "Recalibrating" not in said
    assert "No traverse within reach separates drift from thermal-warm-up." in str(unsure)
    traverse = NextTraverse(
        "new",
        3,
        "-",
        0.0,
        0.0,
        np.nan,
        0.0,
        0.0,
        np.nan,
        np.nan,
        4,
        ("drift", "thermal-warm-up"),
        "after 5 h",
    )
    text = str(replace(unsure, next_experiment=(traverse,)))
    assert "lists the traverses that would separate them" in " ".join(text.split())
    assert re.search(r"3 − +4 +0° +0° +– +0° +0° +stop +stop +after 5 h", text)
    assert "No traverse within reach" not in text


def test_without_a_repeated_traverse_nothing_is_said_to_repeat(named):
    assert "the repeatability is" in told(named)
    selection = copy(named.selection)
    rows = named.selection.problem.rows
    once = rows.drop_duplicates(["session", "joint", "direction", "q1", "q2", "q3", "theta", "psi"])
    object.__setattr__(selection, "problem", replace(selection.problem, table=RowTable(once)))
    said = told(replace(named, selection=selection))
    assert "repeatab" not in said
    assert re.search(
        r"scatter that no law tried here explains is \d\.\d+ % \(no traverse was repeated\)", said
    )


def test_what_has_no_name_is_shown_as_it_is(unnamed):
    assert unnamed.verdict == "unknown cause"
    first, second = write_headline(unnamed)
    assert re.search(r"come and go with a period of 5\d\.\d min, which no known cause does; a wave", first)
    assert "find out what the function stands for" in second
    (finding,) = unnamed.findings
    near = replace(finding, version=None, share=0.34, explains={}, explains_by_equation={})
    first, second = write_headline(replace(unnamed, findings=(near,)))
    assert re.search(r"comes and goes with a period of 5\d\.\d min", first)
    assert first.endswith(f"the closest, {finding.closest}, explains 34 % of it.")
    assert "extended law" not in first + second
    nearly = replace(near, share=0.97)
    first, _ = write_headline(replace(unnamed, findings=(nearly,)))
    assert first.endswith(f"; {finding.closest} explains 97 % of it, but is less likely.")


def test_a_log_too_small_says_so_and_what_would_suffice(tiny):
    assert (tiny.verdict, tiny.p_value) == ("nothing wrong", 1.0)
    said = told(tiny)
    assert "too few traverses to test: 3 for the baseline's 3 parameters" in said
    assert "add 10 in the same sessions and directions" in said
    assert "repeats to" not in said
    assert set(tiny.untestable) == set(tiny.inclusion)


@pytest.mark.parametrize("rows", [1, 2, 5, 12])
def test_hardly_any_rows_are_no_error(table, read_table, rows):
    diagnosis = diagnose(read_table(table.head(rows), "few.csv"), gain=False)
    assert diagnosis.verdict == "nothing wrong"
    assert "too few traverses" in str(diagnosis)


@pytest.mark.slow
def test_as_many_traverses_as_it_asks_for_suffice(table, read_table):
    """Three groups of a session and direction with as many parameters as configurations, and 10 beyond."""
    upright = table[(table["joint"] == 3) & (table["direction"] == "+") & (table["session"] == "2012-03-05")]
    short = diagnose(read_table(upright.head(12), "short.csv"), gain=False)
    missing = int(re.search(r"add (\d+) in", told(short))[1])
    assert "too few" not in told(
        diagnose(read_table(upright.head(12 + missing), "enough.csv"), alpha=0.1, gain=False)
    )
    assert "too few" in told(diagnose(read_table(upright.head(11 + missing)), alpha=0.1, gain=False))


@pytest.mark.slow
def test_a_constant_column_is_not_testable_and_a_twin_is_told(table, read_table):
    rng = np.random.default_rng(3)
    draught = rng.normal(size=len(table))
    twins = table.assign(draught=draught, copy=5.0 - 3.0 * draught, bench=7.0, supply_V=230.0)
    found = diagnose(read_table(twins, "twins.csv"), alpha=ALPHA, gain=False)
    assert found.inclusion["covariate:bench"] is None
    assert found.inclusion["supply-voltage"] is None
    assert "the same within every session" in found.untestable["covariate:bench"]
    twin, alike = frozenset(("covariate:draught", "covariate:copy")), {*map(frozenset, found.aliased_causes)}
    assert twin in alike
    # Any function of the few loads of this log is a bend of the response to load.
    assert all("load-nonlinearity" in pair for pair in alike - {twin})
    assert re.search(
        r"Whatever covariate:\w+ would do in this log, covariate:\w+ could have done too", str(found)
    )


@pytest.mark.slow
def test_of_twins_either_may_be_to_blame(guide, read_table):
    draught = np.random.default_rng(3).normal(size=len(guide))
    twins = changed(guide, 0.01 * draught).assign(draught=draught, copy=5.0 - 3.0 * draught)
    found = diagnose(read_table(twins, "twins.csv"), alpha=ALPHA, gain=False)
    assert found.verdict == "cannot tell apart"
    blamed = {found.findings[0].cause, *found.findings[0].equivalent}
    assert blamed == {"covariate:draught", "covariate:copy"}
    way = {"covariate:draught": "falls", "covariate:copy": "rises"}[found.findings[0].cause]
    assert f"; beyond the law the step size {way} with {found.findings[0].cause[10:]}" in told(found)


def test_different_causes_are_not_alike(nothing):
    assert ("drift", "temperature") not in nothing.aliased_causes
    assert not any("load-hysteresis" in pair for pair in nothing.aliased_causes)


def test_no_line_is_wider_than_a_terminal(named, nothing, unnamed, tiny):
    for diagnosis in (replace(named, gain=GAIN), nothing, unnamed, tiny):
        assert max(map(len, str(diagnosis).splitlines())) <= WIDTH


@pytest.mark.parametrize("cause", library(), ids=lambda cause: cause.name)
def test_every_cause_of_the_library_has_a_sentence_of_its_own(cause):
    said = describe_effect(finding_of(cause, 0.02))
    assert not said.lower().startswith(f"{cause.phrase.lower()} (")
    assert re.search(r"\d", said)
    assert "nan" not in said
    assert remedy_for(finding_of(cause, 0.02)) or cause.name in ("recoil-axis", "recoil-shape")


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("thermal-warm-up", 0.031, "Steps grow by 3.1 %"),
        ("thermal-warm-up", -0.031, "Steps shrink by 3.1 %"),
        ("side-load", 0.02, "Joint 3's steps shrink by 2.0 %"),
        ("end-stop-latency", 25.0, "heard 25 steps late"),
        ("end-stop-latency", -25.0, "heard 25 steps early"),
        ("reversal-loss", 25.0, "25 steps are lost"),
        ("theta-offset", np.radians(-0.5), "tilted by −0.50 deg about x"),
        ("bearing-runout", -0.02, "vary by ± 2.0 % over a turn"),
        ("q1-gravity", 0.9, "90 % of what physics says"),
        ("wear", 0.01 / np.log(10), "grow by 1.0 % for every tenfold"),
        ("step-rate", -0.02 / np.log(2), "shrink by 2.0 % when the step period doubles"),
        ("inertia-quadratic", -0.1, "are 3.6 µrad off the line"),
        ("load-nonlinearity", 0.02, "by 2.0 % for 1 +, 2.0 % for 1 −, 2.0 % for 2 +"),
        ("payload-change", 10.0, "The effects of load grow by 1.0 %/g with the payload"),
        ("end-stop-misfire", 0.02, "one count in 50 is off by 2.0 % or so"),
    ],
)
def test_the_direction_of_an_effect_is_said_right(name, size, words):
    (cause,) = (each for each in library() if each.name == name)
    assert words in describe_effect(finding_of(cause, size))


def test_what_grows_in_one_direction_and_shrinks_in_the_other_changes():
    version = GuideGradient(by_direction=True)
    sizes = [SizedParameter("k", "%/mm", Interval(k, k - 1e-3, k + 1e-3), direction=way) for k, way in SLOPES]
    said = version.describe(sizes)
    assert "steps change by" in said
    assert re.search(r"−\S+ %/mm \(\+\) and 0\.18\S* %/mm \(−\)", said)
    alike = version.describe([replace(one, size=sizes[1].size) for one in sizes])
    assert "steps grow by" in alike
    assert "change" not in alike


@pytest.mark.parametrize("version", [SessionJump(session="Tuesday"), PayloadChange(session="Tuesday")])
def test_what_began_in_a_session_is_told_with_its_moment(version):
    assert "by 360,000 % 60 min into session Tuesday" in describe_effect(finding_of(version, 3600.0))


def test_a_cause_without_a_sentence_is_told_by_its_phrase(table, read_table):
    (subset,) = covariates(read_table(table.assign(gain=1.0), "gain.csv").rows)
    own = finding_of(subset, 0.02)
    # A finding of a covariate has no parameters.
    assert describe_effect(replace(own, parameters=())) == "Steps follow the column gain, by 1.0 % rms"
    assert remedy_for(own) == "keeping gain steady"
    foreign = replace(own, cause="moonlight", version=type("Moon", (), {"phrase": "the moon shines"})())
    assert describe_effect(foreign) == "The moon shines (f1 = 2.0 %, f2 = 2.0 %, f3 = 2.0 %)"


def test_a_parameter_that_is_not_known_leaves_the_sentence_true():
    (warm,) = (each for each in library() if each.name == "thermal-warm-up")
    finding = finding_of(warm, 0.02)
    assert (
        describe_effect(replace(finding, parameters=finding.parameters[:1]))
        == "The drive warms up (A = 2.0 %)"
    )


@pytest.mark.slow
def test_outliers_are_handed_back(guide, read_table):
    rng = np.random.default_rng(8)
    out = np.sort(rng.choice(len(guide), 3, replace=False))
    relative = np.zeros(len(guide))
    relative[out] = [0.09, -0.06, 0.12]
    found = diagnose(read_table(changed(guide, relative), "wild.csv"), alpha=ALPHA, gain=False)
    assert found.findings[0].cause == "end-stop-misfire"
    seen = found.findings[0].traverses
    assert sorted(seen["departure"]) == pytest.approx([-0.062, 0.086, 0.113], abs=0.012)
    assert set(seen["steps"]) == set(changed(guide, relative)["steps"].iloc[out])
    assert (
        "Remedy: repeating those traverses (the Student-t fit needs none excluded), which takes away"
        in told(found)
    )


@pytest.mark.slow
def test_repeating_outliers_is_not_credited_with_what_the_law_gains(guide, read_table):
    relative = 0.003 * hours_in(guide)
    relative[[40, 90]] += [0.2, -0.2]
    found = diagnose(read_table(changed(guide, relative), "wild drift.csv"), alpha=ALPHA, gain=False)
    assert [one.cause for one in found.findings] == ["end-stop-misfire", "drift"]
    first, second, third = write_headline(found)
    assert first.startswith("Steps shrink by ")
    assert second.startswith("Remedy: recalibrating within the session")
    assert re.match(r"Besides that: .* \(end-stop-misfire\)\.$", third)


@pytest.mark.slow
def test_a_jump_is_told_with_its_moment(table, read_table):
    jump = 0.015 * ((hours_in(table) > 4.0) & (table["session"] == "2012-03-06").to_numpy())
    found = diagnose(read_table(changed(table, -jump), "jump.csv"), alpha=ALPHA, gain=False)
    said = re.search(r"Steps grow by (\d\.\d+) % (\d+) min into session 2012-03-06, and stay so", told(found))
    assert said
    assert float(said[1]) == pytest.approx(1.5, abs=0.2)
    assert float(said[2]) == pytest.approx(240, abs=15)
    (moment,) = (each for each in found.findings[0].parameters if each.name == "moment")
    assert moment.size.low < 4 * 3600 < moment.size.high
    low, high = found.findings[0].effect.low, found.findings[0].effect.high
    assert 0 < low < found.findings[0].effect.estimate < high
