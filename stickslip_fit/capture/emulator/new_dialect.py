"""The emulated NanoControl in the new dialect: one reply for each command, after it was carried out."""

from __future__ import annotations

import re

from stickslip_fit.capture.emulator.unit import Unit

VERSION = "NC4 01.70-180807 (emulated)"
FEWEST, MOST = -65_536, 65_535
MOVE = re.compile(r"coarse ([A-D]) ([+-]?\d+)")
COUNT = re.compile(r"coarse(?: ([A-D]))? \?")
RESET = re.compile(r"coarsereset(?: ([A-D]))?")


class NewDialect(Unit):
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
        if move := MOVE.fullmatch(command):
            steps = int(move[2])
            if FEWEST <= steps <= MOST:
                self._begin(move[1], steps)
            else:
                self._answer("e", f"{steps} is out of range")
        elif count := COUNT.fullmatch(command):
            asked = count[1] or "ABCD"
            self._answer("o", " ".join(str(self.counted[channel]) for channel in asked))
        elif reset := RESET.fullmatch(command):
            self.counted |= dict.fromkeys(reset[1] or "ABCD", 0)
            self._answer("o", "coarsereset")
        elif command == "version":
            self._answer("o", VERSION)
        elif command:
            self._answer("e", f"unknown command {command}")

    def _done(self) -> None:
        self._answer("o", "coarse")

    def _answer(self, letter: str, message: str) -> None:
        self._say(f"{letter}\t{message}\r")
