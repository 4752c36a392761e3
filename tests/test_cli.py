"""The command line as a person uses it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.conftest import CALIBRATION
from tests.docs.commands import parse

ROOT = Path(__file__).parents[1]
CAMPAIGNS = ROOT.parent / "shared" / "data" / "campaigns"
REFERENCE = ROOT / "data" / "reference"


PLAN = """
replicates = 15
[sessions]
dates = [2012-03-20]
[[sweep]]
joint = 3
q2_deg = [-30]
[[sweep]]
joint = 2
q3_mm = [6]
"""
SWEEP = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": -45.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
)


@pytest.fixture
def log(campaign, tmp_path):
    path = tmp_path / "log.csv"
    campaign(settings=CALIBRATION).to_csv(path, index=False)
    return path


def test_check_says_what_a_log_holds(run, log):
    status, out, err = run("check", log)
    assert (status, err) == (0, "")
    assert "2 sessions" in out


@pytest.mark.parametrize("method", ["closed-form", pytest.param("least-squares", marks=pytest.mark.slow)])
def test_fit_prints_and_saves(run, log, tmp_path, method):
    status, out, _ = run("fit", log, "--method", method, "--json", tmp_path / "fit.json")
    assert status == 0
    full = run("fit", log, "--method", method, "--full")[1]
    assert len(out.splitlines()) <= 27, "a screen, and what was saved"
    shown = re.search(r"2012-03-05 +\+ +(\d+\.\d) ± (\d+\.\d)", full.split("joint 3 (prismatic)")[1])
    assert shown
    content = json.loads((tmp_path / "fit.json").read_text("utf-8"))
    assert content["provenance"]["command"].startswith("stickslip-fit fit ")
    a = next(item for item in content["parameters"] if item["name"] == "a")
    assert a["estimate"] == pytest.approx(float(shown[1]), abs=0.051)


@pytest.mark.slow
def test_calibrate_is_the_closed_form(run, log):
    assert run("calibrate", log)[1] == run("fit", log, "--method", "closed-form")[1]


@pytest.mark.slow
def test_a_move_from_a_log_and_from_a_saved_fit_agree(run, log, tmp_path):
    run("fit", log, "--json", tmp_path / "fit.json")
    move = ("--at", "0,-90,0", "--joints", "20,-60,6")
    status, out, _ = run("plan-move", log, *move)
    assert status == 0
    assert run("plan-move", tmp_path / "fit.json", *move)[1] == out
    assert re.search(r"3 \+ +0\.000 mm +6\.000 mm +9,\d{3}", out)


def test_the_tip_goes_where_it_is_sent(run, log):
    status, out, _ = run("plan-move", log, "--at", "-5,-90,0", "--tip", "55,3,-5", "--session", "2012-03-05")
    assert status == 0
    assert "The tip ends at (55.000, 3.000, -5.000) mm" in out


def test_where_says_when_to_go_back_to_a_stop(run, log):
    status, out, _ = run(
        "dead-reckon", log, "--at=0,-90,0", "--drive", "3+2000", "--drive", "2-100", "--tolerance", 100
    )
    assert status == 0
    assert re.search(r"joint 2 \+ +[\d,]+ steps, then go back to a stop", out)


@pytest.mark.slow
def test_simulate_check_and_sheet_from_one_plan(run, tmp_path):
    plan, law = REFERENCE / "plan.toml", REFERENCE / "law.toml"
    assert run("simulate", plan, "--law", law, "-o", tmp_path / "one.csv")[0] == 0
    assert run("simulate", plan, "--law", law, "-o", tmp_path / "two.csv", "--seed", "7")[0] == 0
    assert (tmp_path / "one.csv").read_bytes() == (REFERENCE / "campaign.csv").read_bytes()
    assert (tmp_path / "one.csv").read_bytes() != (tmp_path / "two.csv").read_bytes()
    assert run("check", tmp_path / "two.csv")[0] == 0
    assert run("sheet", plan, "-o", tmp_path / "sheet.csv")[0] == 0
    assert (tmp_path / "sheet.html").exists()


@pytest.mark.slow
def test_a_saved_fit_can_be_simulated_from(run, log, tmp_path):
    run("fit", log, "--json", tmp_path / "fit.json")
    plan = REFERENCE / "plan.toml"
    status, _, err = run("simulate", plan, "--law", tmp_path / "fit.json", "-o", tmp_path / "again.csv")
    assert (status, err) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "name", "begins"),
    [
        ("calibrate", "c.png", b"\x89PNG"),
        ("fit", "c.svg", b"<?xml"),
        pytest.param("fit", "c.PDF", b"%PDF", marks=pytest.mark.nightly),
    ],
)
def test_the_control_chart_is_drawn_and_the_same_each_time(
    run, campaign, tmp_path, monkeypatch, verb, name, begins
):
    """Whatever the date, which this variable tells Matplotlib."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    campaign(settings=({"joint": 3, "q2_deg": 0.0}, *SWEEP)).to_csv(tmp_path / "log.csv", index=False)
    status, out, _ = run(verb, tmp_path / "log.csv", "--chart", tmp_path / name)
    assert status == 0
    assert out.endswith(f"control chart written to {tmp_path / name}\n")
    first = (tmp_path / name).read_bytes()
    assert first.startswith(begins)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    run(verb, tmp_path / "log.csv", "--chart", tmp_path / name)
    assert (tmp_path / name).read_bytes() == first


