"""Sound: from a microphone or a WAV file, faults in it, and power spectra of checks.

A check is the sound of a few steps. The power in a band of Gaussian noise, over its mean, is
distributed nearly as chi2(df) / df; `power_df` gives the degrees of freedom.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from threading import Condition
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.capture.protocols import Samples, Sound
from stickslip_fit.errors import InputError, InputIssue

SAMPLE_RATE = 48000
BUFFER_SECONDS = 5.0  # s of sound
READ_TIMEOUT = 1.0  # s that a sound may be late before the microphone is taken to be gone


class Microphone:
    """Listens all the time and keeps the last seconds; a `Source`.

    Parameters
    ----------
    device : str or int, optional
        A name, a part of one, or a number of `python -m sounddevice`'s list; without one the system's choice.
    rate : int, optional

    Raises
    ------
    InputError
        If sounddevice, PortAudio or the device is missing.
    """

    def __init__(self, device: str | int | None = None, rate: int = SAMPLE_RATE) -> None:
        self.rate = rate
        self._blocks: deque[Sound] = deque()
        self._held = 0
        self._heard_until = 0.0
        self._overflowed = False
        self._news = Condition()
        self._stream = _open_stream(device, rate, self._take)
        self._stream.start()

    def read(self, seconds: float) -> Samples:
        """The so many seconds up to now, once they have come through; fewer where the microphone is gone."""
        now = self._stream.time
        with self._news:
            come = self._news.wait_for(lambda: self._heard_until >= now, READ_TIMEOUT)
            values = np.concatenate(self._blocks) if self._blocks else np.zeros(0, np.float32)
            overflowed, self._overflowed = self._overflowed, False
            newer = round((self._heard_until - now) * self.rate)
        if not come:
            return Samples(values[:0], overflowed)
        values = values[: len(values) - newer]
        return Samples(values[max(len(values) - round(seconds * self.rate), 0) :], overflowed)

    def close(self) -> None:
        """Stop listening."""
        self._stream.close()

    def _take(self, block: np.ndarray, frames: int, times: Any, status: Any) -> None:
        """Called from the sound system's own thread with each block of samples."""
        # Some systems do not say when a block was heard; then the time when it comes must do.
        ended = (
            times.inputBufferAdcTime + frames / self.rate if times.inputBufferAdcTime else times.currentTime
        )
        with self._news:
            self._blocks.append(block[:, 0].copy())
            self._held += frames
            while self._held - len(self._blocks[0]) > BUFFER_SECONDS * self.rate:
                self._held -= len(self._blocks.popleft())
            self._heard_until = ended
            self._overflowed |= bool(status.input_overflow)
            self._news.notify_all()


def _open_stream(device: str | int | None, rate: int, take: Any) -> Any:
    try:
        import sounddevice
    except ImportError:
        raise InputError("a microphone needs sounddevice; install it: pip install sounddevice") from None
    except OSError:
        raise InputError(
            "a microphone needs the PortAudio library; install it (Debian, Ubuntu: apt install libportaudio2)"
        ) from None
    try:
        return sounddevice.InputStream(rate, device=device, channels=1, dtype="float32", callback=take)
    except (sounddevice.PortAudioError, ValueError) as error:
        which = "no microphone" if device is None else f"no microphone {device!r}"
        raise InputError(
            f"{which} can be listened to at {rate:,} samples per second ({error}); "
            "`python -m sounddevice` lists the devices"
        ) from None


class Recording:
    """Sound that has been recorded, handed out from its beginning; a `Source`.

    Parameters
    ----------
    values : array of float32, shape (n,)
    rate : int

    Examples
    --------
    >>> recording = Recording(np.zeros(100, np.float32), 1000)
    >>> [len(recording.read(0.06).values) for _ in range(3)]
    [60, 40, 0]
    """

    def __init__(self, values: Sound, rate: int) -> None:
        self.values = values
        self.rate = rate
        self._place = 0

    def read(self, seconds: float) -> Samples:
        """The next so many seconds; fewer where the recording ends."""
        begin, self._place = self._place, self._place + round(seconds * self.rate)
        return Samples(self.values[begin : self._place])

    def close(self) -> None:
        """There is nothing to let go of."""


