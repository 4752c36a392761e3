"""Sound from a microphone."""

from __future__ import annotations

from collections import deque
from threading import Condition
from typing import Any

import numpy as np

from stickslip_fit.capture.source import Samples, Sound
from stickslip_fit.errors import InputError

RATE = 48000
KEPT = 5.0  # s of sound
PATIENCE = 1.0  # s that a sound may be late before the microphone is taken to be gone


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

    def __init__(self, device: str | int | None = None, rate: int = RATE) -> None:
        self.rate = rate
        self._blocks: deque[Sound] = deque()
        self._held = 0
        self._heard_until = 0.0
        self._overflowed = False
        self._news = Condition()
        self._stream = _open(device, rate, self._take)
        self._stream.start()

    def read(self, seconds: float) -> Samples:
        """The so many seconds up to now, once they have come through; fewer where the microphone is gone."""
        now = self._stream.time
        with self._news:
            come = self._news.wait_for(lambda: self._heard_until >= now, PATIENCE)
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
            while self._held - len(self._blocks[0]) > KEPT * self.rate:
                self._held -= len(self._blocks.popleft())
            self._heard_until = ended
            self._overflowed |= bool(status.input_overflow)
            self._news.notify_all()


def _open(device: str | int | None, rate: int, take: Any) -> Any:
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
