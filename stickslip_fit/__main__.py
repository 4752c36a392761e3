"""``python -m stickslip_fit`` and ``stickslip-fit`` are the command line.

An interrupt ends the program with status 130 and one message, also while its libraries are imported. Until
that is arranged, nothing else is imported.
"""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

STATUS = 130
MESSAGE = b"interrupted; nothing was left half-written\n"


def main() -> None:
    """Run the command line."""
    try:
        _raise_interrupts()
        _collect_rarely()
        _keep_memory()
        from stickslip_fit.cli import main as run

        try:
            run()
        finally:
            _ignore_interrupts()
            _end_without_collecting()
    except KeyboardInterrupt:
        end()


def end() -> None:
    """End at once, without what Python does before it ends, which a second interrupt would break."""
    try:
        os.write(2, MESSAGE)
    finally:
        os._exit(STATUS)


def interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; but end within an import, where libraries lose it or make it another error."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            end()
        frame = frame.f_back
    raise KeyboardInterrupt


def _collect_rarely() -> None:
    """Look for garbage in cycles 700 times as rarely: it took 5 % of a report, and there is next to none."""
    import gc

    gc.set_threshold(500_000)


def _end_without_collecting() -> None:
    """Have Python look for no garbage as it ends: that took 7 % of a diagnosis."""
    import gc

    gc.freeze()


def _keep_memory() -> None:
    """Have freed arrays used again instead of returned: clearing new memory took 5 % of a diagnosis."""
    import ctypes

    if sys.platform == "linux" and (set_option := getattr(ctypes.CDLL(None), "mallopt", None)):
        for option in (-1, -3):  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc
            set_option(option, 1 << 30)


def _raise_interrupts() -> None:
    import signal

    # A shell that starts a job in the background has it ignore interrupts.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    shown = sys.unraisablehook

    def show_unraisable(failure: sys.UnraisableHookArgs) -> None:
        # In a destructor or a callback from C, an interrupt can be raised no further.
        if isinstance(failure.exc_value, KeyboardInterrupt):
            end()
        shown(failure)

    sys.unraisablehook = show_unraisable


def _ignore_interrupts() -> None:
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    main()
