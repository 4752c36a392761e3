"""The three questions asked of logs: which readings, against which error, and what cannot be answered."""

import json
from collections import Counter

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from stickslip_fit.anova import analyze_variance, choose_all
from stickslip_fit.anova.analysis import RECORD_COLUMNS
from stickslip_fit.anova.contrasts import adjust_holm
from stickslip_fit.errors import InputError

DAYS = ("Mon", "Tue", "Wed", "Thu")
TURNS = (0.0, -30.0, -90.0)
DESIGN = {(d, s, t): 3 for d in DAYS for s in "+-" for t in TURNS}


@pytest.fixture
def told(log_of_readings, readings_of):
    """Records of a made-up log, by analysis, direction and session."""

    def make(design=DESIGN, shift=lambda *_: 0.0, **how):
        found = analyze_variance(log_of_readings(readings_of(design, shift, **how)))
        return {(r["analysis"], r["direction"], r["session"]): r for r in found.to_json()}, found

    return make


def steps_of(found):
    """Step sizes in nm by session, direction and orientation, out of the readings that were used."""
    rows = pd.concat([each.design.observations for each in found.factor_tests]).drop_duplicates(
        ["time", "direction"]
    )
    rows = rows.assign(nm=12e6 / rows["steps"], theta=np.degrees(rows["theta"]).round())
    return {key: part["nm"].to_numpy() for key, part in rows.groupby(["session", "direction", "theta"])}


def test_each_question_is_the_test_that_a_textbook_has_for_it(told):
    records, found = told(shift=lambda d, s, t: 8.0 * DAYS.index(d) + 6.0 * (s == "+"))
    nm = steps_of(found)
    by_day = stats.f_oneway(*(nm[d, "+", 0.0] for d in DAYS))
    day = records["day", "+", None]
    assert (day["F"], day["p_value"]) == pytest.approx((by_day.statistic, by_day.pvalue))
    assert (day["df"], day["error_term"]) == ([3, 8], "traverses within session")

    means = {key: values.mean() for key, values in nm.items()}
    paired = stats.ttest_rel([means[d, "+", 0.0] for d in DAYS], [means[d, "-", 0.0] for d in DAYS])
    over = records["direction", None, None]
    assert (over["F"], over["p_value"]) == pytest.approx((paired.statistic**2, paired.pvalue))
    assert (over["df"], over["error_term"]) == ([1, 3], "session x direction")
    assert (over["low"], over["high"]) == pytest.approx(paired.confidence_interval())
    assert over["levels"] == ["+", "-"]

    within = stats.ttest_ind(nm["Tue", "+", 0.0], nm["Tue", "-", 0.0])
    tuesday = records["direction", None, "Tue"]
    assert (tuesday["F"], tuesday["p_value"]) == pytest.approx((within.statistic**2, within.pvalue))

    table = np.array([[means[d, "-", t] for t in TURNS] for d in DAYS])
    centred = table - table.mean(axis=1, keepdims=True)
    between = 4 * np.sum(centred.mean(axis=0) ** 2) / 2
    error = np.sum((centred - centred.mean(axis=0)) ** 2) / 6
    turned = records["normal-force", "-", None]
    assert turned["F"] == pytest.approx(between / error)
    assert (turned["df"], turned["error_term"]) == ([2, 6], "session x orientation")


def test_what_was_put_in_comes_out_and_nothing_else(told):
    records, _ = told(shift=lambda d, s, t: 12.0 * DAYS.index(d) + 30.0 * (s == "-"), noise=1.5)
    assert records["day", "+", None]["levels"] == ["Thu", "Mon"]
    assert records["day", "+", None]["low"] < 36.0 < records["day", "+", None]["high"]
    assert records["direction", None, None]["levels"] == ["-", "+"]
    assert records["direction", None, None]["low"] < 30.0 < records["direction", None, None]["high"]
    assert records["direction", None, None]["difference"] == pytest.approx(30.0, abs=2.0)
    assert records.pop(("position", None, None))["F"] is None  # every traverse runs the whole travel
    absent = ("normal-force", "all traverses: configuration", "all traverses: day x direction")
    for (analysis, _, _), record in records.items():
        assert (record["p_holm"] < 0.05) == (analysis not in absent), record