def read_wav(path: str | Path) -> Recording:
    """Read a WAV file, or another that libsndfile knows; its first channel.

    Raises
    ------
    InputError
        If soundfile is not installed, or the file is missing or no sound.
    """
    try:
        import soundfile
    except ImportError:
        raise InputError(
            InputIssue("can only be read with soundfile; install it: pip install soundfile", str(path))
        ) from None
    if not Path(path).is_file():
        raise InputError(InputIssue("there is no such file; give a recording", str(path)))
    try:
        values, rate = soundfile.read(path, dtype="float32", always_2d=True)
    except soundfile.SoundFileError as error:
        raise InputError(InputIssue(f"is no sound file ({error}); give a WAV file", str(path))) from None
    return Recording(np.ascontiguousarray(values[:, 0]), int(rate))


FULL_SCALE = 0.999
MIN_CLIPPED_SAMPLES = 4  # samples of a check at full scale
MAX_DEAD_POWER = 1e-3  # of the power that was tuned to: what a microphone that is unplugged leaves is fainter


def find_fault(samples: Samples, expected: int) -> str:
    """A sentence on what is wrong and what to do, or nothing.

    Parameters
    ----------
    samples : Samples
    expected : int
        How many there should be; half of them will do, since some sources round.

    Examples
    --------
    >>> find_fault(Samples(np.zeros(2400, np.float32)), 2400)
    'the microphone is dead: it gives one value only; see that it is plugged in and not muted'
    """
    values = samples.values
    if samples.overflowed:
        return "sound was lost before it was listened to; close other programs and try again"
    if len(values) < expected / 2:
        return "the sound has ended; see that the microphone is still plugged in"
    if not np.all(np.isfinite(values)):
        return "the sound holds values that are no numbers; choose another device"
    if len(values) and np.ptp(values) == 0:
        return "the microphone is dead: it gives one value only; see that it is plugged in and not muted"
    if np.count_nonzero(np.abs(values) >= FULL_SCALE) >= MIN_CLIPPED_SAMPLES:
        return "the sound clips; turn the microphone's gain down and tune again"
    return ""


def is_dead(band: float, reference: float) -> bool:
    """Whether powers over those that were tuned to are those of no microphone at all."""
    return band < MAX_DEAD_POWER and reference < MAX_DEAD_POWER


TAPER_SHARE = 0.1  # share of a check that is faded in and out, so that hum does not leak into far frequencies


def bin_frequencies(number: int, rate: int) -> Array:
    """Of the bins of a check of so many samples, Hz."""
    return np.fft.rfftfreq(number, 1 / rate)


def power_densities(values: npt.NDArray[np.floating], rate: int) -> Array:
    """Power per Hz of each check.

    Parameters
    ----------
    values : array, shape (..., number)
    rate : int
        Samples per second.

    Returns
    -------
    array, shape (..., number // 2 + 1)

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(0, 1, (200, 480))
    >>> round(float(power_densities(noise, 48000).mean()) * 24000, 2)
    1.0
    """
    window = tukey_window(values.shape[-1])
    spectrum = np.fft.rfft(values * window)
    return 2 * (spectrum.real**2 + spectrum.imag**2) / (rate * np.sum(window**2))


def tukey_window(number: int) -> Array:
    """A window that is 1 but for a cosine at either end, shape (number,)."""
    at = (np.arange(number) + 0.5) / number
    edge = np.minimum(np.minimum(at, 1 - at) * 2 / TAPER_SHARE, 1.0)
    return np.sin(np.pi / 2 * edge) ** 2


def power_df(bins: int, number: int) -> float:
    """Degrees of freedom of the summed power of so many neighbouring bins of Gaussian noise.

    Each bin has two; the window takes a twentieth away, since what it fades out counts less:
    (sum w^2)^2 / (n sum w^4).
    """
    window = tukey_window(number)
    return float(2 * bins * np.sum(window**2) ** 2 / (number * np.sum(window**4)))
