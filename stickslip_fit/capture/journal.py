"""Journal: an append-only file of events with checksums, and JournalReplay, which makes a log of them.

Every record is one line, a checksum and JSON; the checksum covers all records before it too. A last
line without its end is what a crash leaves, and is cut off on resuming; any other damage is an error.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from zlib import crc32

import pandas as pd

from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.schema import CONDITIONS

Event = dict[str, Any]
EventHandler = Callable[[Event], object]
_CHECKSUM_DIGITS = 8  # hexadecimal digits of a checksum
_DAMAGED_MESSAGE = (
    "does not agree with its checksum, which no crash does to a whole line; put the file back from a copy, "
    "or cut it off before this line and go on with --resume"
)


@dataclass(frozen=True)
class JournalState:
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

    def __init__(self, path: Path, handle: int, recorded: JournalState) -> None:
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
        line, checksum = _format_record({"number": self._count, **event}, self._checksum)
        try:
            # A full disk takes the beginning of a line first, and refuses the rest the next time.
            while line:
                line = line[os.write(self._handle, line) :]
        except OSError as error:
            raise _make_write_error(error, self.path) from None
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
            raise _make_write_error(error, self.path) from None

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
    handle = _open_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND)
    _lock_file(handle, path)
    _sync_folder(path)
    return Journal(path, handle, JournalState(0, 0, 0, 0))


def continue_journal(path: str | Path, take: EventHandler) -> Journal:
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
    handle = _open_file(path, os.O_RDWR | os.O_APPEND)
    try:
        _lock_file(handle, path)
        content = path.read_bytes()
        recorded = _parse_records(content, path, take)
        os.ftruncate(handle, recorded.length)
        if recorded.length and content[recorded.length - 1] != ord("\n"):
            os.write(handle, b"\n")
        os.fsync(handle)
    except OSError as error:
        os.close(handle)
        raise _make_write_error(error, path) from None
    except BaseException:
        os.close(handle)
        raise
    return Journal(path, handle, recorded)


def read_journal(path: str | Path, take: EventHandler) -> JournalState:
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
        return _parse_records(path.read_bytes(), path, take)
    except OSError as error:
        raise InputError(InputIssue(f"cannot be read ({error.strerror})", str(path))) from None


def _format_record(event: Event, before: int) -> tuple[bytes, int]:
    text = json.dumps(event, ensure_ascii=False, allow_nan=False).encode("utf-8")
    checksum = crc32(text, before)
    return b"%0*x %s\n" % (_CHECKSUM_DIGITS, checksum, text), checksum


def _parse_records(content: bytes, path: Path, take: EventHandler) -> JournalState:
    """Hand out whole records; what a crash leaves unfinished is a last line without its end."""
    count, checksum, length = 0, 0, 0
    *whole, rest = content.split(b"\n")
    for line in [*whole, rest] if rest else whole:
        text = line[_CHECKSUM_DIGITS + 1 :]
        following = crc32(text, checksum)
        if line[: _CHECKSUM_DIGITS + 1] != b"%0*x " % (_CHECKSUM_DIGITS, following):
            if count == len(whole):
                break
            raise InputError(InputIssue(_DAMAGED_MESSAGE, str(path), count + 1))
        take(json.loads(text))
        count, checksum, length = count + 1, following, length + len(line) + 1
    length = min(length, len(content))
    return JournalState(count, length, checksum, len(content) - length)


def _make_write_error(error: OSError, path: Path) -> InputError:
    message = f"cannot be written ({error.strerror}); make room, then go on with --resume"
    return InputError(InputIssue(message, str(path)))


def _open_file(path: Path, how: int) -> int:
    try:
        return os.open(path, how, 0o666)
    except FileExistsError:
        raise InputError(
            InputIssue("was begun by an earlier capture; go on with --resume, or name another log", str(path))
        ) from None
    except FileNotFoundError:
        message = "is not there; leave --resume out to begin a capture, and check the folder"
        raise InputError(InputIssue(message, str(path))) from None
    except OSError as error:
        raise InputError(InputIssue(f"cannot be opened for writing ({error.strerror})", str(path))) from None


def _lock_file(handle: int, path: Path) -> None:
    """The system lets go of the lock when the process ends, however it ends."""
    try:
        import fcntl
    except ImportError:
        raise InputError("a capture needs file locks, which this system lacks; use Linux or macOS") from None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        message = "is being written by another capture; wait for it to end, or name another log"
        raise InputError(InputIssue(message, str(path))) from None


def _sync_folder(path: Path) -> None:
    """A file whose folder does not know it yet is lost with the power."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


