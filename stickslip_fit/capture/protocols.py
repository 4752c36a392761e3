"""Interfaces of a rig: Controller, EndStopDetector, AudioSource and Clock.

Joints 1, 2 and 3 are driven by the channels A, B and C. `VirtualClock` advances when someone waits for
it, so that an emulated campaign takes no time.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Protocol

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError


class ControllerError(InputError):
    """The controller refused or did not answer; says which joint, which command, its words, what to do."""


class ConnectionLost(ControllerError):
    """The connection to the controller is lost."""


class Controller(Protocol):
    """An open-loop controller of a few joints."""

    def step(self, joint: int, steps: int) -> None:
        """Make coarse steps, and return when they are done.

        Parameters
        ----------
        joint : int
            1, 2 or 3.
        steps : int
            More than 0 in direction ``+``, less in ``-``.

        Raises
        ------
        ControllerError
            If the controller refuses, or doesn't answer in time.
        ConnectionLost
        """

    def stop(self) -> None:
        """Stop whatever moves, at once."""

    def version(self) -> str:
        """The controller's name for itself and its firmware; empty where it has none."""

    def close(self) -> None:
        """Close the connection."""


CHANNELS = {1: "A", 2: "B", 3: "C"}
STEP_PERIOD = 0.010  # s


def channel_of(joint: int) -> str:
    """The channel that drives a joint; raises InputError for a joint other than 1, 2, 3."""
    if joint not in CHANNELS:
        raise InputError(f"joint {joint} is none of 1, 2, 3; correct the plan")
    return CHANNELS[joint]


def split_move(steps: int, max_steps: int) -> Iterator[int]:
    """Split a move into parts of at most `max_steps`.

    Examples
    --------
    >>> list(split_move(-250, 100))
    [-100, -100, -50]
    """
    remaining = abs(steps)
    while remaining:
        part = min(remaining, max_steps)
        remaining -= part
        yield part if steps > 0 else -part


@dataclass(frozen=True)
class Detection:
    """Result of one check for the end stop.

    Attributes
    ----------
    at_stop : bool
        The joint has run into its stop.
    level : float
        Power in the tuned band over the running baseline of this traverse, dB; NaN while there is none.
    fault : str
        Empty, or why nothing can be detected, which must end the drive: sound was lost, the microphone clips
        or is dead.
    late_checks : int
        Where `at_stop`: how many checks ago the stop was first detected, since it takes two; the count leaves
        out the steps of these checks.
    """

    at_stop: bool
    level: float
    fault: str = ""
    late_checks: int = 0


class EndStopDetector(Protocol):
    """Detects the end stop in one traverse at a time."""

    def begin(self) -> None:
        """Begin a new traverse."""

    def check(self, seconds: float) -> Detection:
        """Check the last so many seconds, those of the steps since the check before."""

    def close(self) -> None:
        """Release the audio source."""


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


class AudioSource(Protocol):
    """A stream of sound; each sample is returned at most once.

    Attributes
    ----------
    rate : int
        Samples per second.
    """

    rate: int

    def read(self, seconds: float) -> Samples:
        """Wait for and return the newest so many seconds; older samples are dropped."""

    def close(self) -> None:
        """Release the device or the file."""


VIRTUAL_START = datetime(2012, 3, 5, 8, 30, tzinfo=UTC)


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """Monotonic time, s."""

    def sleep(self, seconds: float) -> None:
        """Wait."""

    def today(self) -> datetime:
        """Date and time of day, UTC."""


class RealClock(Clock):
    """The computer's clock."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(max(seconds, 0.0))

    def today(self) -> datetime:
        return datetime.now(UTC)


class VirtualClock(Clock):
    """A clock that advances only in `sleep`, and then at once; it begins at a date and time with a time zone.

    Examples
    --------
    >>> clock = VirtualClock()
    >>> clock.sleep(90)
    >>> clock.now(), clock.today().isoformat()
    (90.0, '2012-03-05T08:31:30+00:00')
    """

    def __init__(self, begins: datetime = VIRTUAL_START) -> None:
        self.begins = begins
        self._now = 0.0

    def now(self) -> float:
        """Seconds since it began."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Advance by so much; not by less than 0."""
        self._now += max(seconds, 0.0)

    def today(self) -> datetime:
        return self.begins.astimezone(UTC) + timedelta(seconds=self._now)


class PacedClock(VirtualClock):
    """A virtual clock so many times as fast as the real one, so that people can follow an emulated rig.

    A wait takes `MAX_PAUSE` at most: a night between two sessions is no part of what is to be seen.
    """

    MAX_PAUSE = 0.5  # s

    def __init__(self, pace: float, begins: datetime = VIRTUAL_START) -> None:
        super().__init__(begins)
        self.pace = pace

    def sleep(self, seconds: float) -> None:
        """Advance by so much, and wait."""
        super().sleep(seconds)
        time.sleep(min(max(seconds, 0.0) / self.pace, self.MAX_PAUSE))