@pytest.mark.slow
def test_a_rotation_that_matters_is_named_by_its_orientations(told):
    records, found = told(shift=lambda d, s, t: 15.0 * (t == -90.0))
    assert records["normal-force", "+", None]["p_holm"] < 0.05
    assert records["normal-force", "+", None]["levels"][0] == "theta -90 deg"
    assert "Turning the base about the joint's axis changes the step size" in " ".join(str(found).split())


def test_a_record_has_the_fields_that_were_agreed_and_json_has_no_nan(told):
    _, found = told()
    for record in found.to_json():
        assert tuple(record) == RECORD_COLUMNS
    again = json.loads(json.dumps(found.to_json(), allow_nan=False))
    made = len(found.factor_tests) + len(found.overall[0].tests)
    assert len(again) == made + len(found.not_testable)
    assert found.table["p_value"].notna().sum() == made


def test_p_values_are_adjusted_for_everything_that_was_asked(told):
    from statsmodels.stats.multitest import multipletests

    _, found = told()
    tests = [*found.factor_tests, *found.overall[0].tests]
    p = [each.p_value for each in tests]
    adjusted = multipletests(p, method="holm")[1]
    assert [each.p_holm for each in tests] == pytest.approx(adjusted)
    assert [each.p_value < each.level for each in tests] == [each.is_significant for each in tests]
    assert adjust_holm(p) == pytest.approx(adjusted)


def test_tables_add_up(told):
    _, found = told()
    for each in found.factor_tests:
        table = each.table.set_index("term")
        assert table.loc["total", "ss"] == pytest.approx(table["ss"].drop("total").sum(), rel=1e-12)
        assert table.loc["total", "df"] == table["df"].drop("total").sum()
        assert table.loc["total", "df"] == len(each.design.units) - 1


def test_the_load_along_the_axis_is_kept_out_of_the_normal_force(campaign, read_table):
    """Turning psi at q2 = -90 loads the joint: that is no rotation about its axis."""
    settings = tuple({"joint": 3, "q2_deg": -90.0, "psi_deg": psi} for psi in (-60.0, 0.0, 60.0))
    found = analyze_variance(read_table(campaign(settings=settings)))
    assert not [each for each in found.factor_tests if each.design.analysis == "normal-force"]
    (refused,) = [each for each in found.not_testable if each.analysis == "normal-force"]
    assert "rotation about the joint's axis" in refused.reason


@pytest.mark.slow
def test_all_joints_are_asked_at_a_stated_configuration_or_at_every_one(campaign, read_table):
    log = read_table(campaign(replicates=2))
    once = Counter((each.design.analysis, each.design.joint) for each in analyze_variance(log).factor_tests)
    assert {joint: once["day", joint] for joint in (1, 2, 3)} == {1: 2, 2: 2, 3: 2}
    all_over = analyze_variance(log, joint=2, choose=choose_all)
    places = {each.design.configuration for each in all_over.factor_tests if each.design.analysis == "day"}
    covered = log.configurations().query("joint == 2").drop_duplicates(["q1", "q3", "theta", "psi", "low"])
    assert len(places) == len(covered)


def test_one_joint_and_one_session_can_be_asked_alone(told, log_of_readings, readings_of):
    log = log_of_readings(readings_of(DESIGN))
    found = analyze_variance(log, joint=3, session="Tue")
    assert {each.design.session for each in found.factor_tests} == {"Tue"}
    assert {each.analysis for each in found.not_testable} == {"day", "position"}
    for wrong in ({"joint": 1}, {"session": "Sunday"}):
        with pytest.raises(InputError, match="no usable traverse of"):
            analyze_variance(log, **wrong)


