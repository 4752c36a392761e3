"""Progress on standard error: a bar at a terminal and in a notebook, elsewhere a line now and then."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm

DELAY = 2.0  # s, before a bar is shown
LINE_EVERY = 10.0  # s, where there is no terminal
ProgressCallback = Callable[[str, float], None]
"""Called with the step that begins and the share of the work that is done."""


def ignore_progress(step: str, done: float) -> None:
    """Show nothing."""


@contextmanager
def show_progress() -> Iterator[ProgressCallback]:
    """Progress of work in steps: ``with show_progress() as callback: diagnose(log, progress=callback)``."""
    line = "{desc}: {percentage:.0f} %"
    drawn = "{desc} {percentage:3.0f}% |{bar}|"
    with progress_bar(True, line, total=1.0, delay=DELAY, miniters=0, bar_format=drawn) as bar:

        def update(step: str, done: float) -> None:
            bar.set_description_str(step, refresh=False)
            bar.update(done - bar.n)

        yield update


def progress_bar(shown: bool, line_format: str, **options: Any) -> tqdm:
    """A tqdm that disappears when done.

    Parameters
    ----------
    shown : bool
        False for one that shows nothing.
    line_format : str
        tqdm's `bar_format` where there is no terminal, so that a file of messages can be read.
    **options
        tqdm's.
    """
    with warnings.catch_warnings():
        # A notebook without ipywidgets shows no warning.
        warnings.filterwarnings("ignore", message="IProgress not found|Using `tqdm.autonotebook")
        # Unlike `tqdm.auto`, it imports nothing for asynchronous loops.
        from tqdm.autonotebook import tqdm

    bar = tqdm(disable=None if shown else True, leave=False, **options)
    if not (shown and bar.disable):
        return bar
    as_lines = {
        "file": _Lines(options.get("file") or sys.stderr),
        "bar_format": line_format,
        "delay": LINE_EVERY,
        "mininterval": LINE_EVERY,
    }
    return tqdm(leave=False, **options | as_lines)


class _Lines(io.TextIOBase):
    """A stream on which what a bar writes over itself becomes lines."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """A line for every state of the bar but the last, empty one."""
        if state := text.strip():
            with suppress(OSError):
                self.stream.write(f"{state}\n")
                self.stream.flush()
        return len(text)
