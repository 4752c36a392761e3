"""The keyboard: a key as it is pressed, where there is a terminal; a line where there is none."""

from __future__ import annotations

import os
import re
import select
import sys
from importlib import import_module
from math import inf
from time import monotonic, sleep
from types import TracebackType
from typing import Any, Protocol, Self

ENDED = "q"  # what the end of the input means
SPECIAL = "\x1b"  # an arrow or a function key, whichever
POLL = 0.02  # s between two looks at a keyboard that cannot be waited for


class Console(Protocol):
    """A terminal from which keys come as they are pressed, not shown, between `open` and `close`."""

    def open(self) -> None:
        """Have every key at once."""

    def close(self) -> None:
        """Leave the terminal as it was."""

    def waiting(self, seconds: float | None) -> bool:
        """Whether a key is there to be read, within so many seconds."""
        ...

    def typed(self) -> str:
        """What has been typed; waits for it."""
        ...


class PosixConsole:
    """The standard input, read past Python's buffer, which would hide from `waiting` what is in it."""

    def __init__(self) -> None:
        self._before: list[Any] = []

    def open(self) -> None:
        """See `Console.open`."""
        import termios
        import tty

        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)

    def close(self) -> None:
        """See `Console.close`."""
        import termios

        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def waiting(self, seconds: float | None) -> bool:
        """See `Console.waiting`."""
        return bool(select.select([sys.stdin], [], [], seconds)[0])

    def typed(self) -> str:
        """See `Console.typed`."""
        typed = os.read(sys.stdin.fileno(), 64).decode("utf-8", "replace")
        if not typed:
            raise KeyboardInterrupt  # the terminal is gone, and with it whoever could answer
        return re.sub(r"\x1b[\[O][0-9;]*[A-Za-z~]", SPECIAL, typed)


class WindowsConsole:
    """The console window, which gives keys one by one and cannot be waited for but by looking."""

    def __init__(self) -> None:
        self._console: Any = import_module("msvcrt")

    def open(self) -> None:
        """See `Console.open`: it always does."""

    def close(self) -> None:
        """See `Console.close`."""

    def waiting(self, seconds: float | None) -> bool:
        """See `Console.waiting`."""
        end = monotonic() + (inf if seconds is None else seconds)
        while not self._console.kbhit():
            if monotonic() >= end:
                return False
            sleep(POLL)
        return True

    def typed(self) -> str:
        """See `Console.typed`."""
        key = self._console.getwch()
        if key == "\x03":
            raise KeyboardInterrupt  # Ctrl-C, which this way of reading takes for a key
        if key == "\x00" or (key == "\xe0" and self._console.kbhit()):  # else an à
            self._console.getwch()  # says which
            return SPECIAL
        return key


class Keys:
    """Reads the standard input key by key, as long as it is used as a context."""

    def __init__(self) -> None:
        self._console: Console | None = None
        self._ahead = ""  # typed, and not asked for yet

    def __enter__(self) -> Self:
        if sys.stdin.isatty():
            self._console = console()
            self._console.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._console is not None:
            self._console.close()
            self._console = None

    def pressed(self) -> bool:
        """Whether a key was pressed since; it counts as read. What was typed ahead of that is forgotten."""
        self._ahead, pressed = "", False
        while self._console is not None and self._console.waiting(0.0):
            pressed = bool(self._console.typed())
        return pressed

    def key(self, seconds: float | None = None) -> str:
        """Wait for a key, for so many seconds or as long as it takes.

        Returns
        -------
        str
            In lower case; empty for Enter, and where none was pressed in time.
        """
        if self._console is None:
            line = sys.stdin.readline()
            return line.strip()[:1].lower() if line else ENDED
        if seconds is not None and not (self._ahead or self._console.waiting(seconds)):
            return ""
        return self._next(self._console).strip().lower()

    def line(self, label: str) -> str:
        """A line of text as it is typed behind a label."""
        if self._console is None:
            return sys.stdin.readline().strip()
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

    def _next(self, console: Console) -> str:
        self._ahead = self._ahead or console.typed()
        key, self._ahead = self._ahead[0], self._ahead[1:]
        return key


def console() -> Console:
    """The terminal of this system."""
    try:
        import_module("termios")
    except ImportError:
        return WindowsConsole()
    return PosixConsole()
