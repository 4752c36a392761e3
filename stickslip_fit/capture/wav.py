"""Sound from a file, as if it were heard now."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stickslip_fit.capture.source import Samples, Sound
from stickslip_fit.errors import InputError, Problem


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
            Problem("can only be read with soundfile; install it: pip install soundfile", str(path))
        ) from None
    if not Path(path).is_file():
        raise InputError(Problem("there is no such file; give a recording", str(path)))
    try:
        values, rate = soundfile.read(path, dtype="float32", always_2d=True)
    except soundfile.SoundFileError as error:
        raise InputError(Problem(f"is no sound file ({error}); give a WAV file", str(path))) from None
    return Recording(np.ascontiguousarray(values[:, 0]), int(rate))