@pytest.mark.slow
def test_predict_says_what_a_plan_will_give(run, log, campaign, tmp_path):
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN)
    run("fit", log, "--json", tmp_path / "fit.json")
    status, out, err = run("predict", tmp_path / "fit.json", plan, "-o", tmp_path / "counts.csv")
    assert (status, err) == (0, "")
    assert "by the calibration of session 2012-03-06" in out
    assert "Predicted counts (the first 14 of 60)" in out
    full = run("predict", tmp_path / "fit.json", plan, "--full")[1]
    shown = [line for line in full.splitlines() if line.startswith("2012-03-20")]
    assert len(shown) == 60
    assert len({line.rindex(" to ") for line in shown}) == 1, "columns line up"
    predicted = pd.read_csv(tmp_path / "counts.csv")
    assert len(predicted) == 60
    assert re.sub(",", "", shown[0]).split()[-6] == str(predicted.loc[0, "steps"])
    truth = campaign(
        ("2012-03-06",), ({"joint": 3, "q2_deg": -30.0}, {"joint": 2, "q3_mm": 6.0}), repeatability=0.0
    )
    for row in truth.itertuples():
        subset = predicted[(predicted["joint"] == row.joint) & (predicted["direction"] == row.direction)]
        assert subset["low"].iloc[0] <= row.steps <= subset["high"].iloc[0]
        assert subset["high"].iloc[0] - subset["low"].iloc[0] < 0.03 * row.steps
    assert predicted["step_size_nm"].notna().equals(predicted["joint"] == 3)
    assert predicted["step_size_urad"].notna().equals(predicted["joint"] == 2)


@pytest.mark.slow
def test_predict_from_a_log_takes_the_session_that_is_named(run, log, tmp_path):
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN)
    run("fit", log, "--json", tmp_path / "fit.json")
    by_log = run("predict", log, plan, "--session", "2012-03-05")
    assert by_log == run("predict", tmp_path / "fit.json", plan, "--session", "2012-03-05")
    assert by_log != run("predict", log, plan)


@pytest.mark.slow
def test_bayes_tells_its_checks_and_keeps_its_draws(run, campaign, tmp_path):
    table = campaign(settings=({"joint": 3, "q2_deg": 0.0}, *SWEEP), directions=("+",))
    table.to_csv(tmp_path / "log.csv", index=False)
    status, out, _ = run(
        "fit", tmp_path / "log.csv", "--method", "bayes", "--tree", tmp_path / "fit.nc", "--full"
    )
    assert status == 0
    assert re.search(r"^3 \+ +0\.\d\d +0\.\d\d +0\.\d\d +-?\d+\.\d ± ", out, re.M)
    assert "The counts look like the model's own." in out
    (tmp_path / "plan.toml").write_text(PLAN.split("[[sweep]]\njoint = 2")[0] + 'directions = ["+"]\n')
    status, out, _ = run("predict", tmp_path / "fit.nc", tmp_path / "plan.toml")
    assert status == 0
    assert "by the calibration of a session to come" in out


@pytest.mark.slow
def test_the_demo_finds_what_is_hidden_and_nothing_else(run, monkeypatch, tmp_path):
    """The commands that it shows are ones that a user can type; its files are there to look at."""
    monkeypatch.chdir(tmp_path)
    status, out, _ = run("demo")
    assert status == 0
    assert "Found in the first campaign: thermal-warm-up. In the second: nothing." in out
    assert "cuts the prediction error on held-out traverses from" in " ".join(out.split())
    steps = re.findall(r"^(\d)\. ", out, re.M)
    assert steps == [str(number) for number in range(1, 9)]
    folder = tmp_path / "reports" / "demo"
    assert 'name = "thermal-warm-up"' in (folder / "hidden-law.toml").read_text()
    assert (folder / "report.html").stat().st_size > 100_000
    shown = re.findall(r"^\$ (stickslip-fit .*)", out, re.M)
    assert len(shown) == 8
    for line in shown:
        parse(line.split()[1:])
    assert run("predict", folder / "law.json", folder / "plan.toml")[0] == 0


