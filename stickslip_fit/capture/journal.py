"""Journal: an append-only file of events with checksums, and JournalReplay, which makes a log of them.

Every record is one line, a checksum (CRC-32) and a numbered JSON object; the checksum covers all records
before it too, so that a missing or displaced line is noticed. A last line without its end is what a crash
leaves, and is cut off on resuming; any other damage is an error, and so is an event that no capture writes,
whatever its checksum.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from zlib import crc32

import pandas as pd

from stickslip_fit.capture.events import POSITION_COLUMNS, ImpossibleEventError, check_event
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.schema import CONDITIONS

Event = dict[str, Any]
EventHandler = Callable[[Event], object]
_CHECKSUM_DIGITS = 8  # hexadecimal digits of a checksum
_LOCKED_BYTE = 0x7FFF_0000  # position of the byte that is locked on Windows
_REPAIR_ADVICE = "put the file back from a copy, or cut it off before this line and go on with --resume"
_DAMAGED_MESSAGE = f"does not agree with its checksum, which no crash does to a whole line; {_REPAIR_ADVICE}"


@dataclass(frozen=True)
class JournalState:
    """The content of a journal file.

    Attributes
    ----------
    count : int
        Records.
    length : int
        Their bytes.
    checksum : int
        Of the last record.
    incomplete : int
        Bytes of a last record that was never finished.
    """

    count: int = 0
    length: int = 0
    checksum: int = 0
    incomplete: int = 0


class Journal:
    """A journal open for writing, locked against other processes; `recorded` is what the file held."""

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
        """Write an event so that it survives this program; raises InputError, e.g. on a full disk."""
        line, checksum = _format_record({"number": self._count, **event}, self._checksum)
        end = os.fstat(self._handle).st_size
        try:
            # A full disk accepts the beginning of a line and refuses the rest the next time.
            while line:
                line = line[os.write(self._handle, line) :]
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._handle, end)  # the next event may find room, and has to begin a line
            raise _make_write_error(error, self.path) from None
        self._count, self._checksum = self._count + 1, checksum

    def commit(self, event: Event) -> None:
        """Write an event so that it survives a power cut; raises as `append`."""
        self.append(event)
        try:
            os.fsync(self._handle)
        except OSError as error:
            raise _make_write_error(error, self.path) from None

    def close(self) -> None:
        """Close the file, which releases the lock."""
        os.close(self._handle)


def create_journal(path: str | Path) -> Journal:
    """Begin a journal; raises InputError if there is one already, or the file cannot be written."""
    path = Path(path)
    handle = _open_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND)
    try:
        _lock_file(handle, path)
        _sync_folder(path.parent)
    except BaseException:
        os.close(handle)
        raise
    return Journal(path, handle, JournalState())


def continue_journal(path: str | Path, apply: EventHandler) -> Journal:
    """Open a journal to continue it; an unfinished last record is cut off.

    Parameters
    ----------
    apply : callable
        Called with each event of the journal, in order.

    Raises
    ------
    InputError
        If there is none, another capture is writing it, or a whole line of it is damaged.
    """
    path = Path(path)
    handle = _open_file(path, os.O_RDWR | os.O_APPEND)
    try:
        _lock_file(handle, path)
        content = _read_content(path)
        recorded = _parse_records(content, path, apply)
        os.ftruncate(handle, recorded.length)
        if recorded.length and content[recorded.length - 1] != ord("\n"):
            os.write(handle, b"\n")
        os.fsync(handle)
    except BaseException as error:
        os.close(handle)
        if isinstance(error, OSError):
            raise _make_write_error(error, path) from None
        raise
    return Journal(path, handle, recorded)


def read_journal(path: str | Path, apply: EventHandler) -> JournalState:
    """Read a journal, which another process may be writing; raises and calls as `continue_journal`."""
    path = Path(path)
    try:
        return _parse_records(_read_content(path), path, apply)
    except OSError as error:
        message = f"cannot be read ({error.strerror}); name an existing journal"
        raise InputError(InputIssue(message, str(path))) from None


def _format_record(event: Event, before: int) -> tuple[bytes, int]:
    text = json.dumps(event, ensure_ascii=False, allow_nan=False).encode("utf-8")
    checksum = crc32(text, before)
    return b"%0*x %s\n" % (_CHECKSUM_DIGITS, checksum, text), checksum


def _parse_records(content: bytes, path: Path, apply: EventHandler) -> JournalState:
    """Call `apply` with each whole record."""
    count, checksum, length = 0, 0, 0
    *whole, rest = content.split(b"\n")
    for line in [*whole, rest] if rest else whole:
        text = line[_CHECKSUM_DIGITS + 1 :]
        following = crc32(text, checksum)
        if line[: _CHECKSUM_DIGITS + 1] != b"%0*x " % (_CHECKSUM_DIGITS, following):
            if count == len(whole) and (count or _is_cut_record(line)):
                break
            raise InputError(InputIssue(_DAMAGED_MESSAGE, str(path), count + 1))
        try:
            apply(_parse_event(text, count))
        except ImpossibleEventError as error:
            message = f"holds an event that no capture writes: {error}; {_REPAIR_ADVICE}"
            raise InputError(InputIssue(message, str(path), count + 1)) from None
        count, checksum, length = count + 1, following, length + len(line) + 1
    length = min(length, len(content))
    return JournalState(count, length, checksum, len(content) - length)


def _parse_event(text: bytes, number: int) -> Event:
    try:
        event = json.loads(text)
    except (ValueError, RecursionError):
        raise ImpossibleEventError("it is no JSON") from None
    if not isinstance(event, dict):
        raise ImpossibleEventError("it is no JSON object")
    if event.get("number") != number:
        raise ImpossibleEventError(f"its number is not {number}")
    return event


def _is_cut_record(rest: bytes) -> bool:
    """Whether a file's only line is the beginning of a journal's first record, and no other file's content.

    A power cut may leave zeros where nothing was written.
    """
    rest = rest.rstrip(b"\0")
    begin, text = b'{"number": 0,', rest[_CHECKSUM_DIGITS + 1 :]
    checksum = re.fullmatch(rb"[0-9a-f]{0,8} ?", rest[: _CHECKSUM_DIGITS + 1])
    return checksum is not None and text[: len(begin)] == begin[: len(text)]


def _read_content(path: Path) -> bytes:
    if path.exists() and not path.is_file():
        raise InputError(InputIssue("is no file; name another log", str(path)))  # a pipe would be waited for
    return path.read_bytes()


def _make_write_error(error: OSError, path: Path) -> InputError:
    message = f"cannot be written ({error.strerror}); make room, then go on with --resume"
    return InputError(InputIssue(message, str(path)))


def _open_file(path: Path, flags: int) -> int:
    try:
        return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)  # Windows would change line ends
    except FileExistsError:
        raise InputError(
            InputIssue("was begun earlier; go on with --resume, or name another file", str(path))
        ) from None
    except FileNotFoundError:
        message = "is not there; leave --resume out to begin anew, and check the folder"
        raise InputError(InputIssue(message, str(path))) from None
    except OSError as error:
        raise InputError(InputIssue(f"cannot be opened for writing ({error.strerror})", str(path))) from None


def _lock_file(handle: int, path: Path) -> None:
    """Lock a file until its handle is closed or the process ends."""
    try:
        try:
            import fcntl
        except ImportError:
            _lock_file_on_windows(handle)
        else:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        message = "is being written by another program; wait for it to end, or name another file"
        raise InputError(InputIssue(message, str(path))) from None


def _lock_file_on_windows(handle: int) -> None:
    """Lock one byte far beyond the journal's end: Windows lets nobody read a locked byte."""
    msvcrt: Any = import_module("msvcrt")
    position = os.lseek(handle, 0, os.SEEK_CUR)
    os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    finally:
        os.lseek(handle, position, os.SEEK_SET)


