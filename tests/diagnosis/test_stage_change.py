"""Which change of the stage a finding stands for: friction's own generator, and the closed form of a step."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

import stickslip_fit as ssf
from stickslip_fit.causes import PayloadChange, SessionJump, Wear
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis._stage_summary import describe_reading, stage_sections
from stickslip_fit.diagnosis.extension import open_changes
from stickslip_fit.diagnosis.hypotheses import compute_changes, make_hypothesis
from stickslip_fit.diagnosis.stage_change import (
    StageChange,
    StageReading,
    _combine,
    choose_laws_anew,
    order_changes,
    read_stage,
)
from stickslip_fit.diagnosis.stage_fingerprint import CHANGES, StageEffects, fit_changes
from stickslip_fit.laws.physical import PhysicalElbow, PhysicalPrismatic
from stickslip_fit.step import step_size
from stickslip_fit.units import Interval
from tests.hidden.stage import Stage, drive_stage

GRAVITY = 9.80665
# Of a stage: friction over mass, ramp time, travel of the foot.
FRICTION, RAMP = 45.0, 1.45e-4


@pytest.mark.parametrize("throw_ratio", [0.5, 2.5])
@pytest.mark.parametrize(
    ("quantity", "factors"),
    [("friction", (1.1, 1.0, 1.0)), ("ramp time", (1.0, 1.1, 1.0)), ("voltage", (1.0, 1.0, 1.1))],
)
def test_a_change_does_to_counts_what_the_closed_form_says(throw_ratio, quantity, factors):
    load = np.array([-1.0, -0.4, 0.0, 0.7, 1.0])
    throw = throw_ratio * FRICTION * RAMP**2
    before = step_size(FRICTION, RAMP, throw, GRAVITY * load)
    friction, ramp, amplitude = np.array([FRICTION, RAMP, throw]) * factors
    after = step_size(friction, ramp, amplitude, GRAVITY * load)
    rows = pd.DataFrame(
        {"q2": -np.pi / 2, "theta": np.arccos(load), "psi": -np.pi / 2, "start": 0.0, "stop": 0.012},
        index=range(len(load)),
    )
    unloaded = FRICTION * RAMP**2 * min(throw_ratio, 1.0)
    law = PhysicalPrismatic((throw_ratio, throw_ratio))
    values = np.tile([unloaded, 0.0, GRAVITY / FRICTION], (len(load), 1))
    effects = StageEffects(law, rows, values[None], np.array([throw_ratio]))
    assert effects.unchanged[0] == pytest.approx(np.log(0.012 / before), rel=1e-12)
    kind, size = np.array([CHANGES.index(quantity)]), np.array([[np.log(1.1), 0.0]])
    (change,) = effects.by(kind, np.array([0]), size, np.ones(len(load)))
    assert change == pytest.approx(np.log(before / after), abs=1e-12)


def test_a_change_that_takes_some_loads_into_the_other_regime_is_found():
    """A ramp 10 % longer: lambda falls from 1.375 to 1.136, and under some loads the slider catches up."""
    n, rng, noise = 40, np.random.default_rng(1), 0.003
    load, late = np.tile(np.linspace(-1.0, 1.0, n // 2), 2), np.arange(n) >= n // 2
    throw, ramp = 1.375 * FRICTION * RAMP**2, np.where(late, 1.1, 1.0) * RAMP
    steps = 0.012 / step_size(np.full(n, FRICTION), ramp, np.full(n, throw), GRAVITY * load)
    response = np.log(steps) + noise * rng.standard_normal(n)
    rows = pd.DataFrame(
        {"session": "1", "joint": 3, "direction": "+", "q2": -np.pi / 2, "psi": -np.pi / 2}
        | {
            "theta": np.arccos(load),
            "start": 0.0,
            "stop": 0.012,
            "steps": np.exp(response),
            "check_every": 5,
        },
        index=range(n),
    )
    jump = np.where(late, response[late].mean() - response[~late].mean(), 0.0)
    scale, course = np.full(n, noise), late.astype(float)
    found = fit_changes(3, "+", rows, ssf.load_machine(), response, jump, scale, course)
    best, ratio = min(
        zip(found.fits, found.ratios, strict=True), key=lambda one: one[0]["ramp time"].deviance
    )
    assert ratio == pytest.approx(1.375, abs=0.03)
    assert best["ramp time"].deviance < chi2.ppf(0.999, n - 4)
    assert np.exp(best["ramp time"].size[0]) == pytest.approx(1.1, abs=0.005)
    assert min(fits["friction"].deviance for fits in found.fits) > best["ramp time"].deviance + 30


@pytest.mark.slow
def test_laws_of_more_parameters_are_no_likelier_for_them(read_table):
    """Joint 2's friction-limited law has an inertia in every session, its velocity-limited one none."""
    hidden = drive_stage("many", Stage("velocity"), "friction:humidity", 0.1, seed=16049)
    log = read_table(hidden.table[hidden.table["joint"] == 2], "many.csv")
    limited = []
    for way in "+-":
        rows = log.usable[log.usable["direction"] == way].reset_index(drop=True)
        course = rows["humidity"].to_numpy() - rows["humidity"].mean()
        data = np.log(rows["steps"].to_numpy(float)), 0.0 * course, np.full(len(rows), 0.003)
        found = fit_changes(2, way, rows, log.machine, *data, course / np.abs(course).max())
        limited.append(_combine(("humidity",), [found], ()).fingerprint["friction_limited"][0])
    assert max(limited) < 0.05


