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
    Controller,
    ControllerError,
    channel_of,
    split_move,
)
from stickslip_fit.errors import InputError

WRITE_TIMEOUT = 2.0  # s; a few bytes take a millisecond


class ByteTransport(Protocol):
    """Bytes in both directions; any OSError means that the connection is lost."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def read(self, seconds: float) -> bytes:
        """Return what arrives, as soon as anything does; nothing if nothing arrives within so long."""

    def close(self) -> None:
        """Close the connection."""


class SerialTransport(ByteTransport):
    """A `ByteTransport` over pyserial; see `open_serial`."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def read(self, seconds: float) -> bytes:
        self._port.timeout = seconds
        first = self._port.read(1)
        return first + self._port.read(self._port.in_waiting) if first else b""

    def close(self) -> None:
        self._port.close()


def open_serial(port: str, baud: int) -> SerialTransport:
    """Open a serial port, such as ``/dev/ttyUSB0`` or ``COM3``, 8N1, for this program alone.

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
        from serial.tools.list_ports import comports

        ports = ", ".join(info.device for info in comports()) or "none"
        raise ControllerError(
            f"cannot open the port {port!r} ({error}); plug the controller in, end other programs that use "
            f"the port, or choose another; there are {ports}"
        ) from error
    return SerialTransport(opened)


class LineTransport:
    """Sends commands, each with an `end`, and receives lines; time-outs run by the clock."""

    def __init__(self, transport: ByteTransport, clock: Clock, end: str) -> None:
        self.clock = clock
        self.end = end
        self._transport = transport
        self._buffer = ""

    @property
    def partial_line(self) -> str:
        """What has arrived of a line that has not ended yet."""
        return self._buffer

    def send(self, command: str) -> None:
        """Send a command; raises ConnectionLost."""
        try:
            self._transport.write((command + self.end).encode("ascii"))
        except OSError as error:
            raise _make_connection_lost(error) from error

    def receive(self, seconds: float) -> str | None:
        """The next non-empty line; None if none is complete in time. Raises ConnectionLost."""
        latest, in_time = self.clock.now() + seconds, True
        while not (line := self._pop_line()):
            if line is None:
                if not in_time:
                    return None
                remaining = latest - self.clock.now()
                in_time = remaining > 0
                self._fill(max(remaining, 0.0))
        return line

    def read_all(self, seconds: float) -> str:
        """Everything that has arrived before or arrives within so long, ended or not."""
        latest = self.clock.now() + seconds
        while self._fill(max(latest - self.clock.now(), 0.0)) or self.clock.now() < latest:
            pass
        text, self._buffer = self._buffer, ""
        return text

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def _pop_line(self) -> str | None:
        """A complete line, perhaps empty; CR, LF and both together end one."""
        line, *rest = re.split(r"[\r\n]", self._buffer, maxsplit=1)
        if not rest:
            return None
        self._buffer = rest[0]
        return line

    def _fill(self, seconds: float) -> bool:
        try:
            data = self._transport.read(seconds)
        except OSError as error:
            raise _make_connection_lost(error) from error
        # Line noise must show in a message, not break it.
        self._buffer += data.decode("ascii", "backslashreplace")
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


class NanoControl(Controller):
    """NanoControl in its new dialect: a `Controller` that matches every reply to its command.

    A reply is a letter, a TAB and a message: ``o`` done, ``e`` refused. ``i`` informs at any moment and
    replies to nothing; `notify` is called with its message. `step_period`, s, is the controller's own.
    """

    def __init__(
        self, line: LineTransport, notify: Callable[[str], None], step_period: float = STEP_PERIOD
    ) -> None:
        self.step_period = step_period
        self._line = line
        self._notify = notify
        self._pending: list[str] = []  # commands without a reply yet
        self._exchange = threading.Lock()
        self._sending = threading.Lock()
        self._stopped = threading.Event()  # by another thread, not yet handled

    def step(self, joint: int, steps: int) -> None:
        """See `Controller.step`; raises ControllerError also if another thread stops the move."""
        channel = channel_of(joint)
        for part in split_move(steps, NEW_MAX_STEPS):
            command = f"coarse {channel} {part}"
            seconds = abs(part) * self.step_period * MAX_SLOWDOWN
            self._ask(command, seconds, f"joint {joint}, command {command!r}")

    def stop(self) -> None:
        """See `Controller.stop`; a move in another thread ends there with an error."""
        if not self._exchange.acquire(blocking=False):
            self._stopped.set()
            with self._sending:
                # The other thread reads the replies, and this command gets none.
                self._line.send("stopnack")
            return
        try:
            self._pending.append("stop")
            self._line.send("stop")
            self._read_stop_replies()
        finally:
            self._exchange.release()

    def version(self) -> str:
        return self._ask("version", 0.0, "command 'version'")

    def close(self) -> None:
        self._line.close()

    def _read_stop_replies(self) -> None:
        """Read the reply to a stop, and before it that of the move, if one was stopped."""
        replied = False
        while self._pending:
            try:
                self._reply(REPLY_TIMEOUT, "command 'stop'")
            except _NoReply:
                if not replied:
                    raise
                # The controller is idle: the missing replies were lost.
                self._pending.clear()
            replied = True

    def _ask(self, command: str, seconds: float, place: str) -> str:
        """Send a command and wait for its reply, `seconds` longer than usual."""
        with self._exchange:
            self._check_no_reply_pending(place)
            with self._sending:
                self._check_not_stopped(place)
                self._pending.append(command)
                self._line.send(command)
            letter, message = self._reply(seconds + REPLY_TIMEOUT, place)
            self._check_not_stopped(place)
        if letter == "e":
            raise ControllerError(
                f"{place}: the controller refuses: {message!r}; see its manual for what that means, put it "
                "right, then repeat the traverse"
            )
        return message

    def _check_not_stopped(self, place: str) -> None:
        if self._stopped.is_set():
            self._stopped.clear()
            raise ControllerError(f"{place}: stopped before it was done")

    def _check_no_reply_pending(self, place: str) -> None:
        """Refuse a command before all replies have arrived: the next one would be taken for its own."""
        while (line := self._line.receive(0.0)) is not None:
            letter, message = _parse_reply(line, place)
            if letter == "i":
                self._notify(message)
                continue
            late = f"late, to {self._pending.pop(0)!r}" if self._pending else "to nothing that was sent"
            raise ControllerError(
                f"{place}: not sent, for the controller has answered {line!r}, {late}; end other programs "
                "that talk to it, then repeat the traverse"
            )
        if self._pending:
            raise ControllerError(
                f"{place}: not sent, for the controller has not yet answered {self._pending[0]!r}; stop it, "
                "or switch it off and on"
            )

    def _reply(self, seconds: float, place: str) -> tuple[str, str]:
        """Letter and message of the reply to the oldest pending command."""
        latest = self._line.clock.now() + seconds
        while (line := self._line.receive(latest - self._line.clock.now())) is not None:
            letter, message = _parse_reply(line, place)
            if letter != "i":
                self._pending.pop(0)
                return letter, message
            self._notify(message)
        text = f"only {self._line.partial_line!r}" if self._line.partial_line else "nothing"
        raise _NoReply(
            f"{place}: {text} came within {seconds:.1f} s; check that the controller is on, that the dialect "
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
OLD_MAX_STEPS = 50  # per command: no command stops a move, so each takes less than a person's reaction time
COMMAND_SECONDS = 0.010  # transmission of a command at 19200 baud
VERSION_TIMEOUT = 0.5  # s


class OldNanoControl(Controller):
    """NanoControl in its old dialect: a `Controller` that waits out the time of a move, `step_period` each.

    A step period below the controller's own would send steps faster than they are made.
    """

    def __init__(self, line: LineTransport, step_period: float = STEP_PERIOD) -> None:
        self.step_period = step_period
        self._line = line
        self._free_at = line.clock.now()

    def step(self, joint: int, steps: int) -> None:
        """See `Controller.step`; errors of the controller are not reported in this dialect."""
        channel = channel_of(joint)
        for part in split_move(steps, OLD_MAX_STEPS):
            self._wait()
            self._free_at = self._line.clock.now() + COMMAND_SECONDS + abs(part) * self.step_period
            self._line.send(f"coarse {channel} {part:+d}")
            self._wait()

    def stop(self) -> None:
        """Wait for the end of the last command, at most `OLD_MAX_STEPS` steps: no command stops it."""
        self._wait()

    def version(self) -> str:
        self._wait()
        self._line.read_all(0.0)  # discards earlier output
        self._line.send("version")
        return " ".join(self._line.read_all(VERSION_TIMEOUT).split())

    def close(self) -> None:
        self._line.close()

    def _wait(self) -> None:
        self._line.clock.sleep(self._free_at - self._line.clock.now())
