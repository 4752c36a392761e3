"""The operator at a terminal, and the unattended operator; keyboard input on POSIX systems and on Windows."""

from __future__ import annotations

import os
import re
import select
import sys
from contextlib import suppress
from importlib import import_module
from math import inf
from time import monotonic, sleep
from types import TracebackType
from typing import Any, Protocol, Self

import typer

from stickslip_fit.capture.operator import (
    CONDITIONS_EXAMPLE,
    Operator,
    OperatorChoice,
    OperatorReply,
    PlannedDrive,
    RigSetting,
    TraverseReading,
    format_conditions,
    format_position,
    format_reading,
    format_setting,
    parse_conditions,
)
from stickslip_fit.capture.protocols import Detection
from stickslip_fit.errors import InputError

NO_INPUT = (
    "the standard input has ended, so that nobody can answer; go on at a terminal with --resume, or try it "
    "with --emulate --unattended"
)
SPECIAL = "\x1b"  # any function key that has no letter here
# Keys without a character stand as letters of Unicode's private area, which no key types.
UP, DOWN, RIGHT, LEFT, PAGE_UP, PAGE_DOWN = "\ue000\ue001\ue002\ue003\ue004\ue005"
SEQUENCES = {"A": UP, "B": DOWN, "C": RIGHT, "D": LEFT, "5~": PAGE_UP, "6~": PAGE_DOWN}
WINDOWS_CODES = {"H": UP, "P": DOWN, "M": RIGHT, "K": LEFT, "I": PAGE_UP, "Q": PAGE_DOWN}
POLL = 0.02  # s between two queries of a keyboard that cannot be waited for


class Console(Protocol):
    """A terminal that delivers keys as they are pressed, without showing them, between `open` and `close`."""

    def open(self) -> None:
        """Switch to delivering every key at once."""

    def close(self) -> None:
        """Leave the terminal as it was."""

    def waiting(self, seconds: float | None) -> bool:
        """Whether there is a key to read within so many seconds."""

    def read(self) -> str:
        """Wait for input and return it."""


class PosixConsole(Console):
    """The standard input, read past Python's buffer, which would hide its content from `waiting`."""

    def __init__(self) -> None:
        self._before: list[Any] = []

    def open(self) -> None:
        import termios
        import tty

        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)

    def close(self) -> None:
        import termios

        with suppress(termios.error):  # the terminal may have been closed
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def waiting(self, seconds: float | None) -> bool:
        return bool(select.select([sys.stdin], [], [], seconds)[0])

    def read(self) -> str:
        try:
            text = os.read(sys.stdin.fileno(), 64).decode("utf-8", "replace")
        except OSError:  # of a terminal that was closed
            text = ""
        if not text:
            raise InputError(NO_INPUT)
        return re.sub(r"\x1b[\[O]([0-9;]*[A-Za-z~])", lambda found: SEQUENCES.get(found[1], SPECIAL), text)


class WindowsConsole(Console):
    """The console window, which always delivers keys at once, one at a time, and has to be polled."""

    def __init__(self) -> None:
        self._console: Any = import_module("msvcrt")

    def open(self) -> None:
        """See `Console.open`: nothing to do."""

    def close(self) -> None:
        """See `Console.close`."""

    def waiting(self, seconds: float | None) -> bool:
        end = monotonic() + (inf if seconds is None else seconds)
        while not self._console.kbhit():
            if monotonic() >= end:
                return False
            sleep(POLL)
        return True

    def read(self) -> str:
        key = self._console.getwch()
        if key == "\x03":
            raise KeyboardInterrupt  # Ctrl-C arrives as a key here
        if key == "\x00" or (key == "\xe0" and self._console.kbhit()):  # else an à
            return WINDOWS_CODES.get(self._console.getwch(), SPECIAL)
        return key


def system_console() -> Console:
    """The terminal of this system."""
    try:
        import_module("termios")
    except ImportError:
        return WindowsConsole()
    return PosixConsole()


class Keyboard:
    """The standard input key by key, while it is used as a context; line by line where it is no terminal.

    Everything raises InputError where the input has ended, since nobody can answer then.
    """

    def __init__(self) -> None:
        self._console: Console | None = None
        self._unread = ""

    def __enter__(self) -> Self:
        if sys.stdin is None:
            raise InputError(NO_INPUT)
        if sys.stdin.isatty():
            self._console = system_console()
            self._console.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._console is not None:
            self._console.close()
            self._console = None

    @property
    def at_terminal(self) -> bool:
        """Whether a key can be pressed at any time."""
        return self._console is not None

    def pressed(self) -> bool:
        """Whether a key was pressed since the last call; discards all input."""
        self._unread = ""
        return bool(self.take())

    def take(self) -> str:
        """The keys pressed since the last call; none where it is no terminal."""
        keys, self._unread = self._unread, ""
        while self._console is not None and self._console.waiting(0.0):
            keys += self._console.read()
        return keys

    def key(self, seconds: float | None = None) -> str:
        """Wait for a key, in lower case; empty for Enter, and where none comes within so many seconds."""
        if self._console is None:
            return self._read_line()[:1].lower()
        if seconds is not None and not (self._unread or self._console.waiting(seconds)):
            return ""
        return self._next(self._console).strip().lower()

    def line(self, label: str) -> str:
        """A line of text, typed after a label."""
        if self._console is None:
            return self._read_line()
        text = ""
        print(f"{label}: ", end="", flush=True)
        while (key := self._next(self._console)) not in "\r\n":  # Enter comes as either
            if key.isprintable():
                text += key
                print(key, end="", flush=True)
            elif key in "\b\x7f" and text:
                text = text[:-1]
                print("\b \b", end="", flush=True)
        print()
        return text.strip()

    def _read_line(self) -> str:
        line = sys.stdin.readline()
        if not line:
            raise InputError(NO_INPUT)
        return line.strip()

    def _next(self, console: Console) -> str:
        self._unread = self._unread or console.read()
        key, self._unread = self._unread[0], self._unread[1:]
        return key


