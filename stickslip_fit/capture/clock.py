"""The time by which a capture runs: the real one, or one that costs nothing to wait by."""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta
from typing import Protocol

BEGINNING = datetime(2012, 3, 5, 8, 30, tzinfo=UTC)


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """Seconds since some moment; never runs backwards."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait."""
        ...

    def today(self) -> datetime:
        """Date and time of day, UTC."""
        ...


class RealClock:
    """The computer's clock."""

    def now(self) -> float:
        """Seconds since some moment; never runs backwards."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(max(seconds, 0.0))

    def today(self) -> datetime:
        """Date and time of day, UTC."""
        return datetime.now(UTC)


class VirtualClock:
    """A clock that moves only when somebody waits by it, and then at once.

    Parameters
    ----------
    begins : datetime
        Date and time at its second 0, with a time zone.

    Examples
    --------
    >>> clock = VirtualClock()
    >>> clock.sleep(90)
    >>> clock.now(), clock.today().isoformat()
    (90.0, '2012-03-05T08:31:30+00:00')
    """

    def __init__(self, begins: datetime = BEGINNING) -> None:
        self.begins = begins
        self._now = 0.0

    def now(self) -> float:
        """Seconds since it began."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Move on by so much; what is less than 0 is 0."""
        self._now += max(seconds, 0.0)

    def today(self) -> datetime:
        """Date and time of day, UTC."""
        return self.begins.astimezone(UTC) + timedelta(seconds=self._now)
