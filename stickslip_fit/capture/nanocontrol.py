"""Kleindiek NanoControl over a serial port, in its new and its old dialect.

The new dialect answers every command once it has been carried out. The old one answers only a request
for its version, so that the time of a move is waited out. `LineTransport` sends and receives whole
lines over any `ByteTransport`.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from typing import Any, Protocol

from stickslip_fit.capture.protocols import (
    STEP_PERIOD,
    Clock,
    ConnectionLost,
    ControllerError,
    channel_of,
    split_move,
)
from stickslip_fit.errors import InputError

WRITE_TIMEOUT = 2.0  # s; a few bytes take a millisecond


class SerialTransport:
    """A wire over pyserial; see `open_serial`."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def write(self, data: bytes) -> None:
        """See `Wire.write`."""
        self._port.write(data)

    def read(self, seconds: float) -> bytes:
        """See `Wire.read`."""
        self._port.timeout = seconds
        first = self._port.read(1)
        return first + self._port.read(self._port.in_waiting) if first else b""

    def close(self) -> None:
        """See `Wire.close`."""
        self._port.close()


def open_serial(port: str, baud: int) -> SerialTransport:
    """Open a serial port, 8N1, for this program alone.

    Parameters
    ----------
    port : str
        Such as ``/dev/ttyUSB0`` or ``COM3``.
    baud : int

    Raises
    ------
    InputError
        If pyserial is not installed.
    ControllerError
        If there is no such port, or another program has it.
    """
    try:
        import serial
    except ImportError:
        raise InputError(
            "a serial port needs pyserial; install it: pip install 'stickslip-fit[capture]'"
        ) from None
    try:
        opened = serial.Serial(port, baud, timeout=0, write_timeout=WRITE_TIMEOUT, exclusive=True)
    except (OSError, ValueError) as error:
        raise ControllerError(
            f"cannot open the port {port!r} ({error}); plug the controller in, end other programs that use "
            f"the port, or choose another; there are {', '.join(_list_ports()) or 'none'}"
        ) from error
    return SerialTransport(opened)


def _list_ports() -> list[str]:
    from serial.tools.list_ports import comports

    return [port.device for port in comports()]


class ByteTransport(Protocol):
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


class LineTransport:
    """Commands sent and lines received over a wire.

    Parameters
    ----------
    wire : Wire
    clock : Clock
        By which time-outs run.
    end : str
        What ends a command.
    """

    def __init__(self, wire: ByteTransport, clock: Clock, end: str) -> None:
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
            raise _make_connection_lost(error) from error

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
            raise _make_connection_lost(error) from error
        # Noise on the wire must show in a message, not break it.
        self._come += data.decode("ascii", "backslashreplace")
        return bool(data)


def _make_connection_lost(error: OSError) -> ConnectionLost:
    return ConnectionLost(
        f"the connection to the controller is lost ({error}); plug it in and switch it on, then capture "
        "again with --resume"
    )


NEW_BAUD_RATE = 115_200
NEW_TERMINATOR = "\r"
NEW_MAX_STEPS = 65_535  # in one command
REPLY_TIMEOUT = 2.0  # s, beyond what a move takes
MAX_SLOWDOWN = 1.5  # times its usual time that a move may take


class _NoReply(ControllerError):
    """No reply in time."""


