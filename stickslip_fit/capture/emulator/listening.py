"""What hears the emulated joints: a microphone, and an ear that is always right."""

from __future__ import annotations

import numpy as np

from stickslip_fit.capture.ear import Heard
from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.sound import sound_of
from stickslip_fit.capture.emulator.unit import Unit
from stickslip_fit.capture.source import Samples

LOUD, QUIET = 20.0, 0.0  # dB


class EmulatedMicrophone:
    """A `Source` of the sound that the joints of an emulated controller make.

    Parameters
    ----------
    unit : Unit
    acoustics : Acoustics
        Of the same step period.
    rng : Generator
    """

    def __init__(self, unit: Unit, acoustics: Acoustics, rng: np.random.Generator) -> None:
        self.rate = acoustics.rate
        self._unit = unit
        self._acoustics = acoustics
        self._rng = rng
        self._heard_until = unit.clock.now()

    def read(self, seconds: float) -> Samples:
        """See `Source.read`; whole step periods, at least one."""
        period, clock = self._acoustics.period, self._unit.clock
        slots = max(round(seconds / period), 1)
        self._heard_until = max(clock.now(), self._heard_until + slots * period)
        clock.sleep(self._heard_until - clock.now())
        began = self._heard_until - slots * period
        moving, at_stop = self._steps(began + (np.arange(slots) + 0.5) * period)
        return Samples(sound_of(self._acoustics, began, moving, at_stop, self._rng))

    def close(self) -> None:
        """See `Source.close`."""

    def _steps(self, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether a step is made at each time, and whether it pushes against a stop."""
        self._unit.advance()
        moving, at_stop = np.zeros((2, len(middles)), bool)
        for made in reversed(self._unit.manipulator.made):
            if made.ended <= middles[0]:
                break
            number = np.floor((middles - made.began) / made.period)
            within = (number >= 0) & (number < made.steps)
            moving |= within
            at_stop |= within & (number >= made.moving)
        return moving, at_stop


class PerfectEar:
    """An `Ear` that knows at which step the stop was met."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._heard_until = unit.clock.now()

    def begin(self) -> None:
        """See `Ear.begin`."""
        self._heard_until = self._unit.clock.now()

    def check(self, seconds: float) -> Heard:
        """See `Ear.check`."""
        self._unit.advance()
        at_stop = False
        for made in reversed(self._unit.manipulator.made):
            if made.ended <= self._heard_until + made.period / 2:
                break
            at_stop |= made.moving < made.steps
        self._heard_until = self._unit.clock.now()
        return Heard(at_stop, LOUD if at_stop else QUIET)

    def close(self) -> None:
        """See `Ear.close`."""
