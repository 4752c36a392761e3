"""The command, at the emulated rig."""

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from stickslip_fit.cli._app import app
from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log

SCRIPT = "time_s,vx_um_s,vy_um_s,vz_um_s,home\n0,20,0,0,\n3,0,10,-30,\n6,0,0,0,\n"


@pytest.fixture(scope="module")
def folder(arm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("verb")
    arm.result.save(folder / "fit.json")
    (folder / "path.csv").write_text(SCRIPT)
    return folder


def drive(folder, *options):
    given = [str(folder / one) if one.endswith((".json", ".csv", ".journal")) else one for one in options]
    done = CliRunner().invoke(app, ["drive", str(folder / "fit.json"), *given])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.output


def tip_of(text, begin):
    found = re.search(begin + r" \(([^)]*)\) mm", text)
    return np.array([float(part) for part in found[1].split(",")]) * 1e-3


BY_SCRIPT = ("--emulate", "--at", "0.0,-70,5", "--script", "path.csv")


def test_a_script_drives_the_emulated_rig(folder):
    text = drive(folder, *BY_SCRIPT)
    said, true = tip_of(text, "Tip at"), tip_of(text, "tip truly is at")
    radius = float(re.search(r"within ([\d.]+) µm \(95 %\)", text)[1]) * 1e-6
    assert np.linalg.norm(said - true) < 2 * radius
    verdict = text[text.index("Tip at") :]
    assert "Joints 1, 2 and 3 made" in verdict
    assert "Advice: none" in verdict


@pytest.mark.slow
def test_the_tolerance_brings_advice(folder):
    text = drive(folder, *BY_SCRIPT, "--tolerance", "0.2")
    assert re.search(r"Advice: Go back to the [+−] stop of joint \d now: the tolerance is exceeded", text)


def test_another_truth_is_far_off(folder, tmp_path):
    """A manipulator that has changed since is where its calibration says it cannot be."""
    law = (tmp_path / "law.toml").resolve()
    text = Path("data/reference/law.toml").read_text("utf-8").replace("a_nm = 972", "a_nm = 1100")
    law.write_text(text.replace("a_nm = 899", "a_nm = 1000"))
    said = drive(folder, *BY_SCRIPT, "--truth", str(law))
    off = float(re.search(r"mm, ([\d.]+) µm from where", said)[1])
    radius = float(re.search(r"within ([\d.]+) µm \(95 %\)", said)[1])
    assert off > 4 * radius


@pytest.mark.slow
def test_a_drive_goes_on_from_its_journal(folder):
    first = drive(folder, *BY_SCRIPT, "--journal", "one.journal")
    second = drive(folder, "--emulate", "--resume", "--journal", "one.journal", "--script", "path.csv")
    assert "6.0 s" in first
    assert re.search(r"in 12\.\d s", second)
    moved = tip_of(second, "Tip at") - tip_of(first, "Tip at")
    assert moved == pytest.approx([60e-6, 30e-6, -90e-6], abs=8e-6)


def test_a_joint_that_went_home_is_in_the_log_with_the_time_of_today(folder):
    (folder / "home.csv").write_text(
        "time_s,vx_um_s,vy_um_s,vz_um_s,home\n0,0,0,-20,\n0.5,0,0,0,3\n1,0,0,0,\n"
    )
    began = datetime.now(UTC)
    said = drive(folder, "--emulate", "--at", "0.0,-70,0.1", "--script", "home.csv", "--log", "log.csv")
    assert "joint 3 is at its stop" in said
    (row,) = read_log(folder / "log.csv").rows.itertuples()
    assert (row.joint, row.direction, row.status) == (3, "-", "excluded")
    assert -1.0 < (row.time - began).total_seconds() < 120.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--emulate", "--script", "path.csv"), "give --at Q1,Q2,Q3"),
        (("--emulate", "--resume"), "give --journal"),
        (("--emulate", "--resume", "--journal", "x.journal", "--at", "0,-90,0"), "--at means nothing"),
        (("--at", "0,-90,0", "--script", "path.csv"), "give --port"),
        (("--at", "0,-90,0", "--seed", "3"), "--seed means nothing at a real rig"),
        (("--at", "0,-90,20", "--emulate", "--script", "path.csv"), "q3 = 20.00 mm is outside its range"),
        (("--at", "0,-90,0", "--emulate", "--page", "--script", "path.csv"), "--script means nothing beside"),
        (("--at", "0,-90,0", "--emulate", "--page-port", "8000"), "--page-port means nothing without"),
        (("--at", "0,-90,0", "--emulate"), "keys can be pressed at a terminal only"),
        (("--at", "0,-90,0", "--emulate", "--dialect", "anc300", "--script", "path.csv"), "is not emulated"),
        (("--at", "0,-90,0", "--emulate", "--script", "path.csv", "--log", "path.csv"), "path.csv"),
    ],
)
def test_what_cannot_be_driven_is_said(folder, options, said):
    with pytest.raises(InputError, match=said):
        drive(folder, *options)