CASES = {  # change: quantities that it may be, what it is called; rates are in tests/hidden
    ("friction", "preload"): ({"friction", "mass"}, 0.1),
    ("friction", "ramp-time"): ({"ramp time"}, 0.1),
    ("friction", "wear"): ({"friction", "mass"}, 0.065),  # joint 3 makes fewer steps than the others
    ("velocity", "voltage"): ({"voltage"}, 0.1),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("regime", "change"),
    [
        pytest.param(*one, marks=[pytest.mark.nightly] if one[1] in ("preload", "ramp-time") else [])
        for one in CASES
    ],
)
def test_a_hidden_change_of_a_stage_is_read(read_table, regime, change):
    expected, size = CASES[regime, change]
    table = drive_stage("session", Stage(regime), change, 0.1, seed=1).table
    log = read_table(table[table["joint"] == 3], "stage.csv")
    causes = [Wear()] if change == "wear" else [SessionJump(), PayloadChange()]
    found = diagnose(log, laws={3: ssf.physical_law}, causes=causes, gain=False)
    (reading,) = read_stage(found.selection, found.findings, log.machine)
    assert reading.suffices
    assert reading.regime == f"{regime}-limited"
    assert {one.quantity for one in reading.credible} <= expected
    first = "friction" if "friction" in expected else next(iter(expected))
    (read_size,) = (one.size for one in reading.credible if one.quantity == first)
    error = (read_size.high - read_size.low) / 3.92
    assert read_size.estimate == pytest.approx(size, abs=4 * error)


@pytest.mark.slow
def test_a_log_of_the_published_law_has_no_change_of_a_stage(campaign, read_table):
    """Its response to load is straight: the physical law does not describe joint 3."""
    table = campaign(("2012-03-05", "2012-03-06"), replicates=2)
    late = (table["session"] == "2012-03-06") & (np.arange(len(table)) > 0.75 * len(table))
    table.loc[late, "steps"] = (table.loc[late, "steps"] / 1.05 / 5).round().astype(int) * 5
    log = read_table(table[table["joint"] == 3], "published.csv")
    found = diagnose(log, causes=[SessionJump()], gain=False)
    assert [one.cause for one in found.findings] == ["session-jump"]
    assert read_stage(found.selection, found.findings, log.machine) == ()


@pytest.fixture(scope="module")
def elbow(tmp_path_factory):
    """Joint 2's traverses of a stage whose preload changed, diagnosed."""
    hidden = drive_stage("session", Stage("friction"), "preload", 0.1, seed=1)
    path = tmp_path_factory.mktemp("elbow") / "elbow.csv"
    hidden.table[hidden.table["joint"] == 2].to_csv(path, index=False)
    found = diagnose(ssf.read_log(path), laws={2: ssf.physical_law}, causes=[SessionJump()], gain=False)
    assert [one.cause for one in found.findings][:1] == ["session-jump"]
    return found


@pytest.mark.slow
def test_a_law_is_chosen_anew_only_where_it_becomes_another(elbow):
    """A choice that stays the same is no reason to search again, nor is one that the log leaves open."""
    found, machine = elbow, elbow.log.machine
    chosen = partial(choose_laws_anew, found.log, found.selection)
    assert chosen(None) is None
    assert chosen({2: found.selection.problem.parts[0].law}) is None
    assert chosen({2: lambda joint, rows, machine: PhysicalElbow(machine)}) is None
    other = {2: lambda joint, rows, machine: PhysicalElbow(machine, (0.8, 0.8))}
    assert chosen(other)[2].ratios == (0.8, 0.8)
    open_law = PhysicalElbow(machine, (0.8, 0.8))
    for highest, is_same in ((10.0, True), (0.9, False)):
        open_law.plausible = (0.5, highest), (0.5, highest)
        assert (chosen({2: open_law}) is None) == is_same


