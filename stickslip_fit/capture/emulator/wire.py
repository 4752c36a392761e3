"""The way to an emulated controller without any port: the same bytes, handed over at once."""

from __future__ import annotations

from stickslip_fit.capture.emulator.unit import Unit


class EmulatedWire:
    """A `Wire`; whoever reads waits by the emulated controller's own clock."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit

    def write(self, data: bytes) -> None:
        """See `Wire.write`."""
        self._unit.take(data)

    def read(self, seconds: float) -> bytes:
        """See `Wire.read`."""
        said = self._unit.give()
        if said or seconds <= 0:
            return said
        due, clock = self._unit.due(), self._unit.clock
        clock.sleep(seconds if due is None else min(max(due - clock.now(), 0.0), seconds))
        return self._unit.give()

    def close(self) -> None:
        """See `Wire.close`."""
