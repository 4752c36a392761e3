"""Published against physical laws, on logs made by friction, by the published laws."""

import json
from dataclasses import replace

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit.law_comparison import compare_laws
from stickslip_fit.laws import FRICTION_LIMITED
from tests.hidden.generate import hide
from tests.hidden.law_study import BENDS, judge_drive, true_share
from tests.hidden.reading import read_hidden
from tests.hidden.slip import Bristles
from tests.hidden.stage import GRAVITY, Stage, drive_stage


def read(hidden, keep):
    return read_hidden(replace(hidden, table=hidden.table[keep(hidden.table)]))


def guide(table):
    return table["joint"] == 3


# Design, seed, and the most that errors may be over the noise; with each of many sessions on its own, 1.155.
FRICTION_CASES = [("session", 3, 1.25), ("thesis", 4, 1.12), ("many", 6, 1.12)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "seed", "most", "bristles"),
    [
        (*FRICTION_CASES[1], None),
        (*FRICTION_CASES[0], Bristles()),
        *(pytest.param(*case, None, marks=pytest.mark.nightly) for case in FRICTION_CASES[::2]),
        *(pytest.param(*case, Bristles(), marks=pytest.mark.nightly) for case in FRICTION_CASES[1:]),
    ],
)
def test_friction_limited_logs_are_predicted_as_well_as_they_repeat(design, seed, most, bristles):
    hidden = drive_stage(design, Stage("friction", bristles), seed=seed)
    (joint,) = compare_laws(read(hidden, guide)).joints
    assert joint.errors.better == "physical"
    rows = hidden.campaign.plan.joint == 3
    noise = np.sqrt(np.mean(hidden.campaign.repeatability[rows] ** 2))
    # Parameters from the other configurations add their own error; 10 % of both over 60 traverses.
    assert joint.errors.physical.rms < most * noise
    assert joint.errors.published.rms > 3 * noise
    for regime in joint.regimes:
        assert regime.name == "friction-limited"
        assert regime.ratio[0] > 1.1
        assert np.isinf(regime.ratio[1])
        low, high = regime.share_interval
        assert low < true_share(hidden, regime.direction) < high


@pytest.mark.slow
def test_of_many_configurations_several_are_left_out_at_a_time(monkeypatch):
    log = read(drive_stage("session", Stage("friction", None), seed=3), guide)
    (one_by_one,) = compare_laws(log).joints
    monkeypatch.setattr("stickslip_fit.law_comparison.held_out.MAX_PARTS", 6)
    (in_parts,) = compare_laws(log).joints
    assert in_parts.errors.traverses == one_by_one.errors.traverses
    assert in_parts.errors.physical.rms != one_by_one.errors.physical.rms
    assert in_parts.errors.physical.rms == pytest.approx(one_by_one.errors.physical.rms, rel=0.3)


@pytest.mark.slow
def test_a_direction_of_one_configuration_is_left_out_with_it():
    def one_way(table):
        back, place = table["direction"] == "-", table[["q2_deg", "theta_deg", "psi_deg"]]
        same = (place == place[guide(table) & back].iloc[0]).all(axis=1)
        return guide(table) & (~back | same)

    log = read(drive_stage("thesis", Stage("friction", None), seed=4), one_way)
    (joint,) = compare_laws(log).joints
    assert 0 < joint.errors.traverses <= (log.usable["direction"] == "+").sum()


@pytest.mark.slow
@pytest.mark.parametrize("logs", [2, pytest.param(500, marks=pytest.mark.nightly)])
@pytest.mark.parametrize(("regime", "named"), [("friction", 0.9), ("velocity", 0.7)])
def test_the_regime_is_right_and_r_in_its_interval_whatever_the_friction(regime, named, logs):
    """Less two standard errors; where the slider catches up, small logs may say that they cannot tell."""
    judged = [
        each
        for seed in range(logs)
        for each in judge_drive(regime, None if seed % 2 else Bristles(BENDS[seed % 3]), seed)
    ]
    right, wrong, inside = np.mean(judged, axis=0)

    def margin(share):
        return 2 * np.sqrt(share * (1 - share) / (2 * logs))

    assert right > named - margin(named)
    assert wrong < 0.05 + margin(0.05)
    assert inside > 0.9 - margin(0.9)


