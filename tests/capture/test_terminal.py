"""Keys pressed at a real pseudo-terminal, and what they are taken to mean."""

import os
import subprocess
import sys
from collections import deque
from io import StringIO
from itertools import count
from types import SimpleNamespace

import pandas as pd
import pytest

from stickslip_fit.capture import terminal
from stickslip_fit.capture.operator import (
    ExpectedCount,
    OperatorChoice,
    OperatorReply,
    PlannedDrive,
    RigSetting,
    TraverseReading,
    format_setting,
)
from stickslip_fit.capture.terminal import (
    LEFT,
    PAGE_DOWN,
    SPECIAL,
    UP,
    Keyboard,
    TerminalOperator,
    UnattendedOperator,
)
from stickslip_fit.errors import InputError

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
WORK = PlannedDrive(
    pd.Series({"joint": 3, "direction": "+", "start": 0.0, "stop": 0.012}),
    "1 of 2: joint 3",
    ExpectedCount(12300.0, 12200.0, 12400.0),
)
GOOD = TraverseReading(WORK, 12305, 0.012 / 12302.5, "")
ODD = TraverseReading(WORK, 13005, 0.012 / 13002.5, "5.7 % more steps than predicted (12,300)")


@pytest.fixture
def hand(monkeypatch):
    """Types at the terminal that the keys are read from."""
    pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals", exc_type=ImportError)
    master, slave = pty.openpty()
    with os.fdopen(slave) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield lambda text: os.write(master, text.encode("utf-8"))
    os.close(master)


class Window:
    """A console window as `msvcrt` has it; keys come in so many looks after they were typed."""

    def __init__(self, looks: int = 0) -> None:
        self.typed: deque[str] = deque()
        self.looks = looks

    def kbhit(self) -> bool:
        self.looks -= 1
        return self.looks < 0 and bool(self.typed)

    def getwch(self) -> str:
        assert self.typed, "would wait for ever"
        return self.typed.popleft()


@pytest.fixture
def window(monkeypatch):
    """Takes the place of the keyboard on a system without termios."""
    found = Window()
    monkeypatch.setitem(sys.modules, "termios", None)
    monkeypatch.setitem(sys.modules, "msvcrt", found)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    return found


ANSWERS = pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("\n", OperatorReply()),
        ("r", OperatorReply(OperatorChoice.REPEAT)),
        ("\r", OperatorReply()),
        ("nshut\r\r", OperatorReply(note="shut")),
        ("S", OperatorReply(OperatorChoice.SKIP)),
        ("q", OperatorReply(OperatorChoice.QUIT)),
        ("x7r", OperatorReply(OperatorChoice.REPEAT)),
        ("p\n", OperatorReply()),
        ("nTür zuu\x7f\n\n", OperatorReply(note="Tür zu")),
        ("nloud\nr", OperatorReply(OperatorChoice.REPEAT, "loud")),
        (
            "ctemperature_C=22.5 payload_g=2\n\n",
            OperatorReply(conditions={"temperature": 295.65, "payload": 0.002}),
        ),
        (
            "ctemperature=22.5\nccold\nchumidity_pct = 40\nr",
            OperatorReply(OperatorChoice.REPEAT, "", {"humidity": 0.4}),
        ),
    ],
)


@ANSWERS
def test_a_doubtful_reading_is_answered(hand, typed, meant):
    with Keyboard() as keys:
        hand(typed)
        assert TerminalOperator(keys).review(ODD) == meant


@ANSWERS
def test_a_doubtful_reading_is_answered_in_a_console_window(window, typed, meant):
    with Keyboard() as keys:
        window.typed += typed.replace("\x7f", "\b").replace("\n", "\r")
        assert TerminalOperator(keys).review(ODD) == meant


def test_an_arrow_is_no_answer_and_no_text_in_a_console_window(window):
    with Keyboard() as keys:
        window.typed += ["\xe0", "C", "\x00", "r", "n", "\xe0", "K", "a", "\r", "s"]
        assert TerminalOperator(keys).review(ODD) == OperatorReply(OperatorChoice.SKIP, "a")
        window.typed.append("\xe0")  # the à of a keyboard that has one: nothing waits behind it
        assert keys.key() == "à"


def test_a_good_reading_is_shown_with_the_law_beside_it_and_not_waited_for(hand, capsys):
    with Keyboard() as keys:
        assert TerminalOperator(keys).review(GOOD) == OperatorReply()
    assert capsys.readouterr().out.strip() == "12,305 steps, 975.41 nm a step; the law says 12,300, 975.61 nm"


def test_where_nobody_answers_a_doubtful_reading_is_kept(hand, monkeypatch):
    monkeypatch.setattr(terminal, "DOUBT_SECONDS", 0.01)
    with Keyboard() as keys:
        assert TerminalOperator(keys).review(ODD) == OperatorReply()


def test_where_nobody_answers_at_a_console_window_a_doubtful_reading_is_kept(window, monkeypatch):
    ticks = count()
    monkeypatch.setattr(terminal, "monotonic", lambda: float(next(ticks)))
    monkeypatch.setattr(terminal, "sleep", lambda seconds: None)
    with Keyboard() as keys:
        assert TerminalOperator(keys).review(ODD) == OperatorReply()
    assert next(ticks) == pytest.approx(terminal.DOUBT_SECONDS + 2, abs=1)


