"""What a microphone hears of an emulated manipulator."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.disturbances import disturbances
from stickslip_fit.capture.source import Sound

Array = npt.NDArray[np.float64]

UNEVEN = 0.05  # relative standard deviation of a click's height
DRIFT_PERIOD = 120.0  # s


def sound_of(
    acoustics: Acoustics,
    began: float,
    moving: npt.ArrayLike,
    at_stop: npt.ArrayLike,
    rng: np.random.Generator,
) -> Sound:
    """The sound of a stretch of time, a whole number of step periods long.

    Stretches that follow each other make one recording: hum, drift, bangs and speech know the time.

    Parameters
    ----------
    acoustics : Acoustics
    began : float
        When the stretch begins, s.
    moving : array of bool, shape (n,)
        For each step period, whether a step is made in it.
    at_stop : array of bool, shape (n,)
        Whether that step pushes against the stop.
    rng : Generator
        For the room's noise, the stop's and the clicks' unevenness.

    Returns
    -------
    array of float32, shape (n * period * rate,)
        Cut off at full scale, 1, as a converter does.

    Examples
    --------
    >>> check = sound_of(Acoustics(), 0.0, [True] * 5, [False] * 5, np.random.default_rng(1))
    >>> check.shape
    (2400,)
    """
    moving, at_stop = np.asarray(moving, bool), np.asarray(at_stop, bool)
    step = round(acoustics.period * acoustics.rate)
    number = step * len(moving)
    at = began + np.arange(number) / acoustics.rate
    heights = moving * (1 + UNEVEN * rng.standard_normal(len(moving)))
    heard = shaped_noise(acoustics.room_density, number, acoustics.rate, rng)
    heard += np.outer(heights, acoustics.click()).ravel()
    heard += np.sqrt(2) * acoustics.hum * np.sin(2 * np.pi * acoustics.mains * at)
    pushing = moving & at_stop
    if pushing.any():
        stop = shaped_noise(acoustics.stop_density, number, acoustics.rate, rng)
        heard += np.repeat(pushing, step) * stop
    heard += disturbances(acoustics, began, number)
    heard *= 10 ** (acoustics.drift_db / 20 * np.sin(2 * np.pi * at / DRIFT_PERIOD))
    return np.clip(heard, -1, 1).astype(np.float32)


def shaped_noise(
    density: Callable[[Array], Array], number: int, rate: int, rng: np.random.Generator
) -> Array:
    """Gaussian noise of so many samples whose power per Hz is `density` of the frequency."""
    frequencies = np.fft.rfftfreq(number, 1 / rate)
    gain = np.zeros(len(frequencies))
    gain[1:] = np.sqrt(density(frequencies[1:]) * rate / 2)
    return np.fft.irfft(gain * np.fft.rfft(rng.standard_normal(number)), number)
