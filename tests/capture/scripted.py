"""A controller that knows one conversation by heart, and nothing but that."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from stickslip_fit.capture.nanocontrol import LineTransport
from stickslip_fit.capture.protocols import VirtualClock

Pairs = list[tuple[bytes | None, bytes | None]]


class ScriptedWire:
    """Commands and replies in order; None for a command is a line that nobody asked for."""

    def __init__(self, pairs: Pairs, clock: VirtualClock, at_once: int) -> None:
        self.pairs = list(pairs)
        self.clock = clock
        self.at_once = at_once
        self.written = b""
        self.unread = b""
        self._unasked()

    def write(self, data: bytes) -> None:
        self.written += data
        assert self.pairs, f"{data!r} was sent after the last command"
        command, reply = self.pairs[0]
        assert command is not None
        assert command.startswith(self.written), f"{self.written!r} was sent instead of {command!r}"
        if self.written == command:
            self.pairs.pop(0)
            self.written = b""
            self.unread += reply or b""
            self._unasked()

    def read(self, seconds: float) -> bytes:
        if not self.unread:
            self.clock.sleep(seconds)
        read, self.unread = self.unread[: self.at_once], self.unread[self.at_once :]
        return read

    def close(self) -> None:
        pass

    def _unasked(self) -> None:
        while self.pairs and self.pairs[0][0] is None:
            self.unread += self.pairs.pop(0)[1] or b""


@contextmanager
def conversation(make: Any, end: str, pairs: Pairs, at_once: int = 4096) -> Iterator[Any]:
    """A controller made from a line that speaks these pairs; nothing may be left over at the end."""
    clock = VirtualClock()
    wire = ScriptedWire(pairs, clock, at_once)
    yield make(LineTransport(wire, clock, end))
    assert not wire.pairs, f"never sent: {wire.pairs}"
    assert not wire.written, f"half a command: {wire.written!r}"
    assert not wire.unread, f"never read: {wire.unread!r}"
