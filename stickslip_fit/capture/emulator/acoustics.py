"""How loud what is around an emulated manipulator, in numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

BAND = 2000.0  # Hz; the signal-to-noise ratio is that of a band so wide about the stop's peak
CORNER = 800.0  # Hz; below it the room's noise grows as 1/f
CLICK_TONE, CLICK_DECAY = 1800.0, 4e-4  # Hz, s: each step rings so
FLAT_TOP = 8  # exponent of the peak's shape: the higher, the flatter its top and the steeper its sides


@dataclass(frozen=True)
class Acoustics:
    """The sounds about an emulated manipulator on one day.

    Attributes
    ----------
    snr_db : float
        Signal-to-noise ratio. *Signal* is the mean power of the extra sound that the joint makes while it
        pushes against its stop; *noise* is the mean power of everything that the microphone hears while the
        joint moves freely: the room, the hum, the clicks of the steps. Both are taken over a band of 2 kHz
        about `peak`. Bangs, speech and the drift of the gain come on top and are part of neither.
    peak, peak_width : float
        Of the extra sound's spectrum, Hz. It is random noise, the hardest case: at 2 kHz, the default, it
        fills the whole band and is no easier to tell from the room than by its power.
    rate : int
        Samples per second.
    period : float
        Of a step, s.
    room, clicks, hum : float
        Root mean square of each, full scale being 1.
    mains : float
        Frequency of the hum, Hz.
    bangs, speech : float
        How many begin in a second, on average.
    bang, voice : float
        Root mean square at the loudest.
    drift_db : float
        The gain wanders up and down by so much, within two minutes.
    seed : int
        When bangs and speech come.

    Examples
    --------
    >>> day = Acoustics(snr_db=6.0)
    >>> round(day.stop_power / day.noise_power, 2)
    3.98
    """

    snr_db: float = 12.0
    peak: float = 6000.0
    peak_width: float = BAND
    rate: int = 48000
    period: float = 0.010
    room: float = 0.01
    clicks: float = 0.004
    hum: float = 0.01
    mains: float = 50.0
    bangs: float = 0.0
    speech: float = 0.0
    bang: float = 0.1
    voice: float = 0.03
    drift_db: float = 0.0
    seed: int = 0

    def room_density(self, frequencies: Array) -> Array:
        """Power of the room's noise per Hz, at frequencies above 0, shape (n,)."""
        lowest, highest = 1 / self.period, self.rate / 2
        total = highest - lowest + CORNER * np.log(highest / lowest)
        return self.room**2 / total * (1 + CORNER / np.maximum(frequencies, lowest))

    def click_density(self, frequencies: Array) -> Array:
        """Power of the steps' clicks per Hz, averaged between their harmonics, shape (n,)."""
        click = self.click()
        spectrum = np.abs(
            np.exp(-2j * np.pi * np.outer(frequencies, np.arange(len(click))) / self.rate) @ click
        )
        return 2 * spectrum**2 / (self.rate**2 * self.period)

    def click(self) -> Array:
        """The sound of one step, as long as the step."""
        at = np.arange(round(self.period * self.rate)) / self.rate
        click = np.exp(-at / CLICK_DECAY) * np.sin(2 * np.pi * CLICK_TONE * at)
        return self.clicks / np.sqrt(np.mean(click**2)) * click

    def peak_shape(self, frequencies: Array) -> Array:
        """Power per Hz of the extra sound at the stop, 1 at the peak, shape (n,)."""
        return 1 / (1 + (2 * (frequencies - self.peak) / self.peak_width) ** FLAT_TOP)

    def stop_density(self, frequencies: Array) -> Array:
        """Power per Hz of the extra sound at the stop, shape (n,)."""
        return self.stop_power / _over(self.peak_shape, self._band()) * self.peak_shape(frequencies)

    @property
    def noise_power(self) -> float:
        """Mean power in the band while the joint moves freely, without bangs and speech."""
        band = self._band()
        return _over(self.room_density, band) + _over(self.click_density, band)

    @property
    def stop_power(self) -> float:
        """Mean power in the band that the stop adds."""
        return float(10 ** (self.snr_db / 10) * self.noise_power)

    def _band(self) -> Array:
        return np.linspace(self.peak - BAND / 2, self.peak + BAND / 2, 401)


def _over(density: Callable[[Array], Array], band: Array) -> float:
    return float(np.trapezoid(density(band), band))
