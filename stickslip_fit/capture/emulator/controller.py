"""EmulatedController: an emulated NanoControl in both dialects, bytes in and bytes out.

Moves take their time by the rig's clock, real or virtual.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from stickslip_fit.capture.emulator.manipulator import Manipulator
from stickslip_fit.capture.nanocontrol import ByteTransport
from stickslip_fit.capture.protocols import STEP_PERIOD, Clock

TIME_TOL = 1e-6  # of a step; for times that add up


@dataclass(frozen=True)
class RunningMove:
    """A move in progress: signed steps of a joint (0 for a channel that drives nothing) from `began`, s."""

    joint: int
    steps: int
    began: float


class EmulatedController(ABC):
    """Commands of any dialect, executed one after the other; a step takes `period`, s."""

    terminator: ClassVar[str]
    """What ends a command."""

    def __init__(self, manipulator: Manipulator, clock: Clock, period: float = STEP_PERIOD) -> None:
        self.manipulator = manipulator
        self.clock = clock
        self.period = period
        self.step_counts = dict.fromkeys("ABCD", 0)
        self._move: RunningMove | None = None
        self._made = 0  # steps of the move in progress
        self._free_at = clock.now()
        self._waiting: list[tuple[float, str]] = []  # with the time of arrival
        self._input = ""
        self._output = b""

    def receive(self, data: bytes) -> None:
        """Receive bytes, whole commands or pieces of them."""
        self.advance()
        *commands, self._input = (self._input + data.decode("ascii", "replace")).split(self.terminator)
        for command in commands:
            if not self._execute_at_once(command.strip()):
                self._waiting.append((self.clock.now(), command.strip()))
            # A stop may come right behind the move that it is to stop.
            self.advance()

    def send(self) -> bytes:
        """Everything written since the last call."""
        self.advance()
        output, self._output = self._output, b""
        return output

    def due(self) -> float | None:
        """End of the move in progress, s; None where nothing moves."""
        return None if self._move is None else self._move.began + abs(self._move.steps) * self.period

    def advance(self) -> None:
        """Make the steps that are due by now, and begin the commands that wait."""
        while True:
            due = self.due()
            if due is not None:
                self._make_due()
                if self.clock.now() < due - TIME_TOL * self.period:
                    return
                self._move, self._free_at = None, due
                self._finish_move()
            elif self._waiting:
                arrived, command = self._waiting.pop(0)
                self._free_at = max(self._free_at, arrived)
                self._execute(command)
            else:
                return

    def _begin(self, channel: str, steps: int) -> None:
        """Begin a move."""
        self._move, self._made = RunningMove("ABC".find(channel) + 1, steps, self._free_at), 0
        self.step_counts[channel] += steps

    def _halt(self) -> bool:
        """Stop the move in progress; whether there was one."""
        move, self._move = self._move, None
        if move is not None:
            channel, sign = "DABC"[move.joint], 1 if move.steps > 0 else -1
            self.step_counts[channel] -= sign * (abs(move.steps) - self._made)
        return move is not None

    def _make_due(self) -> None:
        move = self._move
        if move is None:
            return
        elapsed = int((self.clock.now() - move.began) / self.period + TIME_TOL)
        more = min(elapsed, abs(move.steps)) - self._made
        if more > 0 and move.joint:
            sign = 1 if move.steps > 0 else -1
            began = move.began + self._made * self.period
            self.manipulator.step(move.joint, sign * more, began, self.period)
        self._made += max(more, 0)

    def _write(self, text: str) -> None:
        self._output += text.encode("ascii")

    @abstractmethod
    def _execute_at_once(self, command: str) -> bool:
        """Execute a command that does not wait for the move in progress; whether it is one."""

    @abstractmethod
    def _execute(self, command: str) -> None:
        """Execute any other command, or begin to."""

    @abstractmethod
    def _finish_move(self) -> None:
        """Called at the end of a move."""


NEW_VERSION = "NC4 01.70-180807 (emulated)"
MIN_STEPS, MAX_STEPS = -65_536, 65_535
NEW_MOVE_PATTERN = re.compile(r"coarse ([A-D]) ([+-]?\d+)")
COUNT_PATTERN = re.compile(r"coarse(?: ([A-D]))? \?")
RESET_PATTERN = re.compile(r"coarsereset(?: ([A-D]))?")


class NewDialect(EmulatedController):
    """Understands ``coarse``, ``coarsereset``, ``version``, ``stop``, ``stopnack``; refuses the rest."""

    terminator = "\r"

    def _execute_at_once(self, command: str) -> bool:
        if command not in ("stop", "stopnack"):
            return False
        if self._halt():
            self._answer("e", "stopped")
        if command == "stop":
            self._answer("o", "stop")
        return True

    def _execute(self, command: str) -> None:
        if move := NEW_MOVE_PATTERN.fullmatch(command):
            steps = int(move[2])
            if MIN_STEPS <= steps <= MAX_STEPS:
                self._begin(move[1], steps)
            else:
                self._answer("e", f"{steps} is out of range")
        elif count := COUNT_PATTERN.fullmatch(command):
            counts = (str(self.step_counts[channel]) for channel in count[1] or "ABCD")
            self._answer("o", " ".join(counts))
        elif reset := RESET_PATTERN.fullmatch(command):
            self.step_counts |= dict.fromkeys(reset[1] or "ABCD", 0)
            self._answer("o", "coarsereset")
        elif command == "version":
            self._answer("o", NEW_VERSION)
        elif command:
            self._answer("e", f"unknown command {command}")

    def _finish_move(self) -> None:
        self._answer("o", "coarse")

    def _answer(self, letter: str, message: str) -> None:
        self._write(f"{letter}\t{message}\r")


OLD_VERSION = "NanoControl (emulated)"
OLD_MOVE_PATTERN = re.compile(r"coarse ([A-D]) ([+-]\d+)")


class OldDialect(EmulatedController):
    """Understands ``coarse`` and ``version``; ignores the rest."""

    terminator = ";"

    def _execute_at_once(self, command: str) -> bool:
        return False

    def _execute(self, command: str) -> None:
        if move := OLD_MOVE_PATTERN.fullmatch(command):
            self._begin(move[1], int(move[2]))
        elif command == "version":
            self._write(f"{OLD_VERSION}\r\n")

    def _finish_move(self) -> None:
        """The old dialect says nothing."""


class EmulatedTransport(ByteTransport):
    """A `ByteTransport` to an emulated controller, by whose clock a read waits."""

    def __init__(self, controller: EmulatedController) -> None:
        self._controller = controller

    def write(self, data: bytes) -> None:
        self._controller.receive(data)

    def read(self, seconds: float) -> bytes:
        output = self._controller.send()
        if output or seconds <= 0:
            return output
        due, clock = self._controller.due(), self._controller.clock
        clock.sleep(seconds if due is None else min(max(due - clock.now(), 0.0), seconds))
        return self._controller.send()

    def close(self) -> None:
        """See `ByteTransport.close`."""
