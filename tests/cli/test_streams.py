"""Whatever the command line prints to, it ends with a status and at most one message."""

import errno
import io
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

import stickslip_fit as ssf
from stickslip_fit.cli._streams import open_standard_streams, run_with_streams
from stickslip_fit.errors import InputError

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "data" / "reference"


class Failing(io.TextIOWrapper):
    """Standard output on a device that fails."""

    def __init__(self, number: int) -> None:
        super().__init__(io.BytesIO(), encoding="utf-8")
        self.number = number

    def write(self, text: str) -> int:
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize(
    ("number", "status", "told"),
    [
        (errno.ENOSPC, 1, "standard output: cannot be written (No space left on device)\n"),
        (errno.EBADF, 1, "standard output: cannot be written (Bad file descriptor)\n"),
        (errno.EPIPE, 141, ""),
    ],
)
def test_output_that_cannot_be_written_ends_with_one_message(number, status, told, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", Failing(number))
    assert run_with_streams(lambda: print("result")) == status
    assert capsys.readouterr().err == told


def test_a_message_that_cannot_be_written_either_changes_no_status(monkeypatch):
    def refuse() -> None:
        raise InputError("no such log")

    monkeypatch.setattr(sys, "stderr", Failing(errno.ENOSPC))
    assert run_with_streams(refuse) == 2


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("utf-8", "8.1 ± 0.2 µm, γ₀ caf\udce9.csv".encode("utf-8", "surrogateescape")),
        ("ascii", b"8.1 +- 0.2 um, gamma\\u2080 caf\xe9.csv"),
        ("latin-1", "8.1 ± 0.2 µm, ".encode("latin-1") + b"gamma\\u2080 caf\xe9.csv"),
    ],
)
def test_no_character_is_refused_and_units_stay_apart(encoding, shown, monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    open_standard_streams()
    print("8.1 ± 0.2 µm, γ₀ caf\udce9.csv", end="", flush=True)
    assert raw.getvalue() == shown


COMMANDS = {
    "help": ["--help"],
    "version": ["--version"],
    "check": ["check", "log.csv"],
    "calibrate": ["calibrate", "log.csv", "--json", "a.json", "--chart", "a.svg"],
    "fit": ["fit", "log.csv", "--json", "b.json"],
    "predict": ["predict", "fit.json", "plan.toml", "-o", "c.csv"],
    "anova": ["anova", "log.csv", "--json", "d.json"],
    "diagnose": ["diagnose", "log.csv", "--json", "e.json", "--report", "e.html"],
    "report": ["report", "log.csv", "--no-diagnosis", "--no-strategies", "-o", "f.html"],
    "compare": ["compare", "log.csv", "--numbers", "g"],
    "study": ["study", "study.toml", "--campaigns", "1", "--workers", "1", "-o", "h"],
    "simulate": ["simulate", "plan.toml", "--law", "law.toml", "-o", "i.csv", "--force"],
    "plan": ["plan", "log.csv", "--json", "j.json"],
    "sheet": ["sheet", "plan.toml", "-o", "k.csv", "--force"],
    "plan-move": ["plan-move", "fit.json", "--at", "0,-90,0", "--joints", "20,-60,6"],
    "dead-reckon": ["dead-reckon", "fit.json", "--at=0,-90,0", "--drive", "3+2000"],
    "drive": ["drive", "fit.json", "--at=0,-90,6", "--script", "path.csv", "--emulate"],
    "demo": ["demo", "log.csv", "--no-browse"],
    "capture-tune": ["capture", "tune", "-o", "l.json", "--emulate", "--force"],
    "capture-listen": ["capture", "listen", "absent.wav", "--tuning", "absent.json"],
    "capture": ["capture", "short.toml", "-o", "m.csv", "--emulate", "--unattended", "--ideal-detector"],
}
POSIX_LOCALE = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
CONDITIONS = {
    "POSIX locale": ("", POSIX_LOCALE, None),
    "full": (">/dev/full", {}, 1),
    "closed output": (">&-", {}, 1),
    "closed errors": ("2>&-", {}, None),
    "full errors": ("2>/dev/full", {}, None),
    "closed input": ("<&-", {}, None),
    "all closed": ("<&- >&- 2>&-", {}, 1),
    "no reader": ("| true", {}, 141),
    "narrow": ("", {"COLUMNS": "20", "NO_COLOR": "1"}, None),
    "no home": ("", {"HOME": None, "MPLCONFIGDIR": None, "XDG_CACHE_HOME": None}, None),
    "home is absent": ("", {"HOME": "/nonexistent"}, None),
}


def run_in_shell(
    words: list[str], streams: str, changes: dict[str, str | None], folder: Path
) -> tuple[int, str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    for name, value in changes.items():
        environment.pop(name, None)
        if value is not None:
            environment[name] = value
    program = " ".join([sys.executable, "-m", "stickslip_fit", *words, "2>>errors", streams])
    shell = ["bash", "-c", f"set -o pipefail; {program}"]
    (folder / "errors").write_text("")
    ended = subprocess.run(shell, cwd=folder, env=environment, stdout=subprocess.DEVNULL, check=False)
    return ended.returncode, (folder / "errors").read_text("utf-8", "replace")


@pytest.fixture(scope="module")
def folder(campaign, tmp_path_factory):
    """A log, its fit, and plans that take no time."""
    place = tmp_path_factory.mktemp("commands")
    campaign(("2012-03-05", "2012-03-06"), replicates=1).to_csv(place / "log.csv", index=False)
    for name in ("plan.toml", "law.toml", "study.toml"):
        (place / name).write_bytes((REFERENCE / name).read_bytes())
    short = "[sessions]\ndates = [2012-03-20]\n[[sweep]]\njoint = 3\nq2_deg = [-30]\n"
    (place / "short.toml").write_text(short)
    (place / "path.csv").write_text("time_s,vx_um_s,vy_um_s,vz_um_s\n0,20,0,0\n1,0,0,0\n")
    ssf.calibrate(ssf.read_log(place / "log.csv")).save(place / "fit.json")
    return place


QUICK = {("version", "full"), ("help", "no reader"), ("version", "all closed"), ("help", "POSIX locale")}
PAIRS = [
    pytest.param(*pair, marks=() if pair in QUICK else pytest.mark.nightly)
    for pair in product(COMMANDS, CONDITIONS)
]


@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
@pytest.mark.parametrize(("command", "condition"), PAIRS)
def test_every_command_under_every_condition(command, condition, folder):
    streams, changes, status = CONDITIONS[condition]
    for leftover in folder.glob("m.csv*"):
        leftover.unlink()
    ended, errors = run_in_shell(COMMANDS[command], streams, changes, folder)
    assert "Traceback" not in errors
    assert "Exception ignored" not in errors
    refused = command == "capture-listen"  # its recording is absent
    assert ended == (2 if refused else status or 0), errors
