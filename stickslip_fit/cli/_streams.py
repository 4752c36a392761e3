"""Standard output and error: any encoding, closed, full, or with a reader who has gone; and exit statuses."""

from __future__ import annotations

import codecs
import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TextIO

from stickslip_fit.errors import InputError

OUTPUT_FAILED, BAD_INPUT, INTERRUPTED, READER_GONE = 1, 2, 130, 141
INTERRUPTED_MESSAGE = "interrupted; nothing was left half-written"
TRANSLITERATION = {
    **{"µ": "u", "μ": "u", "−": "-", "–": "-", "—": "-", "…": "...", "±": "+-", "×": "x", "·": "*"},
    **{"²": "^2", "³": "^3", "°": "deg", "≤": "<=", "≥": ">=", "≈": "~", "→": "->", "█": "#"},
    **{"α": "alpha", "β": "beta", "γ": "gamma", "θ": "theta", "ρ": "rho", "σ": "sigma", "ψ": "psi"},
    **{"ω": "omega", "χ": "chi", "’": "'", "“": '"', "”": '"', "ä": "a", "ö": "o", "ü": "u", "é": "e"},
}


def open_standard_streams() -> None:
    """Make every print possible: closed streams fail when written to, and no character is refused."""
    for handle in range(3):
        # Without this, the next file that is opened would take the closed stream's place.
        with suppress(OSError):
            os.fstat(handle)
            continue
        os.open(os.devnull, os.O_RDONLY)
    # A device that is open for reading refuses to be written to, as a closed stream does.
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    codecs.register_error("transliterate", transliterate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="transliterate")


def transliterate(error: UnicodeError) -> tuple[str | bytes, int]:
    """Characters that a stream's encoding lacks, as ASCII; stray bytes of a file name as they were."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    first = error.object[error.start]
    if "\udc80" <= first <= "\udcff":
        return bytes([ord(first) - 0xDC00]), error.start + 1
    escaped = first.encode("ascii", "backslashreplace").decode("ascii")
    return TRANSLITERATION.get(first, escaped), error.start + 1


def run_with_streams(command: Callable[[], Any]) -> int:
    """Run a command line, with all it prints; its exit status, and one message where there is a fault."""
    output, errors = sys.stdout, sys.stderr
    try:
        try:
            command()
            status = 0
        except SystemExit as ended:
            # The command line's library makes status 1 of a reader who has gone.
            if isinstance(ended.__context__, BrokenPipeError):
                raise BrokenPipeError from None
            status = ended.code if isinstance(ended.code, int) else 0
        finally:
            sys.stdout, sys.stderr = output, errors
        if status == INTERRUPTED:
            print_error(INTERRUPTED_MESSAGE)
        output.flush()
    except InputError as error:
        status = BAD_INPUT
        print_error(error.at_shell)
    except BrokenPipeError:
        status = READER_GONE
    except OSError as error:
        status = OUTPUT_FAILED
        print_error(f"{error.filename or 'standard output'}: cannot be written ({error.strerror})")
    for stream in (output, errors):
        _discard_rest(stream)
    return status


def print_error(message: str) -> None:
    """Print to standard error, if that can be written to."""
    with suppress(OSError):
        print(message, file=sys.stderr, flush=True)


def show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning as a sentence, without the place in the code; as `warnings.showwarning`."""
    print_error(f"warning: {message}")


def _discard_rest(stream: TextIO) -> None:
    """What cannot be written would be tried again as Python ends, and complained about."""
    try:
        stream.flush()
    except OSError:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
