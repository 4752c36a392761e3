"""What happened, written down as it happens: an append-only file that a crash cannot take a reading from."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from zlib import crc32

from stickslip_fit.errors import InputError, Problem

Event = dict[str, Any]
Take = Callable[[Event], object]
_PLACES = 8  # hexadecimal digits of a checksum
_DAMAGED = (
    "does not agree with its checksum, which no crash does to a whole line; put the file back from a copy, "
    "or cut it off before this line and go on with --resume"
)


@dataclass(frozen=True)
class Recorded:
    """A journal as it was found.

    Attributes
    ----------
    count : int
        Records.
    length : int
        Bytes that hold them.
    checksum : int
        Of the last; the next one's is worked out from it.
    lost : int
        Bytes of a last record that was never finished.
    """

    count: int
    length: int
    checksum: int
    lost: int


class Journal:
    """A journal open for writing; nobody else can write it meanwhile.

    Each line is a checksum and a JSON object that carries its number. A checksum goes over all lines so
    far, so that a line which is missing or out of place is noticed as one that is damaged.

    Parameters
    ----------
    path : Path
    handle : int
        Of the file, locked, at its end.
    recorded : Recorded
        What the file held when it was opened.
    """

    def __init__(self, path: Path, handle: int, recorded: Recorded) -> None:
        self.path = path
        self.recorded = recorded
        self._handle = handle
        self._count = recorded.count
        self._checksum = recorded.checksum

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def append(self, event: Event) -> None:
        """Hand an event to the system: it outlives this program from now on, but not yet a power cut.

        Raises
        ------
        InputError
            If it cannot be written, as on a full disk.
        """
        line, checksum = _line({"number": self._count, **event}, self._checksum)
        try:
            # A full disk takes the beginning of a line first, and refuses the rest the next time.
            while line:
                line = line[os.write(self._handle, line) :]
        except OSError as error:
            raise _unwritten(error, self.path) from None
        self._count, self._checksum = self._count + 1, checksum

    def commit(self, event: Event) -> None:
        """Write an event so that it outlives a power cut.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        self.append(event)
        try:
            os.fsync(self._handle)
        except OSError as error:
            raise _unwritten(error, self.path) from None

    def close(self) -> None:
        """Close the file, which lets go of the lock."""
        os.close(self._handle)


def create_journal(path: str | Path) -> Journal:
    """Begin a journal.

    Raises
    ------
    InputError
        If there is one already, or the file cannot be written.
    """
    path = Path(path)
    handle = _open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND)
    _lock(handle, path)
    _sync_folder(path)
    return Journal(path, handle, Recorded(0, 0, 0, 0))


def continue_journal(path: str | Path, take: Take) -> Journal:
    """Open a journal to go on where it ends; a last record that was never finished is cut off.

    Parameters
    ----------
    path : str or Path
    take : callable
        Is handed each event that the journal holds, in order.

    Raises
    ------
    InputError
        If there is none, another capture is writing it, or a whole line of it is damaged.
    """
    path = Path(path)
    handle = _open(path, os.O_RDWR | os.O_APPEND)
    try:
        _lock(handle, path)
        content = path.read_bytes()
        recorded = _parse(content, path, take)
        os.ftruncate(handle, recorded.length)
        if recorded.length and content[recorded.length - 1] != ord("\n"):
            os.write(handle, b"\n")
        os.fsync(handle)
    except OSError as error:
        os.close(handle)
        raise _unwritten(error, path) from None
    except BaseException:
        os.close(handle)
        raise
    return Journal(path, handle, recorded)


def read_journal(path: str | Path, take: Take) -> Recorded:
    """Read a journal, which may be being written.

    Parameters
    ----------
    path : str or Path
    take : callable
        Is handed each event, in order.

    Raises
    ------
    InputError
        If it cannot be read, or a whole line of it is damaged.
    """
    path = Path(path)
    try:
        return _parse(path.read_bytes(), path, take)
    except OSError as error:
        raise InputError(Problem(f"cannot be read ({error.strerror})", str(path))) from None


def _line(event: Event, before: int) -> tuple[bytes, int]:
    text = json.dumps(event, ensure_ascii=False, allow_nan=False).encode("utf-8")
    checksum = crc32(text, before)
    return b"%0*x %s\n" % (_PLACES, checksum, text), checksum


def _parse(content: bytes, path: Path, take: Take) -> Recorded:
    """Hand out whole records; what a crash leaves unfinished is a last line without its end."""
    count, checksum, length = 0, 0, 0
    *whole, rest = content.split(b"\n")
    for line in [*whole, rest] if rest else whole:
        text = line[_PLACES + 1 :]
        following = crc32(text, checksum)
        if line[: _PLACES + 1] != b"%0*x " % (_PLACES, following):
            if count == len(whole):
                break
            raise InputError(Problem(_DAMAGED, str(path), count + 1))
        take(json.loads(text))
        count, checksum, length = count + 1, following, length + len(line) + 1
    length = min(length, len(content))
    return Recorded(count, length, checksum, len(content) - length)


def _unwritten(error: OSError, path: Path) -> InputError:
    message = f"cannot be written ({error.strerror}); make room, then go on with --resume"
    return InputError(Problem(message, str(path)))


def _open(path: Path, how: int) -> int:
    try:
        return os.open(path, how, 0o666)
    except FileExistsError:
        raise InputError(
            Problem("was begun by an earlier capture; go on with --resume, or name another log", str(path))
        ) from None
    except FileNotFoundError:
        message = "is not there; leave --resume out to begin a capture, and check the folder"
        raise InputError(Problem(message, str(path))) from None
    except OSError as error:
        raise InputError(Problem(f"cannot be opened for writing ({error.strerror})", str(path))) from None


def _lock(handle: int, path: Path) -> None:
    """The system lets go of the lock when the process ends, however it ends."""
    try:
        import fcntl
    except ImportError:
        raise InputError("a capture needs file locks, which this system lacks; use Linux or macOS") from None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        message = "is being written by another capture; wait for it to end, or name another log"
        raise InputError(Problem(message, str(path))) from None


def _sync_folder(path: Path) -> None:
    """A file whose folder does not know it yet is lost with the power."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
