"""The keyboard drives the emulated rig in a pseudo-terminal, by the real clock."""

import os
import re
import select
import signal
import sys
import time

import pytest

pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")
PATIENCE = 60.0  # s


class Terminal:
    """A drive in a terminal of its own."""

    def __init__(self, result):
        self.said = b""
        self.child, self.handle = pty.fork()
        if self.child == 0:
            program = [sys.executable, "-m", "stickslip_fit", "drive", str(result)]
            os.environ.update(COLUMNS="100", LINES="40")
            os.execv(sys.executable, [*program, "--at", "0,-70,5", "--emulate", "--speed", "100"])

    def watch(self, seconds, until=b"\x00"):
        end = time.monotonic() + seconds
        while time.monotonic() < end and until not in self.said:
            if select.select([self.handle], [], [], 0.02)[0]:
                try:
                    self.said += os.read(self.handle, 65_536)
                except OSError:  # the program has ended
                    return

    def press(self, keys):
        for key in keys:
            os.write(self.handle, key)
            self.watch(0.035)

    def ended(self):
        self.watch(PATIENCE)
        status = os.waitstatus_to_exitcode(os.waitpid(self.child, 0)[1])
        os.close(self.handle)
        return status

    @property
    def steps(self):
        found = re.findall(r"joint 3 .*?, ([+-][\d,]+) steps", self.said.decode("utf-8", "replace"))
        return int(found[-1].replace(",", ""))


@pytest.fixture
def terminal(arm, tmp_path):
    arm.result.save(tmp_path / "fit.json")
    terminal = Terminal(tmp_path / "fit.json")
    terminal.watch(PATIENCE, b"limits")
    return terminal


@pytest.mark.nightly
def test_keys_move_the_tip_and_the_terminal_is_left_clean(terminal):
    terminal.press([b"d"] * 20)
    terminal.watch(0.3)
    moved = terminal.steps
    assert 30 <= moved <= 90
    terminal.watch(1.0)
    assert terminal.steps == moved
    terminal.press([b"q"])
    assert terminal.ended() == 0
    assert terminal.said.count(b"\x1b[?25l") == terminal.said.count(b"\x1b[?25h") == 1
    assert b"Tip at (" in terminal.said


@pytest.mark.nightly
def test_ctrl_c_ends_it_with_the_verdict(terminal):
    terminal.press([b"d"] * 5)
    os.kill(terminal.child, signal.SIGINT)
    assert terminal.ended() == 0
    assert b"stopped by Ctrl-C" in terminal.said
    assert b"\x1b[?25h" in terminal.said