@pytest.mark.slow
def test_what_lambda_leaves_open_of_a_cause_is_no_second_finding(elbow):
    """In each direction by itself; what the cause does in the other regime is in the span of what is open."""
    linearized, (one, *_) = elbow.selection.problem.linearize(), elbow.selection.law_causes
    own = replace(one.version, form="friction", assumed=())
    versions, values = [own, replace(own, assumed=((2, 0.4, 0.4),))], one.start
    effects = [linearized.whiten(compute_changes(linearized, version, values[None])) for version in versions]
    shapes = [
        make_hypothesis(own.name, version, values, linearized.project(effect))
        for version, effect in zip(versions, effects, strict=True)
    ]
    difference = effects[1] - effects[0]
    assert np.linalg.norm(difference) > 10
    for known, is_open in ((shapes, True), (shapes[:1], False)):
        selected = replace(one, version=own, misfit=replace(one.misfit, hypotheses=tuple(known)))
        basis = open_changes(linearized, selected)
        for sign in (1.0, -1.0):
            column = np.where(linearized.direction_sign[:, None] == sign, difference, 0.0)
            left = np.linalg.norm(column - basis @ (basis.T @ column))
            assert (left < 1e-6) == is_open


@pytest.mark.slow
def test_the_headline_says_that_one_change_explains_several_findings(elbow):
    one = replace(reading(("friction", 0.5, 0.1), ("mass", 0.5, -0.09)), causes=("session-jump", "wear"))
    said = (
        "One change of the stage explains session-jump and wear together, so that there is one fault to look "
        "for: where it acts most, 10.0 % more friction or preload or 9.0 % less moving mass "
        "(friction-limited steps)."
    )
    assert describe_reading(one, intervals=False) == said
    assert said in replace(elbow, stage=(one,)).summary().headline
    assert said not in replace(elbow, stage=(replace(one, p_value=1e-4),)).summary().headline
    unsure = replace(one, changes=(StageChange("voltage", 1.0, Interval(0.01, -0.2, 0.3)),))
    assert "voltage" not in replace(elbow, stage=(unsure,)).summary().headline


def reading(*changes, p_value=0.5, limited=(1.0, 1.0)):
    sized = tuple(
        StageChange(quantity, share, Interval(size, size - 0.01, size + 0.01))
        for quantity, share, size in changes
    )
    table = pd.DataFrame({"joint": 3, "direction": ["+", "-"], "friction_limited": limited})
    table = table.assign(unloaded=0.1, unloaded_error=0.01, response=0.0, response_error=[0.02, 9.0])
    return StageReading(("wear",), sized, table, p_value)


def test_the_set_is_the_smallest_that_holds_the_change_and_never_parts_equals():
    told = reading(("friction", 0.49, 0.1), ("mass", 0.49, -0.09), ("ramp time", 0.02, 0.05))
    assert [one.quantity for one in told.credible] == ["friction", "mass"]
    assert [one.quantity for one in reading(("voltage", 0.97, 0.1), ("mass", 0.03, 0.1)).credible] == [
        "voltage"
    ]
    assert reading(("voltage", 1.0, 0.1), p_value=1e-4).credible == ()


def test_friction_and_mass_count_together_against_ramp_time():
    changes = [
        StageChange(name, p, Interval(0.1, 0.09, 0.11))
        for name, p in (("ramp time", 0.36), ("mass", 0.32), ("voltage", 0.0), ("friction", 0.32))
    ]
    assert [one.quantity for one in order_changes(changes)] == ["mass", "friction", "ramp time", "voltage"]


def test_what_is_said_of_a_change():
    told = reading(("friction", 0.5, 0.1), ("mass", 0.5, -0.09))
    assert describe_reading(told) == (
        "As a change of the stage, wear would be, where it acts most: 10.0 % (9.0 to 11.0 %) more friction "
        "or preload or 9.0 % (8.0 to 10.0 %) less moving mass (friction-limited steps). Counts cannot tell "
        "friction from mass."
    )
    assert "friction-limited" not in describe_reading(reading(("voltage", 1.0, 0.1), limited=(1.0, 0.6)))
    assert "acts as no single change" in describe_reading(reading(("voltage", 1.0, 0.1), p_value=1e-4))
    both = reading(("friction", 0.3, 0.1), ("mass", 0.3, -0.09), ("ramp time", 0.4, 0.1), limited=(0.0, 0.0))
    assert "Friction and ramp time cannot be told apart in this log" in describe_reading(both)
    uneven = reading(("friction", 0.47, 0.1), ("mass", 0.47, -0.09), ("ramp time", 0.06, 0.1))
    assert "cannot tell which of them: friction 47 %, mass 47 %, ramp time 6 %" in describe_reading(uneven)
    ((section,), nothing) = stage_sections([told]), stage_sections([])
    assert nothing == ()
    assert [row[1:3] for row in section.tables[0].rows] == [("10.0 ± 1.0", "0.0 ± 2.0"), ("10.0 ± 1.0", "–")]