POSITION_COLUMNS = ("q1", "q2", "q3", "theta", "psi", "start", "stop")
LOG_COLUMNS = (
    *("session", "time", "joint", "direction", "steps", *POSITION_COLUMNS, "check_every", "status"),
    *(*CONDITIONS, "note"),
)
INTERRUPTED_NOTE = "the capture ended in mid-traverse"


@dataclass(frozen=True)
class DriveRecord:
    """One drive: a traverse of the plan, or one that brought a joint into place.

    Attributes
    ----------
    row : dict
        session, time, joint, direction, positions (SI, None for the moving joint's own), check_every, and the
        conditions under which it began.
    planned : int or None
        Which traverse of the plan; None for one that only brought a joint into place.
    purpose : str
        What that was for.
    steps : int
        Commanded so far.
    status : str
        As in a log; ``interrupted`` until it has ended well.
    notes : tuple of str
    """

    row: Mapping[str, Any]
    planned: int | None
    purpose: str = ""
    steps: int = 0
    status: str = "interrupted"
    notes: tuple[str, ...] = (INTERRUPTED_NOTE,)


class JournalReplay:
    """The drives of a journal, kept up to date event by event."""

    def __init__(self) -> None:
        self.begun: Mapping[str, Any] | None = None
        self.drives: list[DriveRecord] = []
        self.skipped: set[int] = set()
        self.conditions: Mapping[str, float] = {}
        self.written: tuple[str, ...] = ()  # hashes of the log as it was written last, and before that

    def take(self, event: Mapping[str, Any]) -> None:
        """Enter one more event."""
        match event["event"]:
            case "begun":
                self.begun = event
            case "drive":
                row = {**self.conditions, **event["row"]}
                self.drives.append(DriveRecord(row, event["planned"], event["purpose"]))
            case "conditions":
                self.conditions = event["values"]
            case "writing":
                self.written = (*self.written[-1:], event["sha256"])
            case "commanded":
                self.drives[-1] = replace(self.drives[-1], steps=event["steps"])
            case "ended":
                self.drives[-1] = _end_drive(self.drives[-1], event)
            case "excluded":
                self._change(event["drive"], event["why"], status="excluded")
            case "noted":
                self._change(event["drive"], event["text"])
            case "skipped":
                self.skipped.add(event["planned"])

    @property
    def finished(self) -> set[int]:
        """Traverses of the plan that need not be made any more."""
        made = {each.planned for each in self.drives if each.planned is not None and each.status == "ok"}
        return made | self.skipped

    @property
    def last_time(self) -> datetime | None:
        """When the latest drive began."""
        return datetime.fromisoformat(self.drives[-1].row["time"]) if self.drives else None

    def rows(self) -> pd.DataFrame:
        """The log's rows, in order of time; a drive that never made a step is none."""
        records = [_make_row(each) for each in self.drives if each.steps > 0]
        own = dict.fromkeys(name for each in records for name in each if name not in LOG_COLUMNS)
        rows = pd.DataFrame(records, columns=[*LOG_COLUMNS, *own])
        rows["time"] = pd.to_datetime(rows["time"], utc=True)
        numbers = [*POSITION_COLUMNS, *CONDITIONS, *own]
        return rows.astype(dict.fromkeys(numbers, float) | {"joint": "int64", "steps": "int64"})

    def _change(self, drive: int, note: str, **changes: Any) -> None:
        before = self.drives[drive]
        self.drives[drive] = replace(before, notes=(*before.notes, note), **changes)


def _end_drive(drive: DriveRecord, event: Mapping[str, Any]) -> DriveRecord:
    notes = tuple(filter(None, (drive.purpose, event["why"])))
    brings = drive.planned is None and event["status"] == "ok"
    return replace(drive, steps=event["steps"], status="excluded" if brings else event["status"], notes=notes)


def _make_row(drive: DriveRecord) -> dict[str, Any]:
    """A row of the log; a drive that wasn't ended by its stop is known to the step."""
    heard = drive.steps % drive.row["check_every"] == 0 and drive.status != "interrupted"
    said = {name: drive.row.get(name, math.nan) for name in CONDITIONS}
    found = {
        "steps": drive.steps,
        "status": drive.status,
        "check_every": drive.row["check_every"] if heard else 1,
        "note": "; ".join(drive.notes),
    }
    return {**said, **drive.row, **found}
