"""EmulatedController: an emulated NanoControl in both dialects, bytes in and bytes out.

Moves take their time by the rig's clock, real or virtual.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from stickslip_fit.capture.emulator.manipulator import Manipulator
from stickslip_fit.capture.protocols import STEP_PERIOD, Clock

TIME_TOL = 1e-6  # of a step; for times that add up


@dataclass(frozen=True)
class RunningMove:
    """Coarse steps under way.

    Attributes
    ----------
    joint : int
        0 for a channel that drives nothing.
    steps : int
        More than 0 in `+`, less in `-`.
    began : float
        s.
    """

    joint: int
    steps: int
    began: float


class EmulatedController(ABC):
    """What any dialect has: commands that are carried out one after the other.

    Parameters
    ----------
    manipulator : Manipulator
    clock : Clock
    period : float
        From one step to the next, s.
    """

    ends: ClassVar[str]
    """What ends a command."""

    def __init__(self, manipulator: Manipulator, clock: Clock, period: float = STEP_PERIOD) -> None:
        self.manipulator = manipulator
        self.clock = clock
        self.period = period
        self.counted = dict.fromkeys("ABCD", 0)
        self._move: RunningMove | None = None
        self._made = 0  # steps of the move under way
        self._free_at = clock.now()
        self._waiting: list[tuple[float, str]] = []  # with the time at which each has come
        self._come = ""
        self._output = b""

    def take(self, data: bytes) -> None:
        """Take in bytes, whole commands or pieces of them."""
        self.advance()
        *commands, self._come = (self._come + data.decode("ascii", "replace")).split(self.ends)
        for command in commands:
            if not self._at_once(command.strip()):
                self._waiting.append((self.clock.now(), command.strip()))
            # A stop may come right behind the move that it is to stop.
            self.advance()

    def send(self) -> bytes:
        """What it has said since it was last asked."""
        self.advance()
        said, self._output = self._output, b""
        return said

    def due(self) -> float | None:
        """When the move under way will be over, s; None where nothing moves."""
        return None if self._move is None else self._move.began + abs(self._move.steps) * self.period

    def advance(self) -> None:
        """Make the steps that are due by now, and begin with whatever is to be done next."""
        while True:
            due = self.due()
            if due is not None:
                self._make_due()
                if self.clock.now() < due - TIME_TOL * self.period:
                    return
                self._move, self._free_at = None, due
                self._done()
            elif self._waiting:
                arrival_direction, command = self._waiting.pop(0)
                self._free_at = max(self._free_at, arrival_direction)
                self._carry_out(command)
            else:
                return

    def _begin(self, channel: str, steps: int) -> None:
        """Begin to move."""
        self._move, self._made = RunningMove("ABC".find(channel) + 1, steps, self._free_at), 0
        self.counted[channel] += steps

    def _halt(self) -> bool:
        """Break off the move under way; whether there was one."""
        move, self._move = self._move, None
        if move is not None:
            channel, sign = "DABC"[move.joint], 1 if move.steps > 0 else -1
            self.counted[channel] -= sign * (abs(move.steps) - self._made)
        return move is not None

    def _make_due(self) -> None:
        move = self._move
        if move is None:
            return
        due = int((self.clock.now() - move.began) / self.period + TIME_TOL)
        more = min(due, abs(move.steps)) - self._made
        if more > 0 and move.joint:
            sign = 1 if move.steps > 0 else -1
            began = move.began + self._made * self.period
            self.manipulator.step(move.joint, sign * more, began, self.period)
        self._made += max(more, 0)

    def _say(self, text: str) -> None:
        self._output += text.encode("ascii")

    @abstractmethod
    def _at_once(self, command: str) -> bool:
        """Carry out a command that does not wait for the move under way; whether it was one."""

    @abstractmethod
    def _carry_out(self, command: str) -> None:
        """Carry out any other command, or begin to."""

    @abstractmethod
    def _done(self) -> None:
        """A move is over."""


NEW_VERSION = "NC4 01.70-180807 (emulated)"
MIN_STEPS, MAX_STEPS = -65_536, 65_535
NEW_MOVE_PATTERN = re.compile(r"coarse ([A-D]) ([+-]?\d+)")
COUNT_PATTERN = re.compile(r"coarse(?: ([A-D]))? \?")
RESET_PATTERN = re.compile(r"coarsereset(?: ([A-D]))?")


class NewDialect(EmulatedController):
    """Understands ``coarse``, ``coarsereset``, ``version``, ``stop``, ``stopnack``; refuses the rest."""

    ends = "\r"

    def inform(self, message: str) -> None:
        """Say something that nobody has asked for."""
        self._answer("i", message)

    def _at_once(self, command: str) -> bool:
        if command not in ("stop", "stopnack"):
            return False
        if self._halt():
            self._answer("e", "stopped")
        if command == "stop":
            self._answer("o", "stop")
        return True

    def _carry_out(self, command: str) -> None:
        if move := NEW_MOVE_PATTERN.fullmatch(command):
            steps = int(move[2])
            if MIN_STEPS <= steps <= MAX_STEPS:
                self._begin(move[1], steps)
            else:
                self._answer("e", f"{steps} is out of range")
        elif count := COUNT_PATTERN.fullmatch(command):
            asked = count[1] or "ABCD"
            self._answer("o", " ".join(str(self.counted[channel]) for channel in asked))
        elif reset := RESET_PATTERN.fullmatch(command):
            self.counted |= dict.fromkeys(reset[1] or "ABCD", 0)
            self._answer("o", "coarsereset")
        elif command == "version":
            self._answer("o", NEW_VERSION)
        elif command:
            self._answer("e", f"unknown command {command}")

    def _done(self) -> None:
        self._answer("o", "coarse")

    def _answer(self, letter: str, message: str) -> None:
        self._say(f"{letter}\t{message}\r")


OLD_VERSION = "NanoControl (emulated)"
OLD_MOVE_PATTERN = re.compile(r"coarse ([A-D]) ([+-]\d+)")


class OldDialect(EmulatedController):
    """Understands ``coarse`` and ``version``; whatever else it is sent goes unheard."""

    ends = ";"

    def _at_once(self, command: str) -> bool:
        return False

    def _carry_out(self, command: str) -> None:
        if move := OLD_MOVE_PATTERN.fullmatch(command):
            self._begin(move[1], int(move[2]))
        elif command == "version":
            self._say(f"{OLD_VERSION}\r\n")

    def _done(self) -> None:
        """Nobody is told."""


class EmulatedTransport:
    """A `Wire`; whoever reads waits by the emulated controller's own clock."""

    def __init__(self, unit: EmulatedController) -> None:
        self._unit = unit

    def write(self, data: bytes) -> None:
        """See `Wire.write`."""
        self._unit.take(data)

    def read(self, seconds: float) -> bytes:
        """See `Wire.read`."""
        said = self._unit.send()
        if said or seconds <= 0:
            return said
        due, clock = self._unit.due(), self._unit.clock
        clock.sleep(seconds if due is None else min(max(due - clock.now(), 0.0), seconds))
        return self._unit.send()

    def close(self) -> None:
        """See `Wire.close`."""
