"""The built wheel, installed into an empty environment: no checkout, no extras, no make."""

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]
PLAN = """
[sessions]
dates = [2012-03-05, 2012-03-06]
[noise]
repeatability_pct = 0.27
[[sweep]]
joint = 3
q2_deg = [-90, -30, 0]
theta_deg = [0, -90]
replicates = 2
"""
STUDY = """
plan = "plan.toml"
law = "law.toml"
campaigns = 4
seed = 1
[moves]
count = 0
[[scenario]]
name = "nothing hidden"
"""
# Every command, in an order in which each finds the files that it needs; with the file that it writes.
COMMANDS = (
    ("demo", "reports/demo/report.html"),
    ("simulate plan.toml --law law.toml -o log.csv", "log.csv"),
    ("check log.csv", ""),
    ("calibrate log.csv", ""),
    ("fit log.csv --json fit.json --chart fit.png", "fit.png"),
    ("fit log.csv --method bayes --tree draws.nc", "draws.nc"),
    ("predict fit.json plan.toml -o counts.csv", "counts.csv"),
    ("plan-move fit.json --at 0,-90,0 --joints 0,-90,6", ""),
    ("dead-reckon fit.json --at 0,-90,0 --drive 3+5000", ""),
    ("anova log.csv", ""),
    ("diagnose log.csv --json diagnosis.json", "diagnosis.json"),
    ("compare log.csv", ""),
    ("report log.csv -o report.html", "report.html"),
    ("plan log.csv", ""),
    ("plan plan.toml", ""),
    ("sheet plan.toml -o sheet.csv", "sheet.html"),
    ("study study.toml -o study --workers 1", "study"),
    ("capture tune -o tuning.json --emulate", "tuning.json"),
    ("capture short.toml -o captured.csv --emulate --ideal-detector --unattended", "captured.csv"),
)
# What needs an extra says which.
EXTRAS = (
    ("capture short.toml -o rig.csv --port /dev/ttyUSB0 --tuning tuning.json", "stickslip-fit[capture]"),
    ("capture tune -o rig.json --moving a.wav --at-stop a.wav", "stickslip-fit[capture]"),
    ("drive fit.json --at 0,-90,0 --by gamepad --emulate", "stickslip-fit[gamepad]"),
    ("drive fit.json --at 0,-90,0 --by spacemouse --emulate", "stickslip-fit[spacemouse]"),
    ("study study.toml -o cluster --cluster tcp://localhost:1", "stickslip-fit[dask]"),
)


def run(folder: Path, *command: str | Path) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment["OMP_NUM_THREADS"] = "1"
    pipe = subprocess.PIPE
    return subprocess.run(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True
    )


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> tuple[Path, Path]:
    """The wheel, and the command that pip installed from it."""
    folder = tmp_path_factory.mktemp("wheel")
    venv.create(folder / "empty", with_pip=True)
    scripts = folder / "empty" / ("Scripts" if sys.platform == "win32" else "bin")
    for step in (["wheel", "--no-deps", "-w", folder, CHECKOUT], ["install", "--find-links", folder]):
        wheels = list(folder.glob("stickslip_fit-*.whl"))
        done = run(folder, scripts / "python", "-m", "pip", "--disable-pip-version-check", *step, *wheels)
        if "No matching distribution found" in done.stderr:
            pytest.skip("pip reaches no package registry here")
        assert done.returncode == 0, done.stderr
    return wheels[0], scripts / "stickslip-fit"


def lay_out(folder: Path) -> None:
    """The files that the commands find."""
    (folder / "plan.toml").write_text(PLAN)
    (folder / "short.toml").write_text(
        "[sessions]\ndates = [2012-03-05]\n[[sweep]]\njoint = 3\nq2_deg = -90\n"
    )
    (folder / "study.toml").write_text(STUDY)
    (folder / "law.toml").write_text(
        (CHECKOUT / "data" / "reference" / "law.toml").read_text("utf-8"), "utf-8"
    )
    (folder / "a.wav").write_bytes(b"RIFF")


@pytest.mark.nightly
def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(installed):
    files = subprocess.run(
        ["git", "ls-files", "stickslip_fit"], cwd=CHECKOUT, capture_output=True, text=True, check=True
    ).stdout.split()
    reference = {
        f"stickslip_fit/{path.relative_to(CHECKOUT)}" for path in (CHECKOUT / "data/reference").iterdir()
    }
    held = {name for name in zipfile.ZipFile(installed[0]).namelist() if ".dist-info/" not in name}
    assert held == {*files, *reference}


@pytest.mark.nightly
def test_every_command_works_in_an_empty_environment(installed, tmp_path):
    lay_out(tmp_path)
    for line, output in COMMANDS:
        done = run(tmp_path, installed[1], *line.split())
        assert done.returncode == 0, f"{line}\n{done.stderr}"
        assert (tmp_path / output).exists(), line


@pytest.mark.nightly
def test_what_needs_an_extra_says_which(installed, tmp_path):
    lay_out(tmp_path)
    written = ("fit.json", "tuning.json")
    for line, output in COMMANDS[1:]:
        if output in ("log.csv", "fit.png", "tuning.json"):
            assert run(tmp_path, installed[1], *line.split()).returncode == 0, line
    assert all((tmp_path / name).exists() for name in written)
    for line, extra in EXTRAS:
        done = run(tmp_path, installed[1], *line.split())
        assert done.returncode == 2, f"{line}\n{done.stderr}"
        assert f"pip install '{extra}'" in done.stderr, line
        assert "Traceback" not in done.stderr
