"""The law extended by causes at the command line: fitted, saved, predicted with, moved by, simulated from."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit import cli
from stickslip_fit.causes import ExtendedLaw, ThermalWarmUp
from stickslip_fit.cli import diagnose as diagnosing
from stickslip_fit.diagnosis import Diagnosis
from stickslip_fit.logs import read_log

A, TAU, LOST = 0.04, 1200.0, 80
PLAN = """
seed = 3
check_every = 1
[sessions]
dates = [2012-03-05, 2012-03-06]
[noise]
repeatability_pct = 0.2
[[sweep]]
joint = 3
q2_deg = [-90, -30, 0]
theta_deg = [-90, 0]
replicates = 3
[[sweep]]
joint = 2
q3_mm = [0, 12]
theta_deg = [-90, 0]
replicates = 2
[[sweep]]
joint = 3
directions = ["+"]
q2_deg = [-60, -120]
replicates = 3
"""
CAUSES = f"""
[[cause]]
name = "thermal-warm-up"
A = "{100 * A:g} %"
tau = "{TAU / 60:g} min"
[[cause]]
name = "reversal-loss"
L = "{LOST} steps"
"""
QUICK = ("--no-diagnosis", "--no-strategies")
REFERENCE = Path(__file__).parents[1] / "data" / "reference"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A law with causes, a log simulated from it, and the fit of that."""
    where = tmp_path_factory.mktemp("extended")
    (where / "plan.toml").write_text(PLAN)
    (where / "later.toml").write_text(PLAN.replace("2012-03-05, 2012-03-06", "2012-06-01"))
    (where / "law.toml").write_text(CAUSES + (REFERENCE / "law.toml").read_text("utf-8"))
    causes = ("--cause", "thermal-warm-up", "--cause", "reversal-loss")
    for arguments in (
        ("simulate", where / "plan.toml", "--law", where / "law.toml", "-o", where / "log.csv"),
        ("fit", where / "log.csv", *causes, "--json", where / "fit.json"),
    ):
        sys.argv = ["stickslip-fit", *map(str, arguments)]
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert not ended.value.code
    return where


@pytest.fixture
def run(run, monkeypatch, folder):
    """As everywhere, in the folder."""
    monkeypatch.chdir(folder)
    return run


@pytest.mark.slow
def test_the_causes_that_were_simulated_are_fitted_with_units_and_error_bars(run):
    status, out, _ = run("fit", "log.csv", "--cause", "thermal-warm-up", "--cause", "reversal-loss")
    assert status == 0
    for name, truth in (
        ("thermal-warm-up.A", 100 * A),
        ("thermal-warm-up.tau", TAU / 60),
        ("reversal-loss.L", LOST),
    ):
        value, error = map(float, re.search(rf"{re.escape(name)} +([\d.]+) ± ([\d.]+)", out).groups())
        assert abs(value - truth) < 4 * error
        assert error < 0.3 * truth


@pytest.mark.slow
def test_a_parameter_of_a_cause_can_be_bounded(run):
    bounds = ("--bound", "thermal-warm-up.tau=30:60")
    out = run("fit", "log.csv", "--cause", "thermal-warm-up", *bounds)[1]
    assert "thermal-warm-up.tau is held back by its bound at 30.0000 min" in " ".join(out.split())


def test_a_column_that_a_plan_does_not_have_is_told_of(run):
    cause = '[[cause]]\nname = "temperature"\nk = "0.5 %/K"\nmean = "21 °C"\n'
    Path("warm.toml").write_text(cause + (REFERENCE / "law.toml").read_text("utf-8"))
    status, out, _ = run("simulate", "later.toml", "--law", "warm.toml", "-o", "mean.csv")
    assert status == 0
    assert "the plan does not say temperature_C: the law was taken at its mean" in out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--cause", "warmth"), "value 'warmth': is no cause that is known"),
        (("--cause", "temperature"), "value 'temperature': the log has no ambient temperature"),
        (("--cause", "end-stop-misfire"), "misfires are met by --heavy-tails"),
        (("--cause", "drift", "--method", "closed-form"), "the closed form fits no cause"),
        (("--causes-from", "fit.json", "--cause", "drift"), "--causes-from and --cause are alternatives"),
        (
            ("--causes-from", "fit.json", "--method", "bayes"),
            "belongs to the closed form and to",
        ),
    ],
)
def test_a_cause_that_cannot_be_fitted_is_refused_in_one_message(run, arguments, told):
    status, out, err = run("fit", "log.csv", *arguments)
    assert (status, out) == (2, "")
    assert told in err
    if "value" in told:
        assert "this log can show thermal-warm-up, drift" in err


def steps_of(out: str) -> list[int]:
    return [
        int(found.replace(",", ""))
        for found in re.findall(r"^[123] [+-] .*? (?:mm|deg) +([\d,]+)  ", out, re.M)
    ]


def test_a_move_takes_fewer_steps_once_warm(run):
    move = ("plan-move", "fit.json", "--at", "0,-90,0", "--joints", "0,-60,6")
    cold, hot = (run(*move, "--condition", f"session_{time}") for time in ("s=0", "h=100"))
    assert cold[0] == hot[0] == 0
    ratios = np.divide(steps_of(cold[1]), steps_of(hot[1]))
    assert ratios == pytest.approx([1 + A] * 2, abs=0.01)


