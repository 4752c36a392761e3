"""How far a diagnosis has come, for those who wait for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stickslip_fit.fit.progress import bar

Progress = Callable[[str, float], None]
"""Is told what begins now, and the share of the work that is done."""


def silent(step: str, done: float) -> None:
    """Tell nobody."""


@contextmanager
def shown() -> Iterator[Progress]:
    """A bar in a notebook or at a terminal: ``with shown() as told: diagnose(log, progress=told)``."""
    with bar(True, total=1.0, bar_format="{desc} {percentage:3.0f}% |{bar}|") as each:

        def tell(step: str, done: float) -> None:
            each.set_description_str(step, refresh=False)
            each.n = done
            each.refresh()

        yield tell