class NanoControl:
    """A `Controller` that knows which reply belongs to which command.

    A reply is a letter, a TAB and a message: ``o`` done, ``e`` refused. ``i`` informs, at any moment, and
    answers nothing.

    Parameters
    ----------
    line : Line
        Whose commands end in `END`.
    tell : callable
        Is given whatever the controller says of its own accord.
    step_period : float
        s; what the controller is set to.
    """

    def __init__(
        self, line: LineTransport, tell: Callable[[str], None], step_period: float = STEP_PERIOD
    ) -> None:
        self.step_period = step_period
        self._line = line
        self._tell = tell
        self._owed: list[str] = []  # commands that have no reply yet
        self._talking = threading.Lock()
        self._sending = threading.Lock()
        self._stopped = threading.Event()  # by another thread, and not yet noticed

    def step(self, joint: int, steps: int) -> None:
        """See `Controller.step`.

        Raises
        ------
        ControllerError
            Also if another thread stops the move, or if a reply is there that belongs to no command.
        """
        channel = channel_of(joint)
        for part in split_move(steps, NEW_MAX_STEPS):
            command = f"coarse {channel} {part}"
            self._ask(
                command, abs(part) * self.step_period * MAX_SLOWDOWN, f"joint {joint}, command {command!r}"
            )

    def stop(self) -> None:
        """See `Controller.stop`; a move that waits in another thread ends there with an error."""
        if not self._talking.acquire(blocking=False):
            self._stopped.set()
            with self._sending:
                # Replies are the other thread's to read, and this command gets none.
                self._line.send("stopnack")
            return
        try:
            self._owed.append("stop")
            self._line.send("stop")
            self._settle()
        finally:
            self._talking.release()

    def version(self) -> str:
        """See `Controller.version`."""
        return self._ask("version", 0.0, "command 'version'")

    def close(self) -> None:
        """See `Controller.close`."""
        self._line.close()

    def _settle(self) -> None:
        """Read what stop is answered: its own reply, and before it that of the move, if one was stopped."""
        answered = False
        while self._owed:
            try:
                self._reply(REPLY_TIMEOUT, "command 'stop'")
            except _NoReply:
                if not answered:
                    raise
                # It stands still and has no more to say: what is owed was lost on the way.
                self._owed.clear()
            answered = True

    def _ask(self, command: str, seconds: float, place: str) -> str:
        """Send a command and wait for its reply, however long it takes to carry out."""
        with self._talking:
            self._refuse_leftovers(place)
            with self._sending:
                self._refuse_stopped(place)
                self._owed.append(command)
                self._line.send(command)
            letter, message = self._reply(seconds + REPLY_TIMEOUT, place)
            self._refuse_stopped(place)
        if letter == "e":
            raise ControllerError(
                f"{place}: the controller refuses: {message!r}; see its manual for what that means, put it "
                "right, then repeat the traverse"
            )
        return message

    def _refuse_stopped(self, place: str) -> None:
        if self._stopped.is_set():
            self._stopped.clear()
            raise ControllerError(f"{place}: stopped before it was done")

    def _refuse_leftovers(self, place: str) -> None:
        """No command before all replies are in: the next one would be taken for its answer."""
        while (found := self._line.receive(0.0)) is not None:
            letter, message = _parse_reply(found, place)
            if letter == "i":
                self._tell(message)
                continue
            late = f"late, to {self._owed.pop(0)!r}" if self._owed else "to nothing that was sent"
            raise ControllerError(
                f"{place}: not sent, for the controller has answered {found!r}, {late}; end other programs "
                "that talk to it, then repeat the traverse"
            )
        if self._owed:
            raise ControllerError(
                f"{place}: not sent, for the controller has not yet answered {self._owed[0]!r}; stop it, or "
                "switch it off and on"
            )

    def _reply(self, seconds: float, place: str) -> tuple[str, str]:
        """Letter and message of the reply to the oldest command that has none."""
        latest = self._line.clock.now() + seconds
        while (found := self._line.receive(latest - self._line.clock.now())) is not None:
            letter, message = _parse_reply(found, place)
            if letter != "i":
                self._owed.pop(0)
                return letter, message
            self._tell(message)
        come = f"only {self._line.begun!r}" if self._line.begun else "nothing"
        raise _NoReply(
            f"{place}: {come} came within {seconds:.1f} s; check that the controller is on, that the dialect "
            f"and the step period ({1000 * self.step_period:g} ms) are its own"
        )


def _parse_reply(line: str, place: str) -> tuple[str, str]:
    letter, tab, message = line.partition("\t")
    if not tab or letter not in ("o", "e", "i"):
        raise ControllerError(
            f"{place}: the controller says {line!r}, which is no reply of this dialect; choose the other "
            "one, or check the port"
        )
    return letter, message.strip()


OLD_BAUD_RATE = 19_200
OLD_TERMINATOR = ";"
# There is no command to stop a move, so that none is sent that takes longer than a person's reaction.
OLD_MAX_STEPS = 50
COMMAND_SECONDS = 0.010  # s; what a command takes to get there at 19200 baud
VERSION_TIMEOUT = 0.5  # s


class OldNanoControl:
    """A `Controller` that takes the time of a move for its being carried out.

    Parameters
    ----------
    line : Line
        Whose commands end in `END`.
    step_period : float
        s; what the controller is set to. A shorter one would send steps faster than they are made.
    """

    def __init__(self, line: LineTransport, step_period: float = STEP_PERIOD) -> None:
        self.step_period = step_period
        self._line = line
        self._free_at = line.clock.now()

    def step(self, joint: int, steps: int) -> None:
        """See `Controller.step`; an error of the controller stays unknown."""
        channel = channel_of(joint)
        for part in split_move(steps, OLD_MAX_STEPS):
            self._wait()
            self._free_at = self._line.clock.now() + COMMAND_SECONDS + abs(part) * self.step_period
            self._line.send(f"coarse {channel} {part:+d}")
            self._wait()

    def stop(self) -> None:
        """Wait for the last command's end, at most `MOST_STEPS` steps: nothing in this dialect stops it."""
        self._wait()

    def version(self) -> str:
        """See `Controller.version`."""
        self._wait()
        # Whatever it has said to earlier commands.
        self._line.everything(0.0)
        self._line.send("version")
        return " ".join(self._line.everything(VERSION_TIMEOUT).split())

    def close(self) -> None:
        """See `Controller.close`."""
        self._line.close()

    def _wait(self) -> None:
        self._line.clock.sleep(self._free_at - self._line.clock.now())
