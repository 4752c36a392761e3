"""Acoustics: the sound of an emulated manipulator.

It is made of room noise, clicks of the steps, mains hum, the extra sound at a stop, and disturbances (bangs
and speech).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.capture.protocols import Sound

BAND_WIDTH = 2000.0  # Hz, about the stop's peak; in it the signal-to-noise ratio is taken
CORNER_FREQUENCY = 800.0  # Hz; below it the room's noise grows as 1/f
CLICK_TONE, CLICK_DECAY = 1800.0, 4e-4  # Hz, s: each step rings so
PEAK_ORDER = 8  # exponent of the peak's shape: a higher one is flatter on top and steeper at the sides


@dataclass(frozen=True)
class Acoustics:
    """The sounds about an emulated manipulator on one day.

    Attributes
    ----------
    snr_db : float
        Signal-to-noise ratio. *Signal* is the mean power of the extra sound at the stop; *noise* is that of
        everything that the microphone hears while the joint moves freely: room, hum, clicks of the steps.
        Both are taken over a band of 2 kHz about `peak`. Bangs, speech and drift are part of neither.
    peak, peak_width : float
        Of the extra sound's spectrum, Hz. It is random noise, the hardest case: at 2 kHz, the default, it
        fills the whole band and differs from the room by its power alone.
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
        Amplitude of the gain's drift, with a period of two minutes.
    seed : int
        Of the times of bangs and speech.

    Examples
    --------
    >>> day = Acoustics(snr_db=6.0)
    >>> round(day.stop_power / day.noise_power, 2)
    3.98
    """

    snr_db: float = 12.0
    peak: float = 6000.0
    peak_width: float = BAND_WIDTH
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
        total = highest - lowest + CORNER_FREQUENCY * np.log(highest / lowest)
        return self.room**2 / total * (1 + CORNER_FREQUENCY / np.maximum(frequencies, lowest))

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
        return 1 / (1 + (2 * (frequencies - self.peak) / self.peak_width) ** PEAK_ORDER)

    def stop_density(self, frequencies: Array) -> Array:
        """Power per Hz of the extra sound at the stop, shape (n,)."""
        return self.stop_power / _integrate(self.peak_shape, self._band()) * self.peak_shape(frequencies)

    @property
    def noise_power(self) -> float:
        """Mean power in the band while the joint moves freely, without bangs and speech."""
        band = self._band()
        return _integrate(self.room_density, band) + _integrate(self.click_density, band)

    @property
    def stop_power(self) -> float:
        """Mean power in the band that the stop adds."""
        return float(10 ** (self.snr_db / 10) * self.noise_power)

    def _band(self) -> Array:
        return np.linspace(self.peak - BAND_WIDTH / 2, self.peak + BAND_WIDTH / 2, 401)


def _integrate(density: Callable[[Array], Array], band: Array) -> float:
    return float(np.trapezoid(density(band), band))


MAX_DISTURBANCE_SECONDS = 2  # longest duration
BANG_DECAY = (0.005, 0.06)  # s, shortest and longest
SPEECH_SECONDS = (0.3, 1.5)  # s
SYLLABLE_RATE = 4.0  # per second
VOICED_BAND, HISS_BAND = (150.0, 3500.0), (4000.0, 9000.0)  # Hz
HISS_SHARE = 0.3  # of the syllables hiss


def synthesize_disturbances(acoustics: Acoustics, began: float, number: int) -> Array:
    """Bangs and speech in `number` samples from `began`, s; shape (number,).

    Each second has its own random numbers, so that the sound does not depend on how it is cut into stretches.
    """
    sound = np.zeros(number)
    if acoustics.bangs == 0 and acoustics.speech == 0:
        return sound
    first = round(began * acoustics.rate)
    last_second = int((first + number) / acoustics.rate)
    for second in range(max(int(began) - MAX_DISTURBANCE_SECONDS, 0), last_second + 1):
        rng = np.random.default_rng((acoustics.seed, second))
        for rate, event in ((acoustics.bangs, _synthesize_bang), (acoustics.speech, _synthesize_speech)):
            for _ in range(rng.poisson(rate)):
                position = round((second + rng.random()) * acoustics.rate) - first
                _add_event(sound, event(acoustics, rng), position)
    return sound


def _add_event(sound: Array, event: Array, position: int) -> None:
    low, high = max(position, 0), min(position + len(event), len(sound))
    if low < high:
        sound[low:high] += event[low - position : high - position]


def _synthesize_bang(acoustics: Acoustics, rng: np.random.Generator) -> Array:
    """Decaying noise, its high frequencies more or less damped."""
    decay = np.exp(rng.uniform(*np.log(BANG_DECAY)))
    noise = rng.standard_normal(round(8 * decay * acoustics.rate))
    dull = rng.uniform(0.0, 0.9)
    noise[1:] += dull * noise[:-1]
    noise /= np.sqrt(1 + dull**2)
    loudness = acoustics.bang * 10 ** rng.uniform(-1, 0)
    return loudness * noise * np.exp(-np.arange(len(noise)) / (decay * acoustics.rate))


def _synthesize_speech(acoustics: Acoustics, rng: np.random.Generator) -> Array:
    """Syllables, voiced or hissing, each a band of noise that swells and fades."""
    syllables = round(rng.uniform(*SPEECH_SECONDS) * SYLLABLE_RATE)
    length = round(acoustics.rate / SYLLABLE_RATE)
    swell = np.sin(np.pi * np.arange(length) / length)
    frequencies = np.fft.rfftfreq(length, 1 / acoustics.rate)
    sounds = []
    for _ in range(syllables):
        low, high = HISS_BAND if rng.random() < HISS_SHARE else VOICED_BAND
        spectrum = np.fft.rfft(rng.standard_normal(length)) * ((frequencies > low) & (frequencies < high))
        sound = np.fft.irfft(spectrum, length)
        sounds.append(acoustics.voice * swell * sound / sound.std())
    return np.concatenate(sounds)


CLICK_HEIGHT_SD = 0.05  # relative standard deviation of a click's height
DRIFT_PERIOD = 120.0  # s


def synthesize_sound(
    acoustics: Acoustics,
    began: float,
    moving: npt.ArrayLike,
    at_stop: npt.ArrayLike,
    rng: np.random.Generator,
) -> Sound:
    """The sound of a stretch of time, a whole number of step periods long.

    Consecutive stretches make one recording: hum, drift, bangs and speech depend on the time.

    Parameters
    ----------
    began : float
        Beginning of the stretch, s.
    moving : array of bool, shape (n,)
        For each step period, whether a step is made in it.
    at_stop : array of bool, shape (n,)
        Whether that step pushes against the stop.
    rng : Generator
        Of the noise and the heights of the clicks.

    Returns
    -------
    array of float32, shape (n * period * rate,)
        Clipped at full scale, 1.

    Examples
    --------
    >>> check = synthesize_sound(Acoustics(), 0.0, [True] * 5, [False] * 5, np.random.default_rng(1))
    >>> check.shape
    (2400,)
    """
    moving, at_stop = np.asarray(moving, bool), np.asarray(at_stop, bool)
    step = round(acoustics.period * acoustics.rate)
    number = step * len(moving)
    time = began + np.arange(number) / acoustics.rate
    heights = moving * (1 + CLICK_HEIGHT_SD * rng.standard_normal(len(moving)))
    sound = draw_shaped_noise(acoustics.room_density, number, acoustics.rate, rng)
    sound += np.outer(heights, acoustics.click()).ravel()
    sound += np.sqrt(2) * acoustics.hum * np.sin(2 * np.pi * acoustics.mains * time)
    pushing = moving & at_stop
    if pushing.any():
        stop = draw_shaped_noise(acoustics.stop_density, number, acoustics.rate, rng)
        sound += np.repeat(pushing, step) * stop
    sound += synthesize_disturbances(acoustics, began, number)
    sound *= 10 ** (acoustics.drift_db / 20 * np.sin(2 * np.pi * time / DRIFT_PERIOD))
    return np.clip(sound, -1, 1).astype(np.float32)


def draw_shaped_noise(
    density: Callable[[Array], Array], number: int, rate: int, rng: np.random.Generator
) -> Array:
    """Gaussian noise of so many samples whose power per Hz is `density` of the frequency."""
    frequencies = np.fft.rfftfreq(number, 1 / rate)
    gain = np.zeros(len(frequencies))
    gain[1:] = np.sqrt(density(frequencies[1:]) * rate / 2)
    return np.fft.irfft(gain * np.fft.rfft(rng.standard_normal(number)), number)
