"""Every command that reads a log, on machines that are no published arm."""

import re

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.causes import library
from stickslip_fit.cli._app import app
from stickslip_fit.errors import InputError
from stickslip_fit.estimation.prediction import control_chart
from stickslip_fit.machine import load_machine
from stickslip_fit.units import from_si
from tests.joints.generated import GROWTH, MACHINES, STEPS, machine_text, write_log

# The machine that is left has joints of both kinds.
BY_NIGHT = {"one slide", "six joints", "two turns"}
NAMES = [pytest.param(name, marks=[pytest.mark.nightly] if name in BY_NIGHT else []) for name in MACHINES]

TO_SI = {"rotary": np.radians(1.0), "prismatic": 1e-3}


@pytest.fixture
def make(tmp_path):
    """Machine and log files of a name."""

    def write(name, **options):
        machine, log = tmp_path / "machine.toml", tmp_path / "log.csv"
        machine.write_text(machine_text(MACHINES[name]), encoding="utf-8")
        write_log(log, MACHINES[name], **options)
        return str(machine), str(log)

    return write


def run(command, machine, log, *more):
    result = CliRunner().invoke(app, [command, log, "--machine", machine, *more])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0
    return " ".join(result.output.split())


@pytest.mark.slow
def test_commands_that_are_proposed_read_the_log_in_the_same_way(make, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    machine, log = make("one slide")
    machine_and_season = f"--machine {machine} --since 2026-03-03"
    for command in ("check", "diagnose"):
        told = run(command, machine, log, "--since", "2026-03-03")
        proposed = told.rpartition("stickslip-fit ")[2]
        assert machine_and_season in proposed
        result = CliRunner().invoke(app, proposed.split())
        assert result.exit_code == 0, result.output


@pytest.mark.slow
def test_coefficients_of_smooth_functions_leave_the_screen_to_the_step_sizes(make):
    machine, log = make("one slide", n=40)
    said = run("fit", machine, log, "--cause", "along-travel")
    assert re.search(r"along-travel\.\* \d+ numbers coefficients of smooth functions", said)
    assert "along-travel.f1" not in said
    assert "Parameters of joint 1" in said


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_fits_find_the_steps_of_every_joint(make, name):
    machine, log = make(name)
    read = ssf.read_log(log, machine=load_machine(machine))
    for method, tolerance in (("least-squares", 0.012), ("closed-form", 0.05)):
        table = ssf.fit(read, method=method).si.parameters
        assert len(table) == len(MACHINES[name]) * 6
        for row in table.itertuples():
            kind = MACHINES[name][row.joint - 1][0]
            assert row.unit == {"rotary": "µrad", "prismatic": "nm"}[kind]
            session = int(row.session[-1]) - 2
            truth = STEPS[kind][row.direction] * (1 + GROWTH * session) * TO_SI[kind]
            assert row.estimate == pytest.approx(truth, rel=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_commands_name_each_joint_by_its_kind(make, tmp_path, name):
    machine, log = make(name)
    kinds = {f"joint {number} ({kind})" for number, (kind, _) in enumerate(MACHINES[name], start=1)}
    for command in ("check", "fit", "calibrate"):
        text = run(command, machine, log, "--full")
        assert {kind for kind in kinds if kind in text} == kinds
        assert "q2 = 0" not in text
    assert "Nothing is wrong" in run("diagnose", machine, log)
    run("anova", machine, log)


@pytest.mark.slow
def test_a_drift_is_found_on_a_machine_of_two_turns(make):
    machine, log = make("two turns", drift=0.05, n=8)
    text = run("diagnose", machine, log)
    assert "Steps grow by" in text
    assert re.search(r"drift \d", text)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one slide", pytest.param("two turns", marks=pytest.mark.nightly)])
def test_without_times_what_needs_order_is_untestable_and_why(make, tmp_path, name):
    machine, log = make(name, timed=False)
    read = ssf.read_log(log, machine=load_machine(machine))
    found = ssf.diagnose(read, gain=False)
    timed = ("drift", "thermal-warm-up", "session-jump", "wear", "reversal-loss")
    assert {found.untestable[cause] for cause in timed} == {"the log has no times"}
    assert found.untestable["theta-offset"].startswith("the geometry of the published arm is needed")
    assert not any(cause.startswith("unknown:") and "time" in cause for cause in found.inclusion)
    for cause in ("drift", "reversal-loss"):
        with pytest.raises(InputError, match="cannot be fitted: the log has no times"):
            ssf.fit(read, causes=[one for one in library() if one.name == cause])
    chart = control_chart(ssf.fit(read))
    assert chart[["expected_low", "expected_high"]].isna().all(axis=None)
    assert "no session can be compared with those before it" in run("fit", machine, log)
    quick = () if name == "one slide" else ("--no-diagnosis",)
    run("report", machine, log, "-o", str(tmp_path / "page.html"), *quick)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "NaT" not in page
    assert "Not compared: the strategies choose among traverses that calibrate the published arm" in page
    assert "This log cannot say: a comparison" not in page


def test_one_constant_for_a_prismatic_first_joint_is_in_nm(make):
    machine, log = make("another order")
    fit = ssf.fit(ssf.read_log(log, machine=load_machine(machine)))
    first = fit.si.parameters.iloc[0]
    assert from_si(first["estimate"], "nm") == pytest.approx(110, rel=0.02)
    assert fit.joints[1].law.prismatic
    assert not fit.joints[3].law.prismatic


REFUSED = {
    "compare": lambda log, fit: ssf.compare_strategies(log),
    "plan-move": lambda log, fit: ssf.plan_move(fit, start=[0.0, 0.0, 0.0], target=[0.0, 0.0, 0.001]),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_needs_an_arm_is_refused_in_one_sentence(make, what):
    machine, log = make("another order")
    read = ssf.read_log(log, machine=load_machine(machine))
    with pytest.raises(InputError, match="an arm of two rotary joints"):
        REFUSED[what](read, ssf.fit(read))


def test_where_moves_are_refused_what_gives_the_steps_of_drives_is_named(make):
    machine, log = make("one slide")
    read = ssf.read_log(log, machine=load_machine(machine))
    fit = ssf.fit(read)
    with pytest.raises(InputError, match=r"; the steps of its drives come from `stickslip-fit predict LAW"):
        ssf.plan_move(fit, [0.0], [0.005])
    drive = pd.DataFrame({"session": read.sessions[:1], "joint": 1, "direction": "+", "start": 0.0})
    predicted = fit.predict(drive.assign(stop=5e-3))
    assert predicted["steps"].item() == pytest.approx(5.0 / STEPS["prismatic"]["+"], rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("one slide", marks=pytest.mark.nightly), "two turns"])
def test_a_joint_that_has_changed_is_named_on_any_machine(make, tmp_path, name):
    machine, old = make(name, sessions=3)
    lines = (tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()
    column = lines[0].split(",").index("steps")
    changed = [lines[0]]
    for line in lines[1:]:
        cells = line.replace("2026-03-", "2026-06-").split(",")
        cells[column] = str(round(int(cells[column]) / 1.5))
        changed.append(",".join(cells))
    new = tmp_path / "new.csv"
    new.write_text("\n".join(changed), encoding="utf-8")
    said = run("changed", machine, old, str(new))
    assert said.startswith(f"Changed: joint 1 +{' and' if name == 'one slide' else ','} joint 1 −")
    assert re.search(r"Joint 1 \+: steps are (4[5-9]|5[0-5])\.\d % longer", said)
