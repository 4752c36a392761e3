"""The emulated NanoControl in the old dialect: it says nothing but its version."""

from __future__ import annotations

import re

from stickslip_fit.capture.emulator.unit import Unit

VERSION = "NanoControl (emulated)"
MOVE = re.compile(r"coarse ([A-D]) ([+-]\d+)")


class OldDialect(Unit):
    """Understands ``coarse`` and ``version``; whatever else it is sent goes unheard."""

    ends = ";"

    def _at_once(self, command: str) -> bool:
        return False

    def _carry_out(self, command: str) -> None:
        if move := MOVE.fullmatch(command):
            self._begin(move[1], int(move[2]))
        elif command == "version":
            self._say(f"{VERSION}\r\n")

    def _done(self) -> None:
        """Nobody is told."""
