"""An interrupt ends the command line with status 130 and one message, whatever it is doing."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MESSAGE = "interrupted; nothing was left half-written\n"
pytestmark = pytest.mark.skipif(os.name != "posix", reason="interrupts are sent as on POSIX systems")

# Interrupts itself as a module is imported, by code that makes every failure an ImportError.
IMPORTING = """
import os, signal, sys
from stickslip_fit.__main__ import main

class Finder:
    def find_spec(self, name, *_):
        if name == {module!r}:
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except BaseException:
                raise ImportError("lost")

sys.meta_path.insert(0, Finder())
sys.argv = ["stickslip-fit", *{arguments!r}]
main()
"""
# Interrupts itself in a destructor, where Python can raise nothing.
DESTROYING = """
import os, signal, sys
from stickslip_fit import __main__ as program

class Thing:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000): pass

class Commands:
    @staticmethod
    def main():
        Thing()

sys.modules["stickslip_fit.cli"] = Commands
program.main()
"""
# Interrupts itself at work, and tidies up.
WORKING = """
import os, signal, sys
from stickslip_fit import __main__ as program

class Commands:
    @staticmethod
    def main():
        try:
            os.kill(os.getpid(), signal.SIGINT)
        finally:
            print("tidied up", file=sys.stderr)

sys.modules["stickslip_fit.cli"] = Commands
program.main()
"""
# Interrupts itself when all is done and Python ends.
ENDING = """
import atexit, os, signal, sys
from stickslip_fit import __main__ as program

class Commands:
    @staticmethod
    def main():
        raise SystemExit(2)

atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
sys.modules["stickslip_fit.cli"] = Commands
program.main()
"""


def heed_interrupts():
    """As in a terminal: a shell in the background makes its programs ignore interrupts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def run_code(code: str) -> tuple[int, str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    program = [sys.executable, "-c", code]
    ended = subprocess.run(
        program, capture_output=True, text=True, env=environment, check=False, preexec_fn=heed_interrupts
    )
    return ended.returncode, ended.stderr


@pytest.mark.parametrize(
    ("code", "status", "told"),
    [
        (IMPORTING.format(module="typer", arguments=["--help"]), 130, MESSAGE),
        (IMPORTING.format(module="numpy", arguments=["check", "log.csv"]), 130, MESSAGE),
        (WORKING, 130, "tidied up\n" + MESSAGE),
        (DESTROYING, 130, MESSAGE),
        (ENDING, 2, ""),
    ],
    ids=["as the program loads", "as a command loads", "at work", "in a destructor", "as Python ends"],
)
def test_an_interrupt_ends_it_with_one_message(code, status, told):
    assert run_code(code) == (status, told)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["check", "log.csv"],
        ["fit", "log.csv", "--json", "fit.json"],
        ["diagnose", "log.csv", "--json", "diagnosis.json", "--report", "page.html"],
    ],
    ids=lambda words: words[0],
)
def test_an_interrupt_at_any_moment(words, campaign, tmp_path, monkeypatch):
    """Python itself complains while it starts, before it reads a line of ours: no program can mend that."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    # A test run in the background ignores interrupts, and would hand that on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    campaign(("2012-03-05",), replicates=1).to_csv("log.csv", index=False)
    program, rng = [sys.executable, "-m", "stickslip_fit", *words], random.Random(1)
    begun = time.monotonic()
    subprocess.run(program, capture_output=True, check=True)
    longest = time.monotonic() - begun
    for _ in range(100):
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with subprocess.Popen(program, text=True, preexec_fn=heed_interrupts, **pipes) as running:
            time.sleep(rng.uniform(0.0, longest))
            running.send_signal(signal.SIGINT)
            _, errors = running.communicate(timeout=20)
        if "Traceback" in errors:
            assert str(ROOT / "stickslip_fit") not in errors, errors
            assert "<frozen " in errors
        else:
            assert (running.returncode, errors) in {(130, MESSAGE), (0, ""), (-signal.SIGINT, "")}
    assert not list(tmp_path.glob(".stickslip-fit-*"))
