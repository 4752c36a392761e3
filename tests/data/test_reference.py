from pathlib import Path

import pytest

from stickslip_fit.laws import published_law
from stickslip_fit.logs import read_log, write_log
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values, simulate

REFERENCE = Path(__file__).parents[2] / "data" / "reference"


@pytest.fixture(scope="module")
def log():
    return read_log(REFERENCE / "campaign.csv")


def test_the_campaign_is_what_its_plan_and_law_make(tmp_path):
    machine = load_machine()
    plan = read_plan(REFERENCE / "plan.toml", machine)
    write_log(
        simulate(plan, read_law_values(REFERENCE / "law.toml", machine), machine), tmp_path / "again.csv"
    )
    assert (tmp_path / "again.csv").read_bytes() == (REFERENCE / "campaign.csv").read_bytes()


def test_it_says_first_that_it_is_simulated():
    assert (REFERENCE / "README.md").read_text().startswith("SIMULATED")


def test_it_holds_three_sessions_of_all_joints_in_both_directions_with_replicates(log):
    assert log.sessions == ("2012-03-05", "2012-03-06", "2012-03-07")
    assert log.joints == (1, 2, 3)
    assert (log.rows.groupby(["session", "joint", "direction"]).size().unstack().nunique(axis=1) == 1).all()
    place = ["session", "joint", "direction", "q1", "q2", "q3", "theta", "psi", "start", "stop"]
    quick = (log.rows["stop"] - log.rows["start"]).abs() < 1.0
    assert (log.rows[quick].groupby(place, dropna=False).size() >= 2).all()


def test_every_session_calibrates_every_law(log):
    for joint in log.joints:
        rows = log.rows[log.rows["joint"] == joint]
        for wanted in published_law(joint, rows, log.machine).calibration():
            here = abs(abs(rows["stop"] - rows["start"]) - log.machine.span(joint)) < 1e-9
            for name in {"q1", "q2", "q3", "theta", "psi"} - {f"q{joint}"}:
                here &= abs(rows[name] - getattr(wanted, name)) < 1e-9
            assert (rows[here].groupby(["session", "direction"]).size() >= 2).sum() == 6, wanted.label


def test_calibration_comes_first_in_each_session(log):
    for _, rows in log.rows.groupby("session"):
        assert list(rows["joint"][:44]) == [3] * 12 + [2] * 16 + [1] * 16
