"""Real piezo motors, two rotary joints without arm lengths and times, through every command on a log."""

import os
import re
import time

import numpy as np
import pytest
from joblib.externals.loky import get_reusable_executor
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.cli._app import app
from stickslip_fit.machine import load_machine
from tests.cobra.maps import JOINTS, MACHINE, SHARED, positioners, read_maps, write_cut

pytestmark = pytest.mark.skipif(not SHARED.exists(), reason="the Cobra maps are not here")

COMMANDS = ("check", "fit", "calibrate", "anova", "diagnose", "report")
MAX_SECONDS = 300.0  # CPU of all commands on a whole log, two of which search it and every fold of it
EVERY = [(number, cut) for number in positioners() for cut in (1, 2)] if SHARED.exists() else []
# What a lab that has two joints and no times cannot do, or has done.
IMPOSSIBLE = re.compile(
    r"q3|theta (=|−|-9)|psi|arm upright|arm level|base on its side|full traverse|not settled|published law"
)


def cpu_seconds():
    """Of all processes; that of children counts once they have ended."""
    get_reusable_executor().shutdown()
    return sum(os.times()[:4])


def run(command, log, machine, tmp_path):
    command, *more = command.split()
    more += ["-o", str(tmp_path / f"{log.stem}.html")] if command == "report" else ["--full"]
    result = CliRunner().invoke(app, [command, str(log), "--machine", str(machine), *more])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, (command, log.stem, result.output)
    return " ".join(result.stdout.split())


def check_positioner(number, cut, tmp_path, commands=COMMANDS, every=1, most=MAX_SECONDS):
    machine, log = tmp_path / "cobra.toml", tmp_path / f"cobra-{number}-{cut}.csv"
    machine.write_text(MACHINE, encoding="utf-8")
    n_rows = write_cut(number, cut, log, every=every)
    began = cpu_seconds()
    texts = {command: run(command, log, machine, tmp_path) for command in commands}
    assert cpu_seconds() - began < most
    assert f"{n_rows} traverses" in texts["check"]
    assert "joint 1 (theta, rotary) and joint 2 (phi, rotary)" in texts["check"]
    assert "drift" in texts["diagnose"]
    assert "the log has no times" in texts["diagnose"]
    for command, text in texts.items():
        advice = text.split("What this log could not have shown")[0]
        assert not IMPOSSIBLE.search(advice), (command, number, cut, IMPOSSIBLE.search(advice))
        assert not re.search(r"\b(nan|NaT|None)\b", text), (command, number, cut)


def test_one_positioner_goes_through_the_commands(tmp_path):
    """An eighth of its traverses, cut in one way; all of them, both ways, and the report by night."""
    check_positioner("3", 1, tmp_path, COMMANDS[:-1], every=8, most=10.0)


@pytest.mark.nightly
@pytest.mark.parametrize(("number", "cut"), EVERY)
def test_every_positioner_goes_through_every_command(tmp_path, number, cut):
    check_positioner(number, cut, tmp_path)


@pytest.mark.parametrize("cut", [1, 2])
def test_a_fit_is_the_mean_step_of_each_version_and_direction(tmp_path, cut):
    machine, log = tmp_path / "cobra.toml", tmp_path / "log.csv"
    machine.write_text(MACHINE, encoding="utf-8")
    write_cut("9", cut, log)
    began = time.process_time()
    fit = ssf.fit(ssf.read_log(log, machine=load_machine(machine)))
    assert time.process_time() - began < 5
    table = fit.si.parameters.set_index(["session", "joint", "direction"])["estimate"]
    for (session, joint, direction), stretches in read_maps("9").items():
        steps = np.radians([step for _, _, step in stretches])
        low, high = steps.min(), steps.max()
        estimate = table[session, JOINTS[joint], {"fwd": "+", "rev": "-"}[direction]]
        assert low < estimate < high
        if cut == 1:  # the mean of log steps is that of the stretches, to their scatter within a traverse
            assert estimate == pytest.approx(np.exp(np.log(steps).mean()), rel=0.06)