DOUBT_SECONDS = 30.0  # s to wait for an answer on a doubtful reading, so that an unattended campaign goes on
PROGRESS_INTERVAL = 20  # checks
MAX_FAILURES = 3  # in a row, where nobody answers
KEY_HELP = {
    "r": "r makes it again",
    "s": "s leaves it out",
    "q": "q ends",
    "n": "n takes a note",
    "c": "c notes conditions",
}
KEY_CHOICES = {
    "": OperatorChoice.GO_ON,
    "r": OperatorChoice.REPEAT,
    "s": OperatorChoice.SKIP,
    "q": OperatorChoice.QUIT,
}


class ConsoleOutput(Operator):
    """Prints the progress of a capture; raises InputError or OSError where that is not possible."""

    def __init__(self) -> None:
        self._checks = 0

    def show(self, text: str) -> None:
        if sys.stdout is not None and sys.stdout.isatty():
            _write("\r\x1b[K")
        _write(f"{text}\n")

    def begin_drive(self, drive: PlannedDrive) -> None:
        self._checks = 0
        self.show(f"{drive.title} ({drive.row['joint']}{drive.row['direction']})")

    def progress(self, drive: PlannedDrive, steps: int, detection: Detection) -> None:
        """See `Operator.progress`; shown at a terminal only."""
        self._checks += 1
        if sys.stdout.isatty() and self._checks % PROGRESS_INTERVAL == 0:
            about = f" of about {drive.expected.steps:,.0f}" if drive.expected.known else ""
            _write(f"\r\x1b[K  {steps:,}{about} steps, {detection.level:+.1f} dB")


def _write(text: str) -> None:
    if sys.stdout is None:
        raise InputError("nothing can be shown, since the standard output is closed; go on with --resume")
    typer.echo(text, nl=False)  # flushes, and old Windows consoles have escapes translated


class TerminalOperator(ConsoleOutput):
    """Asks at the terminal."""

    def __init__(self, keys: Keyboard) -> None:
        super().__init__()
        self.keys = keys

    def begin_session(self, label: str) -> OperatorReply:
        return self._ask(f"Session {label}: switch on and warm up.", "sqc")

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        return self._ask(format_setting(wanted, before), "sqc")

    def bring_joint(self, joint: int, position: float) -> OperatorReply:
        return self._ask(f"Bring joint {joint} to {format_position(joint, position)} by hand.", "sqc")

    def stop_wanted(self) -> bool:
        return self.keys.pressed()

    def review(self, reading: TraverseReading) -> OperatorReply:
        """See `Operator.review`; a doubtful one is kept unless answered in time."""
        self.show(format_reading(reading))
        if not reading.deviation:
            return OperatorReply()
        return self._ask(f"kept in {DOUBT_SECONDS:.0f} s", "rsqnc", DOUBT_SECONDS)

    def handle_failure(self, drive: PlannedDrive, reason: str) -> OperatorReply:
        return self._ask(f"Broken off: {reason}.", "sqnc")

    def _ask(self, question: str, choices: str, seconds: float | None = None) -> OperatorReply:
        keys = ["Enter goes on", *(KEY_HELP[key] for key in choices), "p waits"]
        self.show(f"{question}\n  [{', '.join(keys)}]")
        note, conditions = "", dict[str, float]()
        while True:
            key = self.keys.key(seconds)
            if key == "n" and key in choices:
                note = self.keys.line("note")
            elif key == "c" and key in choices:
                conditions |= self._ask_conditions()
            elif key in KEY_CHOICES and (not key or key in choices):
                return OperatorReply(KEY_CHOICES[key], note, conditions)
            seconds = None  # somebody is there: wait for the answer

    def _ask_conditions(self) -> dict[str, float]:
        self.show(f"  as a log's columns have them, e.g. {CONDITIONS_EXAMPLE}")
        try:
            conditions = parse_conditions(self.keys.line("conditions"))
        except InputError as error:
            self.show(f"  {error}; nothing is changed, c once more")
            return {}
        self.show(f"  from now on {format_conditions(conditions)}" if conditions else "  nothing is changed")
        return conditions


class UnattendedOperator(ConsoleOutput):
    """Takes everything to be set as asked; quits after three failures in a row."""

    def __init__(self) -> None:
        super().__init__()
        self._failures = 0

    def begin_session(self, label: str) -> OperatorReply:
        self.show(f"Session {label}")
        return OperatorReply()

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        self.show(format_setting(wanted, before))
        return OperatorReply()

    def bring_joint(self, joint: int, position: float) -> OperatorReply:
        self.show(f"joint {joint} brought to {format_position(joint, position)} by hand")
        return OperatorReply()

    def stop_wanted(self) -> bool:
        return False

    def review(self, reading: TraverseReading) -> OperatorReply:
        self._failures = 0
        self.show(format_reading(reading))
        return OperatorReply()

    def handle_failure(self, drive: PlannedDrive, reason: str) -> OperatorReply:
        self._failures += 1
        self.show(f"  broken off: {reason}")
        return OperatorReply(OperatorChoice.QUIT if self._failures >= MAX_FAILURES else OperatorChoice.GO_ON)
