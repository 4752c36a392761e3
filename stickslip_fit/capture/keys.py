"""The keyboard: a key as it is pressed, where there is a terminal; a line where there is none."""

from __future__ import annotations

import os
import select
import sys
from types import TracebackType
from typing import Any, Self

ENDED = "q"  # what the end of the input means


class Keys:
    """Reads the standard input key by key, as long as it is used as a context."""

    def __init__(self) -> None:
        self._before: list[Any] | None = None
        self._ahead = ""  # typed, and not asked for yet

    def __enter__(self) -> Self:
        if sys.stdin.isatty():
            import termios
            import tty

            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)
            self._before = None

    def pressed(self) -> bool:
        """Whether a key was pressed since; it counts as read. What was typed ahead of that is forgotten."""
        self._ahead = ""
        return self._before is not None and self._waiting(0.0) and bool(self._typed())

    def key(self, seconds: float | None = None) -> str:
        """Wait for a key, for so many seconds or as long as it takes.

        Returns
        -------
        str
            In lower case; empty for Enter, and where none was pressed in time.
        """
        if self._before is None:
            line = sys.stdin.readline()
            return line.strip()[:1].lower() if line else ENDED
        if seconds is not None and not self._waiting(seconds):
            return ""
        return self._next().strip().lower()

    def line(self, label: str) -> str:
        """A line of text as it is typed behind a label."""
        if self._before is None:
            return sys.stdin.readline().strip()
        text = ""
        print(f"{label}: ", end="", flush=True)
        while (key := self._next()) not in "\r\n":  # Python 3.12.0 and .1 leave Enter as it comes
            text = text[:-1] if key in "\b\x7f" else text + key
            print(f"\r\x1b[K{label}: {text}", end="", flush=True)
        print()
        return text.strip()

    def _next(self) -> str:
        self._ahead = self._ahead or self._typed()
        key, self._ahead = self._ahead[0], self._ahead[1:]
        return key

    def _waiting(self, seconds: float) -> bool:
        return bool(self._ahead or select.select([sys.stdin], [], [], seconds)[0])

    @staticmethod
    def _typed() -> str:
        """What has been typed; waits for it. Past Python's buffer, which would hide it from `_waiting`."""
        typed = os.read(sys.stdin.fileno(), 64).decode("utf-8", "replace")
        if not typed:
            raise KeyboardInterrupt  # the terminal is gone, and with it whoever could answer
        return typed
