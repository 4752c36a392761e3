"""The emulated controller: bytes in, bytes out, and a move under way that takes its time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from stickslip_fit.capture.clock import Clock
from stickslip_fit.capture.coarse import STEP_PERIOD
from stickslip_fit.capture.emulator.manipulator import Manipulator

ROUNDING = 1e-6  # of a step; for times that add up


@dataclass(frozen=True)
class Move:
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


class Unit(ABC):
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
        self._move: Move | None = None
        self._made = 0  # steps of the move under way
        self._free_at = clock.now()
        self._waiting: list[tuple[float, str]] = []  # with the time at which each has come
        self._come = ""
        self._said = b""

    def take(self, data: bytes) -> None:
        """Take in bytes, whole commands or pieces of them."""
        self.advance()
        *commands, self._come = (self._come + data.decode("ascii", "replace")).split(self.ends)
        for command in commands:
            if not self._at_once(command.strip()):
                self._waiting.append((self.clock.now(), command.strip()))
            # A stop may come right behind the move that it is to stop.
            self.advance()

    def give(self) -> bytes:
        """What it has said since it was last asked."""
        self.advance()
        said, self._said = self._said, b""
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
                if self.clock.now() < due - ROUNDING * self.period:
                    return
                self._move, self._free_at = None, due
                self._done()
            elif self._waiting:
                came, command = self._waiting.pop(0)
                self._free_at = max(self._free_at, came)
                self._carry_out(command)
            else:
                return

    def _begin(self, channel: str, steps: int) -> None:
        """Begin to move."""
        self._move, self._made = Move("ABC".find(channel) + 1, steps, self._free_at), 0
        self.counted[channel] += steps

    def _halt(self) -> bool:
        """Break off the move under way; whether there was one."""
        move, self._move = self._move, None
        if move is not None:
            channel, way = "DABC"[move.joint], 1 if move.steps > 0 else -1
            self.counted[channel] -= way * (abs(move.steps) - self._made)
        return move is not None

    def _make_due(self) -> None:
        move = self._move
        if move is None:
            return
        due = int((self.clock.now() - move.began) / self.period + ROUNDING)
        more = min(due, abs(move.steps)) - self._made
        if more > 0 and move.joint:
            way = 1 if move.steps > 0 else -1
            began = move.began + self._made * self.period
            self.manipulator.step(move.joint, way * more, began, self.period)
        self._made += max(more, 0)

    def _say(self, text: str) -> None:
        self._said += text.encode("ascii")

    @abstractmethod
    def _at_once(self, command: str) -> bool:
        """Carry out a command that does not wait for the move under way; whether it was one."""

    @abstractmethod
    def _carry_out(self, command: str) -> None:
        """Carry out any other command, or begin to."""

    @abstractmethod
    def _done(self) -> None:
        """A move is over."""
