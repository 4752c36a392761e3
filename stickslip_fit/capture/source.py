"""Where sound comes from: a microphone, a file, the emulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Sound = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Samples:
    """A stretch of sound.

    Attributes
    ----------
    values : array of float32, shape (n,)
        Full scale is 1; fewer than were asked for where the sound has ended.
    overflowed : bool
        Whether sound was lost before or within these samples.
    """

    values: Sound
    overflowed: bool = False


class Source(Protocol):
    """Sound as it comes; each sample is handed out at most once.

    Attributes
    ----------
    rate : int
        Samples per second.
    """

    rate: int

    def read(self, seconds: float) -> Samples:
        """The newest so many seconds, waiting for what has not been heard yet; older ones are dropped."""

    def close(self) -> None:
        """Let go of the device or the file."""
