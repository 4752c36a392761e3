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
READ_TIMEOUT = 1.0  # s; a longer delay counts as a disconnected microphone


class Microphone:
    """An `AudioSource` that records continuously and keeps the last seconds.

    Parameters
    ----------
    device : str or int, optional
        A name, a part of one, or a number in the list of `python -m sounddevice`; else the system's default.

    Raises
    ------
    InputError
        If sounddevice, PortAudio or the device is missing.
    """

    def __init__(self, device: str | int | None = None, rate: int = SAMPLE_RATE) -> None:
        self.rate = rate
        self._blocks: deque[Sound] = deque()
        self._n_buffered = 0
        self._heard_until = 0.0
        self._overflowed = False
        self._arrived = Condition()
        self._stream = _open_stream(device, rate, self._add_block)
        self._stream.start()

    def read(self, seconds: float) -> Samples:
        """Return the so many seconds up to now, fewer where the microphone is disconnected."""
        now = self._stream.time
        with self._arrived:
            in_time = self._arrived.wait_for(lambda: self._heard_until >= now, READ_TIMEOUT)
            values = np.concatenate(self._blocks) if self._blocks else np.zeros(0, np.float32)
            overflowed, self._overflowed = self._overflowed, False
            newer = round((self._heard_until - now) * self.rate)
        if not in_time:
            return Samples(values[:0], overflowed)
        values = values[: len(values) - newer]
        return Samples(values[max(len(values) - round(seconds * self.rate), 0) :], overflowed)

    def close(self) -> None:
        """Stop listening."""
        self._stream.close()

    def _add_block(self, block: np.ndarray, frames: int, times: Any, status: Any) -> None:
        """Buffer a block of samples; called from the sound system's thread."""
        recorded = times.inputBufferAdcTime  # 0 where the system does not know it
        ended = recorded + frames / self.rate if recorded else times.currentTime
        with self._arrived:
            self._blocks.append(block[:, 0].copy())
            self._n_buffered += frames
            while self._n_buffered - len(self._blocks[0]) > BUFFER_SECONDS * self.rate:
                self._n_buffered -= len(self._blocks.popleft())
            self._heard_until = ended
            self._overflowed |= bool(status.input_overflow)
            self._arrived.notify_all()


def _open_stream(device: str | int | None, rate: int, callback: Any) -> Any:
    try:
        import sounddevice
    except ImportError:
        raise InputError(
            "a microphone needs sounddevice; install it: pip install 'stickslip-fit[capture]'"
        ) from None
    except OSError:
        raise InputError(
            "a microphone needs the PortAudio library; install it (Debian, Ubuntu: apt install libportaudio2)"
        ) from None
    try:
        return sounddevice.InputStream(rate, device=device, channels=1, dtype="float32", callback=callback)
    except (sounddevice.PortAudioError, ValueError) as error:
        name = "no microphone" if device is None else f"no microphone {device!r}"
        raise InputError(
            f"{name} can be listened to at {rate:,} samples per second ({error}); "
            "`python -m sounddevice` lists the devices"
        ) from None


class Recording:
    """A recording as an `AudioSource`, read from its beginning.

    Examples
    --------
    >>> recording = Recording(np.zeros(100, np.float32), 1000)
    >>> [len(recording.read(0.06).values) for _ in range(3)]
    [60, 40, 0]
    """

    def __init__(self, values: Sound, rate: int) -> None:
        self.values = values
        self.rate = rate
        self._position = 0

    def read(self, seconds: float) -> Samples:
        """The next so many seconds; fewer where the recording ends."""
        begin, self._position = self._position, self._position + round(seconds * self.rate)
        return Samples(self.values[begin : self._position])

    def close(self) -> None:
        """Nothing to release."""


def read_wav(path: str | Path) -> Recording:
    """Read the first channel of a WAV file, or another that libsndfile knows; raises InputError."""
    try:
        import soundfile
    except ImportError:
        raise InputError(
            InputIssue(
                "can only be read with soundfile; install it: pip install 'stickslip-fit[capture]'", str(path)
            )
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
MAX_DEAD_POWER = 1e-3  # over the power in the tuning; that of an unplugged microphone is lower


def find_fault(samples: Samples, expected: int) -> str:
    """What is wrong with a sound of `expected` samples, or nothing; half of them suffice.

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
    """Whether powers, over those of the tuning, are too low for any microphone."""
    return band < MAX_DEAD_POWER and reference < MAX_DEAD_POWER


TAPER_SHARE = 0.1  # of a check is tapered, so that hum does not leak into distant frequencies


def bin_frequencies(number: int, rate: int) -> Array:
    """Frequencies of the bins of a check of so many samples, Hz."""
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
    """Tukey window: 1 with a cosine taper at either end, shape (number,)."""
    position = (np.arange(number) + 0.5) / number
    edge = np.minimum(np.minimum(position, 1 - position) * 2 / TAPER_SHARE, 1.0)
    return np.sin(np.pi / 2 * edge) ** 2


def power_df(bins: int, number: int) -> float:
    """Degrees of freedom of the summed power of so many neighbouring bins of Gaussian noise.

    Each bin has two, times (sum w^2)^2 / (n sum w^4) for the window, about 0.95.
    """
    window = tukey_window(number)
    return float(2 * bins * np.sum(window**2) ** 2 / (number * np.sum(window**4)))