def test_a_reversal_within_a_run_of_drives_costs_its_steps(run):
    """Out and back by as many steps as it takes: what the reversal loses is missing on the way back."""
    at = ("dead-reckon", "fit.json", "--at", "0,-90,6", "--condition", "session_h=100", "--drive")
    back = float(re.search(r"q3 +([\d.]+) mm", run(*at, "3-3000")[1])[1])
    there = float(re.search(r"q3 +([\d.]+) mm", run(*at, "3+3000", "--drive", "3-3000")[1])[1])
    out = float(re.search(r"q3 +([\d.]+) mm", run(*at, "3+3000")[1])[1])
    found = {
        item["name"]: item["estimate"] for item in json.loads(Path("fit.json").read_text())["parameters"]
    }
    # A step back is some 0.94 µm long by then, with the arm level.
    assert ((out - there) - (6 - back)) * 1e3 == pytest.approx(-0.94 * found["reversal-loss.L"], rel=0.05)


def test_what_a_move_must_be_told_is_asked_for_and_what_changes_nothing_refused(run, refused):
    move = ("plan-move", "fit.json", "--at", "0,-90,0", "--joints", "0,-60,6")
    assert "the law depends on how long the session has run: give --condition session_min=NUMBER" in refused(
        *move
    )
    assert "this law depends on session_min; leave temperature_C out" in refused(
        *move, "--condition", "temperature_C=20"
    )
    assert run(*move, "--condition", "session_min=soon")[0] == 2


@pytest.mark.slow
def test_a_plan_is_predicted_by_its_own_clock(run):
    status, _, _ = run("predict", "fit.json", "plan.toml", "--session", "2012-03-05", "-o", "predicted.csv")
    assert status == 0
    predicted, log = pd.read_csv("predicted.csv"), pd.read_csv("log.csv")
    first = len(log) // 2
    # Six repeatabilities; a person's pauses are known on average only.
    assert predicted["steps"][:first].to_numpy() == pytest.approx(log["steps"][:first].to_numpy(), rel=0.012)
    status, _, complained = run("predict", "fit.json", "plan.toml", "--condition", "session_min=3")
    assert status == 2
    assert "value 'session_min=3': a plan times its traverses itself" in complained
    assert "change pause_s in its table [timing]" in complained
    assert "session_seconds" not in complained


@pytest.mark.slow
def test_a_session_to_come_is_simulated_from_a_result_and_calibrated_with_its_causes(run):
    assert run("simulate", "later.toml", "--law", "fit.json", "-o", "later.csv")[0] == 0
    status, out, _ = run("calibrate", "later.csv", "--causes-from", "fit.json", "--json", "today.json")
    assert status == 0
    assert "reversal-loss.L" in out
    today, before = (
        {(item["name"], item["direction"]): item for item in json.loads(Path(name).read_text())["parameters"]}
        for name in ("today.json", "fit.json")
    )
    for key in (("a", "+"), ("c", "-"), ("gamma0_q3_0", "+")):
        # The later session has the parameters of the last one fitted.
        error = np.hypot(today[key]["standard_error"], before[key]["standard_error"])
        assert abs(today[key]["estimate"] - before[key]["estimate"]) < 4 * error


@pytest.mark.slow
def test_the_report_is_of_the_extended_law(run):
    assert run("report", "log.csv", "--cause", "thermal-warm-up", "-o", "with.html", *QUICK)[0] == 0
    page = Path("with.html").read_text("utf-8")
    assert page.count("thermal-warm-up.A</") == 1
    assert "Departures from the published laws" in page


def test_what_a_diagnosis_names_becomes_a_law_and_misfires_take_no_part(run):
    log = read_log("log.csv")
    misheard = [5, 40]
    rows = log.rows.copy()
    rows.loc[misheard, "steps"] = (rows.loc[misheard, "steps"] * 1.3).astype(int)
    log = replace(log, rows=rows)
    noise = np.ones(len(log.usable) - len(misheard))
    problem = SimpleNamespace(parts=(), noise_ratio=noise, noise_beside=lambda causes: {})
    search = SimpleNamespace(problem=problem, outliers=np.array(misheard))
    found = SimpleNamespace(
        table=None,
        selection=search,
        require_log=lambda: log,
        findings=[
            SimpleNamespace(version=ThermalWarmUp(), traverses=None),
            SimpleNamespace(version=None, traverses=log.usable.iloc[misheard]),
        ],
    )
    law = Diagnosis.extended_law(found)
    assert isinstance(law.joints[3].law, ExtendedLaw)
    assert len(law.residuals) == len(log.rows) - 2
    size = law.si.parameters.set_index("name").loc["thermal-warm-up.A"]
    assert abs(size["estimate"] - A) < 0.015
    told = diagnosing.save_extended_law(law, Path("named.json"))
    assert told == "law (extended by thermal-warm-up) saved to named.json"
    move = (
        *("plan-move", "named.json", "--at", "0,-90,0", "--joints", "0,-60,6"),
        *("--condition", "session_min=30"),
    )
    assert run(*move)[0] == 0
    nothing = Diagnosis.extended_law(
        SimpleNamespace(findings=[], table=None, selection=search, require_log=lambda: log)
    )
    assert "as it was: nothing was found that extends it" in diagnosing.save_extended_law(
        nothing, Path("plain.json")
    )


@pytest.mark.slow
def test_the_guide_s_example_comes_out_as_printed_there(run):
    guide = (REFERENCE.parents[1] / "docs" / "howto" / "extend-the-law.md").read_text("utf-8")
    causes = re.search(r"```toml\n(.*?)```", guide, re.S)[1]
    printed = re.search(r"```text\n(Departures from the published laws.*?)```", guide, re.S)[1]
    Path("guide.toml").write_text(causes + (REFERENCE / "law.toml").read_text("utf-8"))
    run("simulate", REFERENCE / "plan.toml", "--law", "guide.toml", "-o", "guide.csv")
    names = re.findall(r'name = "(.*)"', causes)
    out = run("fit", "guide.csv", *(word for name in names for word in ("--cause", name)))[1]
    assert printed in out