POOR = {
    "one session": ({("Mon", s, t): 2 for s in "+-" for t in TURNS}, "day", "one session"),
    "one reading a session": ({(d, s, 0.0): 1 for d in DAYS for s in "+-"}, "day", "says nothing of scatter"),
    "one direction": ({(d, "+", 0.0): 2 for d in DAYS}, "direction", "in direction + only"),
    "one orientation": ({(d, s, 0.0): 2 for d in DAYS for s in "+-"}, "normal-force", "no session has two"),
    "directions on different days": (
        {("Mon", "+", 0.0): 2, ("Tue", "-", 0.0): 2},
        "direction",
        "no session has traverses of more than one direction",
    ),
    "orientations on different days": (
        {(d, s, t): 2 for d, t in zip(DAYS, TURNS, strict=False) for s in "+-"},
        "normal-force",
        "no session has two",
    ),
    "pairs of orientations never together": (
        {(d, "+", t): 2 for d, pair in (("Mon", (0.0, -30.0)), ("Tue", (-60.0, -90.0))) for t in pair},
        "normal-force",
        "never read in one session with the others",
    ),
}


@pytest.mark.parametrize("name", POOR)
def test_what_cannot_be_answered_is_refused_with_the_reason(told, name):
    design, analysis, reason = POOR[name]
    records, found = told(design)
    refused = [each.reason for each in found.not_testable if each.analysis == analysis]
    assert any(reason in each for each in refused)
    assert reason in " ".join(str(found).split())
    for record in records.values():
        assert (record["F"] is None) == (record["p_value"] is None) == (record["unit"] is None)


@pytest.mark.slow
def test_what_can_be_answered_still_is(told):
    one_each, _ = told({(d, s, 0.0): 1 for d in DAYS for s in "+-"}, lambda d, s, t: 20.0 * (s == "+"))
    assert one_each["direction", None, None]["p_value"] < 0.05
    assert one_each["direction", None, "Mon"]["p_value"] is None
    gap = ("Tue", "+", 0.0)
    alone, _ = told({(d, s, 0.0): 2 for d in DAYS for s in "+-" if (d, s, 0.0) != gap})
    assert alone["day", "+", None]["df"] == [2, 3]
    assert alone["direction", None, None]["df"] == [1, 2]
    turned, _ = told({cell: 2 for cell in DESIGN if cell != gap})
    assert turned["normal-force", "+", None]["df"] == [2, 5]


def test_readings_that_repeat_exactly_are_refused(told):
    records, found = told(noise=0.0, shift=lambda d, s, t: 10.0 * DAYS.index(d))
    assert not found.factor_tests
    assert all(record["F"] is None for record in records.values())
    assert any("no scatter at all" in each.reason for each in found.not_testable)


@pytest.mark.slow
def test_interrupted_and_excluded_traverses_are_left_out(log_of_readings, readings_of, tmp_path):
    log = log_of_readings(readings_of(DESIGN))
    spoilt = log.rows.assign(status="ok")
    spoilt.loc[spoilt.index[:2], "steps"] //= 2
    spoilt.loc[spoilt.index[:2], "status"] = ["interrupted", "excluded"]
    clean = log.select(~log.rows.index.isin(spoilt.index[:2]))
    from dataclasses import replace

    ours, theirs = analyze_variance(replace(log, rows=spoilt)), analyze_variance(clean)
    assert [each.statistic for each in ours.factor_tests] == [each.statistic for each in theirs.factor_tests]


def test_the_order_of_sessions_and_their_names_do_not_matter(log_of_readings, readings_of):
    readings = readings_of(DESIGN, lambda d, s, t: 8.0 * DAYS.index(d))
    strange = {"Mon": "001", "Tue": "NA", "Wed": "$x$ -", "Thu": "ü"}
    plain = analyze_variance(log_of_readings(readings)).factor_tests
    renamed = analyze_variance(log_of_readings([(strange[d], *rest) for d, *rest in readings])).factor_tests
    assert [each.statistic for each in plain] == pytest.approx([each.statistic for each in renamed])
    assert {strange[level] for level in plain[0].extreme_levels} == set(renamed[0].extreme_levels)