@pytest.mark.skipif(not CAMPAIGNS.exists(), reason="the measured campaigns are not on this machine")
@pytest.mark.parametrize("name", ["c", *(pytest.param(each, marks=pytest.mark.nightly) for each in "abdef")])
def test_the_demo_runs_on_measured_campaigns(run, monkeypatch, tmp_path, name):
    monkeypatch.chdir(tmp_path)
    status, _, err = run("demo", CAMPAIGNS / f"campaign-{name}.csv")
    assert (status, err) == (0, "")
    assert (tmp_path / "reports" / f"campaign-{name}.html").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["check", "absent.csv"], "absent.csv"),
        (["fit", "absent.json"], "absent.json"),
        (
            ["plan-move", "{log}", "--at", "0,-90", "--joints", "0,0,0"],
            "--at, value '0,-90': give three numbers",
        ),
        (["plan-move", "{log}", "--at", "0,-90,0"], "either --tip X,Y,Z"),
        (["plan-move", "{log}", "--at", "0,-90,0", "--tip", "500,0,0"], "mm"),
        (["plan-move", "{log}", "--at", "0,-90,0", "--joints", "0,0,0", "--order", "1,1,2"], "--order"),
        (["plan-move", "{log}", "--at", "0,-90,nan", "--joints", "0,0,0"], "--at"),
        (
            ["dead-reckon", "{log}", "--at", "0,-90,0", "--drive", "3*50"],
            "--drive, value '3*50': give joint, direction",
        ),
        (["dead-reckon", "{log}", "--at", "0,-90,0", "--drive", "3+0"], "--drive, value '3+0': give joint"),
        (["dead-reckon", "{log}", "--at", "0,-90,0", "--drive", "3+50", "--session", "never"], "'never'"),
        (["fit", "{log}", "--machine", "absent.toml"], "absent.toml"),
        (["report", "{log}", "-o", "absent/report.html"], "absent/report.html"),
        (["fit", "{log}", "--json", "absent/fit.json"], "absent/fit.json"),
        (["fit", "{log}", "--chart", "chart.gif"], "chart.gif: is no kind of picture"),
        (["fit", "{log}", "--chart", "absent/chart.png"], "absent/chart.png"),
        (["fit", "{log}", "--tree", "fit.nc"], "--tree belongs to --method bayes"),
        (["fit", "{log}", "--method", "bayes", "--tree", "fit.h5"], "--tree, value 'fit.h5': is netCDF"),
        (["check", "{log}", "--since", "spring"], "--since, value 'spring': is no date or time"),
        (["check", "{log}", "--sheet", "Log"], "--sheet, value 'Log': names a sheet"),
        (["predict", "{log}"], "name a plan (TOML) or a file of drives (CSV)"),
        (["predict", "{log}", "absent.toml"], "absent.toml"),
        (["predict", "absent.nc", "absent.toml"], "absent.nc"),
        (["predict", "{log}", "plan.toml", "--session", "never"], "session 'never' was not fitted"),
        (["predict", "{log}", "plan.toml", "-o", "absent/counts.csv"], "absent/counts.csv"),
        (["simulate", "absent.toml", "--law", "absent.toml", "-o", "x.csv"], "absent.toml"),
    ],
)
def test_bad_input_ends_with_one_message_and_status_2(refused, log, monkeypatch, arguments, told):
    monkeypatch.chdir(log.parent)
    Path("plan.toml").write_text(PLAN)
    err = refused(*[str(argument).format(log=log) for argument in arguments])
    assert told in err
    assert "Traceback" not in err


def test_every_fault_of_a_log_is_told_and_nothing_is_written(run, log, tmp_path):
    lines = log.read_text().splitlines()
    lines[3] = lines[3].replace(",3,", ",4,", 1)
    lines[7] = lines[7].replace("2012-03-05T", "yesterday ", 1)
    log.write_text("\n".join(lines) + "\n")
    status, out, err = run("report", log, "-o", tmp_path / "report.html")
    assert (status, out) == (2, "")
    assert "line 4, column joint, value '4'" in err
    assert "line 8, column time" in err
    assert not (tmp_path / "report.html").exists()


@pytest.mark.slow
def test_what_was_asked_for_is_saved_whoever_stops_reading(log, tmp_path):
    program = [sys.executable, "-m", "stickslip_fit", "fit", log, "--json", str(tmp_path / "fit.json")]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as fitting:
        fitting.stdout.close()
        assert fitting.stderr.read() == ""
    assert (tmp_path / "fit.json").exists()


@pytest.mark.slow
def test_an_interrupted_run_says_so_and_leaves_nothing(run, campaign, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("stickslip_fit.reporting.page.write_atomically", interrupted)
    campaign(("2012-03-05",), SWEEP).to_csv(tmp_path / "log.csv", index=False)
    quick = ("--no-diagnosis", "--no-strategies", "-o", str(tmp_path / "report.html"))
    status, _, said = run("report", tmp_path / "log.csv", *quick)
    assert (status, said) == (130, "interrupted; nothing was left half-written\n")
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


@pytest.mark.nightly
def test_a_faulty_log_ends_with_status_2_every_time(tmp_path):
    """Threads that outlive the message used to abort one run in fifteen."""
    path = tmp_path / "log.csv"
    path.write_text("session,time,joint,direction,steps,q1_deg,q2_deg,q3_mm,theta_deg,psi_deg\n"
                    "a,2026-03-02T08:30:00,3,+,12150.5,0,-90,,0,0\n")  # fmt: skip
    program = [sys.executable, "-m", "stickslip_fit", "check", str(path)]
    ended = [subprocess.run(program, capture_output=True, check=False).returncode for _ in range(100)]
    assert ended == [2] * 100
