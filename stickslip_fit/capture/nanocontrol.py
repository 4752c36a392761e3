"""Kleindiek's NanoControl, new dialect: every command is answered once it has been carried out."""

from __future__ import annotations

import threading
from collections.abc import Callable

from stickslip_fit.capture.coarse import STEP_PERIOD, channel_of, parts_of
from stickslip_fit.capture.controller import ControllerError
from stickslip_fit.capture.line import Line

BAUD = 115_200
END = "\r"
MOST_STEPS = 65_535  # in one command
PATIENCE = 2.0  # s, beyond what a move takes
SLOWER = 1.5  # times its usual time that a move may take


class _NoAnswer(ControllerError):
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

    def __init__(self, line: Line, tell: Callable[[str], None], step_period: float = STEP_PERIOD) -> None:
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
        for part in parts_of(steps, MOST_STEPS):
            command = f"coarse {channel} {part}"
            self._ask(command, abs(part) * self.step_period * SLOWER, f"joint {joint}, command {command!r}")

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
                self._reply(PATIENCE, "command 'stop'")
            except _NoAnswer:
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
            letter, message = self._reply(seconds + PATIENCE, place)
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
            letter, message = _read(found, place)
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
            letter, message = _read(found, place)
            if letter != "i":
                self._owed.pop(0)
                return letter, message
            self._tell(message)
        come = f"only {self._line.begun!r}" if self._line.begun else "nothing"
        raise _NoAnswer(
            f"{place}: {come} came within {seconds:.1f} s; check that the controller is on, that the dialect "
            f"and the step period ({1000 * self.step_period:g} ms) are its own"
        )


def _read(line: str, place: str) -> tuple[str, str]:
    letter, tab, message = line.partition("\t")
    if not tab or letter not in ("o", "e", "i"):
        raise ControllerError(
            f"{place}: the controller says {line!r}, which is no reply of this dialect; choose the other "
            "one, or check the port"
        )
    return letter, message.strip()
