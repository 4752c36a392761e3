"""Lines of text over a wire, kept whole: what has come of a line stays until the rest has."""

from __future__ import annotations

import re
from typing import Protocol

from stickslip_fit.capture.clock import Clock
from stickslip_fit.capture.controller import Unplugged


class Wire(Protocol):
    """Bytes, there and back. Any OSError means that the connection is lost."""

    def write(self, data: bytes) -> None:
        """Send."""
        ...

    def read(self, seconds: float) -> bytes:
        """What has come, as soon as there is any; nothing if nothing comes within so long."""
        ...

    def close(self) -> None:
        """Give the connection back."""
        ...


class Line:
    """Commands sent and lines received over a wire.

    Parameters
    ----------
    wire : Wire
    clock : Clock
        By which time-outs run.
    end : str
        What ends a command.
    """

    def __init__(self, wire: Wire, clock: Clock, end: str) -> None:
        self.clock = clock
        self.end = end
        self._wire = wire
        self._come = ""

    @property
    def begun(self) -> str:
        """What has come of a line that has not ended yet."""
        return self._come

    def send(self, command: str) -> None:
        """Send a command.

        Raises
        ------
        Unplugged
            If the connection is lost.
        """
        try:
            self._wire.write((command + self.end).encode("ascii"))
        except OSError as error:
            raise _unplugged(error) from error

    def receive(self, seconds: float) -> str | None:
        """The next line that is not empty, without its end; None if it isn't whole within so long.

        Raises
        ------
        Unplugged
            If the connection is lost.
        """
        latest, in_time = self.clock.now() + seconds, True
        while not (line := self._take()):
            if line is None:
                if not in_time:
                    return None
                left = latest - self.clock.now()
                in_time = left > 0
                self._more(max(left, 0.0))
        return line

    def everything(self, seconds: float) -> str:
        """All that comes within so long, and all that has come before, ended or not."""
        latest = self.clock.now() + seconds
        while self._more(max(latest - self.clock.now(), 0.0)) or self.clock.now() < latest:
            pass
        come, self._come = self._come, ""
        return come

    def close(self) -> None:
        """Give the connection back."""
        self._wire.close()

    def _take(self) -> str | None:
        """A line that has ended, perhaps empty; CR, LF and both together end one."""
        line, *rest = re.split(r"[\r\n]", self._come, maxsplit=1)
        if not rest:
            return None
        self._come = rest[0]
        return line

    def _more(self, seconds: float) -> bool:
        try:
            data = self._wire.read(seconds)
        except OSError as error:
            raise _unplugged(error) from error
        # Noise on the wire must show in a message, not break it.
        self._come += data.decode("ascii", "backslashreplace")
        return bool(data)


def _unplugged(error: OSError) -> Unplugged:
    return Unplugged(
        f"the connection to the controller is lost ({error}); plug it in and switch it on, then capture "
        "again with --resume"
    )
