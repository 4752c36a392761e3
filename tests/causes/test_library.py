"""The library as a diagnosis uses it: what it tries in a log, and why some causes cannot be tried."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit import causes
from stickslip_fit.causes import covariates, explain_missing, extend, library
from stickslip_fit.causes.parameters import candidate_moments
from stickslip_fit.laws import ConstantStep
from stickslip_fit.logs import Log
from stickslip_fit.machine import load_machine
from stickslip_fit.units import UNITS
from tests.causes.table import LAWS, MACHINE, NAMED, own_values


@pytest.fixture(scope="module")
def log(campaign: Callable[..., pd.DataFrame], read_table: Callable[..., Log]) -> Log:
    """Two sessions with everything in them that a cause may ask for."""
    table = campaign(directions=("-", "+", "+"), replicates=1)
    rng = np.random.default_rng(3)
    n = len(table)
    table["q1_deg"] = rng.choice([-60.0, 0.0, 45.0], n)
    table["temperature_C"] = rng.normal(20, 1, n)
    table["humidity_pct"] = rng.normal(40, 5, n)
    table["supply_V"] = rng.normal(150, 1, n)
    table["step_period_ms"] = rng.choice([5, 10, 20], n)
    table["payload_g"] = rng.choice([0, 5], n)
    table["pressure"] = rng.normal(1013, 5, n)
    part = (table["joint"] == 3) & (np.arange(n) % 3 == 0)
    table.loc[part, ["from_mm", "to_mm"]] = table.loc[part, ["from_mm", "to_mm"]] / 2
    return read_table(table)


ALL = [cause.name for cause in library()] + ["covariate:pressure"]


def named(name, rows):
    (cause,) = (each for each in (*library(), *covariates(rows)) if each.name == name)
    return cause


def changes(version, trials, rows):
    found = np.zeros((len(rows), len(trials)))
    for joint in version.joints:
        subset = (rows["joint"] == joint).to_numpy()
        values = own_values(rows[subset])
        found[subset] = version.changes(LAWS[joint], rows[subset], values, trials)
    return found


def test_names_are_unique_and_every_cause_explains_itself():
    assert len({cause.name for cause in library()}) == len(library())
    for cause in library():
        assert cause.phrase
        assert cause.physics.endswith(".")
        assert cause.shows_best
        assert len(cause.parameters) == len(cause.null_values) == len(cause.scale)
        assert all(parameter.unit in UNITS for parameter in cause.parameters)


@pytest.mark.parametrize("name", ALL)
def test_nothing_is_missing_in_a_log_that_has_everything(name, log):
    assert named(name, log.rows).explain_missing(log.rows) is None


@pytest.mark.parametrize("name", [name for name in ALL if name != "end-stop-misfire"])
def test_trials_move_some_count_by_an_amount_that_a_lab_may_meet(name, log):
    rows = log.rows
    versions = named(name, rows).bind(rows, MACHINE).trials(rows)
    assert versions
    for version, trials in versions:
        assert trials.shape[1] == len(version.parameters) == len(version.scale)
        found = changes(version, trials, rows)
        assert np.isfinite(found).all()
        largest = np.abs(found).max(axis=0)
        assert np.all(largest < 0.7)
        # Of trials in combination one may show nothing: traverses of the whole range average a cosine out.
        assert (largest > 1e-6).any() if version.combine_trials else (largest > 1e-6).all()
        low = [parameter.lower for parameter in version.parameters]
        high = [parameter.upper for parameter in version.parameters]
        assert np.all((trials >= low) & (trials <= high))


STAGES = """[[joint]]
kind = "rotary"
range_deg = [0.0, 340.0]
[[joint]]
kind = "prismatic"
range_mm = [-20.0, 40.0]
[[joint]]
kind = "prismatic"
range_mm = [2.0, 5.0]
"""


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    path = tmp_path_factory.mktemp("stages") / "stages.toml"
    path.write_text(STAGES, encoding="utf-8")
    return load_machine(path)


@pytest.mark.parametrize(
    ("name", "joints"),
    [("worn-spot", [(2,), (3,)]), ("guide-gradient", [(2, 3), (2,), (3,)]), ("bearing-runout", [(1,)])],
)
def test_a_profile_is_looked_for_on_each_joint_of_its_kind_over_its_own_range(name, joints, log, stages):
    """Of any machine; a worn spot is as wide and as far as the guide is long."""
    rows = log.rows.copy()
    ends = np.array([stages.ranges[joint] for joint in rows["joint"]])
    rows[["start", "stop"]] = ends[:, :1] + np.diff(ends) * np.random.default_rng(1).random((len(rows), 2))
    assert explain_missing(named(name, rows), rows, stages) is None
    bound = named(name, rows).bind(rows, stages)
    found = {}
    for version, trials in bound.trials(rows):
        own = tuple(joint for joint, _, _ in version.ranges)
        found.setdefault(own, []).append(trials)
        assert [version.acts_on(ConstantStep(one, prismatic=one > 1)) for one in (1, 2, 3)] == [
            one in own for one in (1, 2, 3)
        ]
        for joint in own:
            law = extend(ConstantStep(joint, prismatic=joint > 1), version)
            low, high = stages.ranges[joint]
            row, places = pd.DataFrame({"start": [low], "stop": [high]}), np.linspace(low, high, 2001)[None]
            factors = [law.step_size(row, places, np.append(1.0, values)[None])[0] for values in trials]
            assert 0.001 < np.ptp(factors, axis=1).max() < 0.06
            if name == "worn-spot" and not version.place:  # spots side by side leave out no place
                assert np.all(np.max(np.abs(np.array(factors) - 1.0), axis=0)[100:-100] > 0.01)
    assert sorted(found) == sorted(joints)


@pytest.mark.parametrize("name", [name for name in ALL if name != "end-stop-misfire"])
def test_largest_plausible_sizes_are_no_less_than_a_trial_and_leave_the_joints_running(name, log):
    cause = named(name, log.rows).bind(log.rows, MACHINE)
    if cause.largest_plausible():
        found = changes(cause, np.array(cause.largest_plausible()), log.rows)
        ((version, trials), *_) = cause.trials(log.rows)
    else:
        version, trials = cause.trials(log.rows)[0]
        found = changes(
            version, trials * np.r_[cause.max_trial_factor, np.ones(trials.shape[1] - 1)], log.rows
        )
    assert np.isfinite(found).all()
    ordinary = np.sqrt((changes(version, trials, log.rows) ** 2).sum(axis=0)).max()
    assert np.sqrt((found**2).sum(axis=0)).max() > 0.999 * ordinary


@pytest.mark.slow
def test_all_trials_of_a_log_take_a_fraction_of_a_second(log):
    from time import process_time

    rows, begin = log.rows, process_time()
    for cause in (*library(), *covariates(rows)):
        for version, trials in cause.bind(rows, MACHINE).trials(rows):
            changes(version, trials, rows)
    assert process_time() - begin < 3.0


@pytest.mark.parametrize(
    ("name", "spoil", "reason"),
    [
        ("temperature", {"temperature": np.nan}, "the log has no ambient temperature"),
        ("humidity", {"humidity": 0.4}, "the same within every session"),
        ("supply-voltage", {"supply": np.nan}, "the log has no supply voltage"),
        ("step-rate", {"step_period": 0.01}, "the same within every session"),
        ("covariate:pressure", {"covariate:pressure": 1013.0}, "column pressure is the same within"),
        ("q1-gravity", {"q1": 0.0}, "at q1 = 0"),
        ("guide-gradient", {"start": 0.0, "stop": 0.012}, "runs the whole guide"),
        ("worn-spot", {"start": 0.012, "stop": 0.0}, "runs the whole guide"),
        ("inertia-quadratic", {"q3": 0.0}, "fewer than three positions of joint 3"),
        ("reversal-loss", {"before_direction": ""}, "no traverse follows one in the other direction"),
        ("side-load", {"joint": 2}, "no traverse of joint 3"),
        ("cable-torque", {"joint": 3}, "no traverse of joint 1 or 2"),
        ("recoil-axis", {"joint": 1}, "no traverse of joint 3"),
    ],
)
def test_a_log_that_cannot_show_a_cause_says_why(name, spoil, reason, log):
    rows = log.rows.assign(**spoil)
    assert reason in named(name, log.rows).explain_missing(rows)


def test_where_every_traverse_is_a_reversal_nothing_tells_the_loss_from_a_latency(log):
    rows = log.rows[log.rows["before_direction"] != ""]
    turned = np.where(rows["direction"] == "+", "-", "+")
    assert "every traverse follows" in named("reversal-loss", rows).explain_missing(
        rows.assign(before_direction=turned)
    )


def test_a_column_that_differs_between_sessions_only_is_recalibrated_away(log):
    by_session = log.rows.groupby(log.rows["session"].astype(str))["temperature"].transform("mean")
    rows = log.rows.assign(temperature=by_session)
    assert "each session is calibrated by itself" in named("temperature", rows).explain_missing(rows)


def test_moments_lie_between_the_traverses_of_each_session(log):
    rows = log.rows
    found = candidate_moments(rows)
    assert [session for session, _ in found] == list(rows["session"].astype(str).unique())
    for session, when in found:
        seconds = rows.loc[rows["session"].astype(str) == session, "session_seconds"].to_numpy()
        before = np.array([(seconds < moment).sum() for moment in when])
        assert not np.isin(when, seconds).any()
        assert before.min() >= 3
        assert (len(seconds) - before).min() >= 3
        assert len(set(before)) == len(before)


def test_a_version_of_a_session_is_tried_in_that_session_only(log):
    rows = log.rows
    session = str(rows["session"].iloc[-1])
    for name in ("session-jump", "payload-change"):
        versions = [version for version, _ in named(name, rows).trials(rows)]
        assert len({version.session for version in versions}) == len(versions)
        (chosen,) = (version for version in versions if version.session == session)
        assert [version.session for version, _ in chosen.trials(rows)] == [session]


def test_misfires_are_as_frequent_and_as_large_as_their_parameters_say():
    cause, n = named("end-stop-misfire", pd.DataFrame()), 200_000
    found = cause.misfire_deviations(np.array([[0.02, 0.05]] * n), np.random.default_rng(1).random((n, 3)))
    hit = found != 0
    assert hit.mean() == pytest.approx(0.02, rel=0.05)
    assert np.abs(found[hit]).mean() == pytest.approx(0.05, rel=0.01)
    assert (found[hit] > 0).mean() == pytest.approx(0.5, abs=0.03)


class Ageing(type(NAMED["drift"].cause)):
    """A lab's own cause, in a package of its own."""

    name = "ageing"


