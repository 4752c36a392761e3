"""How far a diagnosis has come, for those who wait for it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Is told what begins now, and the share of the work that is done."""


def silent(step: str, done: float) -> None:
    """Tell nobody."""