def _sync_folder(folder: Path) -> None:
    """Make a new file's entry in its folder survive a power cut, on systems that can open a folder."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except PermissionError:
        return  # as on Windows, which writes the entry with the file
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


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
        Number of the traverse in the plan; None for one that brought a joint into place.
    purpose : str
        Why a joint was brought into place.
    steps : int
        Commanded so far.
    status : str
        As in a log; ``interrupted`` until it has ended well.
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
        self.begin_event: Mapping[str, Any] | None = None
        self.drives: list[DriveRecord] = []
        self.skipped: set[int] = set()
        self.conditions: Mapping[str, float] = {}
        self.log_hashes: tuple[str, ...] = ()  # of the log as it was written last, and the time before
        self._driving = False  # whether the last event belongs to a drive that has not ended

    def apply(self, event: Mapping[str, Any]) -> None:
        """Apply one more event; raises ImpossibleEventError for one that cannot follow those before it."""
        check_event(event)
        if why := self._explain_bad_order(event):
            raise ImpossibleEventError(f"{event['event']} cannot stand here: {why}")
        self._driving = event["event"] in ("drive", "commanded")
        match event["event"]:
            case "begun":
                self.begin_event = event
            case "drive":
                row = {**self.conditions, **event["row"]}
                self.drives.append(DriveRecord(row, event["planned"], event["purpose"]))
            case "conditions":
                self.conditions = event["values"]
            case "writing":
                self.log_hashes = (*self.log_hashes[-1:], event["sha256"])
            case "commanded":
                self.drives[-1] = replace(self.drives[-1], steps=event["steps"])
            case "ended":
                self._end_drive(event)
            case "excluded":
                self._change(event["drive"], event["why"], status="excluded")
            case "noted":
                self._change(event["drive"], event["text"])
            case "skipped":
                self.skipped.add(event["planned"])

    @property
    def made(self) -> set[int]:
        """Traverses of the plan that have a reading."""
        return {drive.planned for drive in self.drives if drive.planned is not None and drive.status == "ok"}

    @property
    def finished(self) -> set[int]:
        """Traverses of the plan that are made or skipped."""
        return self.made | self.skipped

    @property
    def last_time(self) -> datetime | None:
        """When the latest drive began."""
        return _began(self.drives[-1].row) if self.drives else None

    def rows(self) -> pd.DataFrame:
        """The log's rows, in order of time; a drive without a step has none."""
        records = [_make_row(drive) for drive in self.drives if drive.steps > 0]
        covariates = dict.fromkeys(name for record in records for name in record if name not in LOG_COLUMNS)
        rows = pd.DataFrame(records, columns=[*LOG_COLUMNS, *covariates])
        rows["time"] = pd.to_datetime(rows["time"], utc=True)
        numbers = [*POSITION_COLUMNS, *CONDITIONS, *covariates]
        return rows.astype(dict.fromkeys(numbers, float) | {"joint": "int64", "steps": "int64"})

    def _explain_bad_order(self, event: Mapping[str, Any]) -> str:
        """Why an event cannot follow those before it; empty where it can."""
        name, last = event["event"], self.drives[-1] if self.drives else None
        if (name == "begun") == (self.begin_event is not None):
            return "the campaign has begun already" if name == "begun" else "no campaign has begun"
        if name in ("commanded", "ended") and not (self._driving and last):
            return "no joint is being driven"
        if name in ("excluded", "noted") and event["drive"] != len(self.drives) - 1:
            return "that drive is not the last one"
        if name == "excluded" and last and last.status != "ok":
            return "that drive is no reading"
        if name == "commanded" and last and event["steps"] <= last.steps:
            return f"{last.steps} steps were commanded before"
        if name == "ended" and last and event["steps"] + event["pushed"] != last.steps:
            return f"{last.steps} steps were commanded"
        if name == "drive" and last and _began(event["row"]) <= _began(last.row):
            return "the drive before it began later"
        if name in ("drive", "skipped") and event["planned"] is not None:
            finished = self.finished
            following = next(number for number in itertools.count() if number not in finished)
            if event["planned"] != following:
                return f"traverse {following} of the plan is next, not {event['planned']}"
        return ""

    def _change(self, drive: int, note: str, **changes: Any) -> None:
        before = self.drives[drive]
        self.drives[drive] = replace(before, notes=(*before.notes, note), **changes)

    def _end_drive(self, event: Mapping[str, Any]) -> None:
        drive, status = self.drives[-1], event["status"]
        if drive.planned is None and status == "ok":
            status = "excluded"  # it brought a joint into place
        notes = tuple(filter(None, (drive.purpose, event["why"])))
        self.drives[-1] = replace(drive, steps=event["steps"], status=status, notes=notes)


def _began(row: Mapping[str, Any]) -> datetime:
    return datetime.fromisoformat(row["time"])


def _make_row(drive: DriveRecord) -> dict[str, Any]:
    """A row of the log, excluded where the plan says so; a count that no stop ended is exact."""
    ended_by_stop = drive.steps % drive.row["check_every"] == 0 and drive.status != "interrupted"
    return {
        **dict.fromkeys(CONDITIONS, math.nan),
        **drive.row,
        "steps": drive.steps,
        "status": drive.row["status"] if drive.status == "ok" else drive.status,
        "check_every": drive.row["check_every"] if ended_by_stop else 1,
        "note": "; ".join(drive.notes),
    }