def test_once_somebody_has_answered_there_is_no_hurry(hand, monkeypatch):
    monkeypatch.setattr(terminal, "DOUBT_SECONDS", 0.2)
    with Keyboard() as keys:
        hand("pr")
        assert TerminalOperator(keys).review(ODD) == OperatorReply(OperatorChoice.REPEAT)


def test_repeat_is_no_answer_to_a_setting(hand):
    with Keyboard() as keys:
        hand("rs")
        assert TerminalOperator(keys).set_up(RigSetting(0.0, 0.0), None) == OperatorReply(OperatorChoice.SKIP)


def test_any_key_stops_a_drive_once(hand):
    with Keyboard() as keys:
        operator = TerminalOperator(keys)
        assert not operator.stop_wanted()
        hand("\x1b[A")  # an arrow key is three bytes
        assert operator.stop_wanted()
        assert not operator.stop_wanted()


def test_any_key_stops_a_drive_once_in_a_console_window(window):
    with Keyboard() as keys:
        operator = TerminalOperator(keys)
        assert not operator.stop_wanted()
        window.typed += ["\xe0", "H"]
        assert operator.stop_wanted()
        assert not operator.stop_wanted()


def test_control_c_ends_it_in_a_console_window(window):
    with Keyboard() as keys:
        window.typed.append("\x03")
        with pytest.raises(KeyboardInterrupt):
            keys.key()


def test_a_key_that_comes_late_is_waited_for(window, monkeypatch):
    monkeypatch.setattr(terminal, "POLL", 0.001)
    window.looks = 20
    with Keyboard() as keys:
        window.typed.append("R")
        assert keys.key(30.0) == "r"
    assert window.looks < 0


# In each run tests/packaging/test_portability.py reads the imports of every file.
@pytest.mark.nightly
def test_capture_is_imported_where_there_is_no_termios():
    code = """
import sys
from pkgutil import walk_packages
from importlib import import_module
for name in ("termios", "tty", "pty", "fcntl"):
    sys.modules[name] = None
import stickslip_fit.capture as capture
for module in walk_packages(capture.__path__, "stickslip_fit.capture."):
    if not module.name.endswith("__main__"):
        import_module(module.name)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_terminal_is_left_as_it_was(hand):
    import termios

    before = termios.tcgetattr(sys.stdin)
    with Keyboard():
        assert termios.tcgetattr(sys.stdin) != before
    assert termios.tcgetattr(sys.stdin) == before


@POSIX
def test_a_terminal_that_is_closed_ends_it_with_a_message(monkeypatch):
    import pty

    master, slave = pty.openpty()
    with os.fdopen(slave) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with Keyboard() as keys:
            os.close(master)
            with pytest.raises(InputError, match="nobody can answer"):
                keys.pressed()
            with pytest.raises(InputError, match="nobody can answer"):
                keys.key()


@pytest.mark.parametrize("ask", [lambda keys: keys.key(), lambda keys: keys.line("note")])
def test_input_that_has_ended_is_no_answer(monkeypatch, ask):
    monkeypatch.setattr(sys, "stdin", StringIO())
    with Keyboard() as keys, pytest.raises(InputError, match="nobody can answer"):
        ask(keys)
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="nobody can answer"), Keyboard():
        pass


class FullDisk(StringIO):
    def write(self, text):
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize(("stdout", "error"), [(None, InputError), (FullDisk(), OSError)])
def test_output_that_nobody_can_read_ends_it(monkeypatch, stdout, error):
    monkeypatch.setattr(sys, "stdout", stdout)
    for show in (lambda each: each.show("Bring joint 3"), lambda each: each.begin_drive(WORK)):
        with pytest.raises(error, match=r"nothing can be shown|No space left"):
            show(UnattendedOperator())


def test_only_what_changes_is_asked_for():
    before = RigSetting(0.0, 0.5, ((2, -1.0, 0.0),))
    assert format_setting(RigSetting(0.5, 0.5, before.stops), before) == "Set theta to 28.6 deg."
    assert format_setting(RigSetting(0.0, 0.5), before) == "Take the stops of joint 2 away."


def test_where_nobody_is_there_a_drive_that_keeps_failing_ends_it():
    nobody = UnattendedOperator()
    answers = [nobody.handle_failure(WORK, "deaf").choice for _ in range(3)]
    assert answers == [OperatorChoice.GO_ON, OperatorChoice.GO_ON, OperatorChoice.QUIT]
    nobody = UnattendedOperator()
    nobody.handle_failure(WORK, "deaf")
    nobody.handle_failure(WORK, "deaf")
    nobody.review(GOOD)
    assert nobody.handle_failure(WORK, "deaf").choice is OperatorChoice.GO_ON


@POSIX
def test_arrows_are_keys_that_nobody_can_type_into_a_note(hand):
    with Keyboard() as keys:
        hand("\x1b[A\x1bOD\x1b[6~\x1b[15~w")
        assert keys.take() == UP + LEFT + PAGE_DOWN + SPECIAL + "w"
        assert keys.take() == ""
        hand("\x1b[Cnlo\x1b[Au\x1b[1;5Cd\x1bOR\ns")  # the first ends in a letter that is a choice
        assert TerminalOperator(keys).review(ODD) == OperatorReply(OperatorChoice.SKIP, "loud")


def test_arrows_in_a_console_window(window):
    with Keyboard() as keys:
        window.typed.extend("\xe0H\x00Q\xe0;w")
        assert keys.take() == UP + PAGE_DOWN + SPECIAL + "w"