def install(monkeypatch, *loaders):
    """As if packages were installed whose entry points are loaded by these functions."""

    def entry_points(group):
        assert group == "stickslip_fit.causes"
        return [SimpleNamespace(value=f"lab.causes:{loader.__name__}", load=loader) for loader in loaders]

    monkeypatch.setattr(causes.registry, "entry_points", entry_points)


@pytest.mark.parametrize("loaded", [Ageing(), Ageing])
def test_an_installed_package_adds_its_causes_by_entry_point(loaded, monkeypatch):
    own = library()
    install(monkeypatch, lambda: loaded)
    assert [cause.name for cause in library()] == [*(cause.name for cause in own), "ageing"]


def missing():
    raise ModuleNotFoundError("No module named 'lab'")


def ending():
    raise SystemExit(3)


def number():
    return lambda: 5


def duplicate():
    return NAMED["drift"].cause


def incomplete():
    return causes.Cause


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (missing, "No module named 'lab'"),
        (ending, "3"),
        (number, "it is no Cause but int"),
        (duplicate, "there is a cause 'drift' already"),
        (incomplete, "no attribute 'name'"),
    ],
)
def test_a_broken_cause_of_an_installed_package_is_named_and_left_out(broken, reason, monkeypatch):
    own = library()
    install(monkeypatch, broken, lambda: Ageing)
    with pytest.warns(UserWarning, match=f"lab.causes:{broken.__name__} .* left out: .*{reason}"):
        kept = library()
    assert [cause.name for cause in kept] == [*(cause.name for cause in own), "ageing"]