def test_published_logs_go_to_the_published_law():
    comparison = compare_laws(read(hide("thesis", seed=2), guide))
    (joint,) = comparison.joints
    assert joint.errors.better == "published"
    assert joint.errors.published.rms < 1.25 * joint.replicate_scatter


@pytest.mark.slow
def test_a_log_of_three_configurations_cannot_tell_and_is_told_what_would():
    hidden = drive_stage("thesis", Stage("friction"), seed=1)

    def calibration(table):
        upright = (table["q2_deg"] == 0) & table["theta_deg"].isin([0, -90])
        level = (table["q2_deg"] == -90) & (table["theta_deg"] == 0)
        return guide(table) & (upright | level) & (table["psi_deg"] == 0)

    comparison = compare_laws(read(hidden, calibration))
    (joint,) = comparison.joints
    assert joint.errors.better == ""
    assert "cannot tell" in str(comparison)
    described = [experiment.description for experiment in joint.experiments]
    assert any("psi" in one for one in described)
    assert any("mass" in one for one in described)
    assert any("amplitude" in one for one in described)
    assert joint.experiments[0].traverses is not None


@pytest.mark.slow
def test_a_law_with_as_many_parameters_as_counts_is_neither_likely_nor_unlikely():
    """Joint 1 calibrated once: friction-limited steps have four parameters and pass through all counts."""
    hidden = drive_stage("session", Stage("friction"), seed=4)

    def calibration(table):
        base = table[(table["joint"] == 1) & (table["q2_deg"] == -90) & table["q3_mm"].isin([0, 12])]
        base = base[base["theta_deg"].isin([0, -90]) & (base["psi_deg"] == 0)]
        once = base.drop_duplicates(["q3_mm", "theta_deg", "direction"]).index
        return table.index.isin(once)

    log = read(hidden, calibration)
    assert len(log.usable) == 8
    (joint,) = compare_laws(log).joints
    assert joint.errors.better == ""
    for regime in joint.regimes:
        assert regime.name == "cannot tell"
        assert regime.ratio == (0.0, np.inf)
    assert ssf.physical_law(1, log.usable, log.machine).ratios == (FRICTION_LIMITED, FRICTION_LIMITED)


@pytest.mark.slow
def test_what_experiments_expect_is_what_happens():
    """Friction-limited steps shrink as mass grows."""
    hidden = drive_stage("session", Stage("friction"), seed=1)
    (joint,) = compare_laws(read(hidden, guide)).joints
    stage, (place,) = Stage("friction"), [p for p in hidden.campaign.places if p.joint == 3]
    unloaded = 0 * place.load
    pull = GRAVITY * unloaded
    step = stage.step(place, place.values["friction"], pull)
    heavier = stage.step(place, place.values["friction"] / 1.2, pull)
    np.testing.assert_allclose(heavier / step, 1 / 1.2, rtol=1e-9)
    expected = [one for one in joint.experiments if "mass" in one.description]
    assert all(one.friction_limited == pytest.approx(1 / 1.2) for one in expected)


@pytest.mark.slow
def test_saved_and_shown(tmp_path):
    comparison = ssf.compare_laws(read(hide("session", seed=2), guide))
    comparison.save(tmp_path / "laws.json")
    saved = json.loads((tmp_path / "laws.json").read_text("utf-8"))
    assert saved["joints"][0]["better"] == comparison.table["better"][0]
    assert {row["direction"] for row in saved["joints"][0]["regimes"]} == {"+", "-"}
    assert "Regimes" in comparison.summary().as_text(full=True)


@pytest.mark.slow
def test_every_estimator_takes_the_physical_law(tmp_path):
    hidden = drive_stage("session", Stage("friction"), seed=2)
    log = read(hidden, guide)
    laws = {3: ssf.physical_law}
    truth = np.array([true_share(hidden, "+"), true_share(hidden, "-")])
    for result in (
        ssf.fit(log, laws=laws),
        ssf.fit(log, "student-t", laws=laws),
        ssf.calibrate(log, laws=laws),
    ):
        fit = result.joints[3]
        assert fit.law.ratios == (FRICTION_LIMITED, FRICTION_LIMITED)
        error = np.sqrt(fit.covariance[:, 2, 2])
        assert np.all(np.abs(fit.values[:, 2] - truth) < 4 * error)
    result = ssf.fit(log, laws=laws)
    result.save(tmp_path / "fit.json")
    again = ssf.load_result(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.joints[3].values, result.joints[3].values)
