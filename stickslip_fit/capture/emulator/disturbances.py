"""What else goes on in an emulated laboratory: bangs and people talking."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.capture.emulator.acoustics import Acoustics

Array = npt.NDArray[np.float64]

LONGEST = 2  # s; nothing lasts longer
BANG_DECAY = (0.005, 0.06)  # s, shortest and longest
TALK = (0.3, 1.5)  # s
SYLLABLES = 4.0  # per second
VOICED, HISSING = (150.0, 3500.0), (4000.0, 9000.0)  # Hz
HISSES = 0.3  # share of a talk's syllables that hiss


def disturbances(acoustics: Acoustics, began: float, number: int) -> Array:
    """Bangs and speech in a stretch of sound; the same at the same time however it is cut into stretches.

    Each second has its own random numbers, so that what begins in one stretch goes on in the next.

    Parameters
    ----------
    acoustics : Acoustics
    began : float
        When the stretch begins, s.
    number : int
        Its samples.

    Returns
    -------
    array, shape (number,)
    """
    heard = np.zeros(number)
    if acoustics.bangs == 0 and acoustics.speech == 0:
        return heard
    first = round(began * acoustics.rate)
    last_second = int((first + number) / acoustics.rate)
    for second in range(max(int(began) - LONGEST, 0), last_second + 1):
        rng = np.random.default_rng((acoustics.seed, second))
        for rate, event in ((acoustics.bangs, _bang), (acoustics.speech, _talk)):
            for _ in range(rng.poisson(rate)):
                place = round((second + rng.random()) * acoustics.rate) - first
                _add(heard, event(acoustics, rng), place)
    return heard


def _add(heard: Array, event: Array, place: int) -> None:
    low, high = max(place, 0), min(place + len(event), len(heard))
    if low < high:
        heard[low:high] += event[low - place : high - place]


def _bang(acoustics: Acoustics, rng: np.random.Generator) -> Array:
    """Noise of all frequencies, the high ones fading in a lesser or greater degree, that dies away."""
    decay = np.exp(rng.uniform(*np.log(BANG_DECAY)))
    noise = rng.standard_normal(round(8 * decay * acoustics.rate))
    dull = rng.uniform(0.0, 0.9)
    noise[1:] += dull * noise[:-1]
    noise /= np.sqrt(1 + dull**2)
    loud = acoustics.bang * 10 ** rng.uniform(-1, 0)
    return loud * noise * np.exp(-np.arange(len(noise)) / (decay * acoustics.rate))


def _talk(acoustics: Acoustics, rng: np.random.Generator) -> Array:
    """Syllables, voiced or hissing, each a band of noise that swells and fades."""
    syllables = round(rng.uniform(*TALK) * SYLLABLES)
    length = round(acoustics.rate / SYLLABLES)
    swell = np.sin(np.pi * np.arange(length) / length)
    frequencies = np.fft.rfftfreq(length, 1 / acoustics.rate)
    said = []
    for _ in range(syllables):
        low, high = HISSING if rng.random() < HISSES else VOICED
        spectrum = np.fft.rfft(rng.standard_normal(length)) * ((frequencies > low) & (frequencies < high))
        sound = np.fft.irfft(spectrum, length)
        said.append(acoustics.voice * swell * sound / sound.std())
    return np.concatenate(said)
