"""Which other sessions a session may look back on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

AtHand = Callable[[Sequence[str], str], tuple[str, ...]]
"""All sessions in order of time, and one of them, to those that it may look back on."""


def other_sessions(sessions: Sequence[str], session: str) -> tuple[str, ...]:
    """All but itself: right where sessions differ by chance, and makes the most of a short log.

    Examples
    --------
    >>> other_sessions(["Mon", "Tue", "Wed"], "Tue")
    ('Mon', 'Wed')
    """
    return tuple(each for each in sessions if each != session)


def earlier_sessions(sessions: Sequence[str], session: str) -> tuple[str, ...]:
    """Those before it, as on the day.

    Examples
    --------
    >>> earlier_sessions(["Mon", "Tue", "Wed"], "Tue")
    ('Mon',)
    """
    return tuple(sessions[: list(sessions).index(session)])
