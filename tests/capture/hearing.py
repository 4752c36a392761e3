"""Sound for tests of the ear."""

import wave

import numpy as np

from stickslip_fit.capture.emulator.acoustics import Acoustics, synthesize_sound
from stickslip_fit.capture.protocols import Samples
from stickslip_fit.capture.tuning import choose_tuning

STEPS, SECONDS = 5, 0.05
AT_ZERO = Acoustics(snr_db=0.0)  # over the whole of the 2 kHz


def steps(acoustics, checks, pushing, seed, began=0.0):
    """So many checks of a joint that moves, or pushes against its stop."""
    way = np.full(STEPS * checks, pushing)
    return synthesize_sound(acoustics, began, np.ones(len(way)), way, np.random.default_rng(seed))


def tuned(acoustics, seed=1):
    """Five seconds of each."""
    listens = (steps(acoustics, 100, pushing, (seed, pushing)) for pushing in (False, True))
    return choose_tuning(*listens, acoustics.rate, SECONDS)


class Played:
    """A source that manipulator out what it is told to, one `Samples` after the other."""

    def __init__(self, samples, rate=Acoustics.rate):
        self.samples = iter(samples)
        self.rate = rate

    def read(self, seconds):
        return next(self.samples)

    def close(self):
        """Nothing to let go of."""


def checks_of(sound, rate=Acoustics.rate):
    """A sound in checks, as a source would hand it out."""
    return [Samples(part) for part in sound.reshape(-1, round(SECONDS * rate))]


def write_wav(path, sound, rate):
    """A sound as 16-bit WAV, by the standard library."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(rate)
        file.writeframes(np.round(32767 * sound).astype("<i2").tobytes())
