"""The verb `plan`: after a log, and before any."""

import json
from pathlib import Path

import pytest

from tests.hidden.generate import hide
from tests.simulation.conftest import LAW

PLAN = """
name = "three loads"
replicates = 3
order = "random"
[sessions]
dates = [2012-03-05]
{noise}
[[sweep]]
joint = 3
q2_deg = -90
psi_deg = [-60, 0, 60]
[[sweep]]
joint = 3
q2_deg = 0
theta_deg = [-90, 0]
"""
NOISE = "[noise]\nrepeatability_pct = 0.3"


@pytest.fixture
def plan(tmp_path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN.format(noise=NOISE), "utf-8")
    return path


@pytest.fixture
def log(tmp_path) -> Path:
    path = tmp_path / "log.csv"
    hide("session", (), seed=3).write(path)
    return path


@pytest.mark.slow
def test_a_plan_is_told_what_it_could_show_confuse_and_not_see(run, plan, tmp_path):
    saved, chart = tmp_path / "out.json", tmp_path / "out.png"
    status, out, _ = run("plan", plan, "--alpha", 0.05, "--json", saved, "--chart", chart, "--full")
    assert status == 0
    answer, _, *tables = out.split("\n\n")
    assert answer.startswith("three loads: 30 traverses in 1 session could show ")
    assert "drift" in tables[1]
    assert "wear" in tables[1]
    assert "every prismatic traverse runs the whole guide" in out
    assert chart.read_bytes().startswith(b"\x89PNG")
    content = json.loads(saved.read_text("utf-8"))
    told = {frozenset(pair["causes"]): pair for pair in content["pairs"]}
    hard = told[frozenset(["drift", "wear"])]
    assert hard["confusion"] > 0.3
    assert not hard["told_apart"]
    assert "temperature" in {each["cause"] for each in content["untestable"]}
    drift = next(each for each in content["causes"] if each["cause"] == "drift")
    assert drift["unit"] == "%/h"
    assert drift["smallest_found"] == pytest.approx(drift["strength_found"] / drift["strength_of_size_1"])


@pytest.mark.slow
def test_a_law_of_ones_own_serves_as_well(run, plan, tmp_path):
    law = tmp_path / "law.toml"
    law.write_text(LAW.format(day_to_day=0), "utf-8")
    status, out, _ = run("plan", plan, "--law", law, "--alpha", 0.05)
    assert status == 0
    assert out.startswith("three loads")


@pytest.mark.slow
def test_a_log_in_which_nothing_is_wrong_is_told_what_it_could_not_have_seen(run, log, tmp_path):
    saved = tmp_path / "next.json"
    status, out, _ = run("plan", log, "--alpha", 0.01, "--json", saved)
    assert status == 0
    assert out.startswith("Nothing is wrong that this log could show.")
    content = json.loads(saved.read_text("utf-8"))
    assert content["verdict"] == "nothing wrong"
    assert content["next_experiment"] == []
    missed = {each["cause"]: each for each in content["untestable"]}
    turned = missed["q1-gravity"]["traverse"]
    assert turned["q1_deg"] == pytest.approx(90.0)
    assert turned["session"] == "new"
    assert (missed["worn-spot"]["traverse"]["from"] is None) == (
        missed["worn-spot"]["traverse"]["to"] is None
    )
    assert missed["humidity"]["traverse"] is None


@pytest.mark.slow
def test_a_log_that_is_too_small_is_told_what_would_do(run, tmp_path):
    path = tmp_path / "few.csv"
    hide("session", (), seed=3).table.head(6).to_csv(path, index=False)
    status, out, _ = run("plan", path)
    assert status == 0
    assert out.startswith("This log can show nothing: too few traverses")


@pytest.mark.slow
def test_causes_that_a_log_confuses_come_with_the_traverses_that_tell_them_apart(run, tmp_path):
    table = hide("session", ("drift",), strength=10, seed=5).table
    path, saved = tmp_path / "one_way.csv", tmp_path / "next.json"
    table[table["direction"] == "+"].to_csv(path, index=False)
    status, out, _ = run("plan", path, "--json", saved)
    content = json.loads(saved.read_text("utf-8"))
    assert status == 0
    assert content["verdict"] == "cannot tell apart"
    assert "To separate causes, in a new session" in out
    assert "drift" in content["next_experiment"][0]["tells_apart"]
    assert content["next_experiment"][0]["repeats"] >= 1
    assert content["out_of_reach"] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--law", "law.toml"), "name an existing law file"),
        (("--chart", "out.png"), "--chart belongs to a plan"),
        (("--json", "nowhere/out.json"), "nowhere"),
    ],
)
def test_options_that_do_not_go_with_a_log_are_refused_before_any_work(run, log, options, message):
    status, out, complained = run("plan", log, *options)
    assert (status, out) == (2, "")
    assert message in complained


def test_a_plan_is_refused_where_it_leaves_out_what_is_needed(run, refused, plan, tmp_path):
    assert run("plan", plan, "--since", "2012-01-01")[0] == 2
    assert "png" in run("plan", plan, "--chart", tmp_path / "out.txt")[2]
    plan.write_text(PLAN.format(noise=""), "utf-8")
    assert "[noise]" in refused("plan", plan)
