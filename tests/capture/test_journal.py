"""What was written down survives; what was damaged is never taken for whole."""

import os
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from stickslip_fit.capture.journal import continue_journal, create_journal, read_journal
from stickslip_fit.errors import InputError

EVENTS = [
    {"event": "drive", "row": {"note": "ψ = −30°"}},
    {"event": "commanded", "steps": 5},
    {"event": "ended"},
]


@contextmanager
def disk_of(size):
    """No file may grow beyond so many bytes, as on a full disk."""
    resource = pytest.importorskip("resource", reason="this system limits no file's size")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def written(path):
    """A journal of a few events, and the length at which each was complete."""
    ends = []
    with create_journal(path) as journal:
        for event in EVENTS * 2:
            journal.commit(event)
            ends.append(path.stat().st_size)
    return ends


def found(read, path):
    events = []
    read(path, events.append)
    return [{name: value for name, value in event.items() if name != "number"} for event in events]


def test_cut_off_at_any_byte_it_gives_every_whole_record_and_goes_on(tmp_path):
    path = tmp_path / "journal"
    ends = written(path)
    content = path.read_bytes()
    for length in range(len(content) + 1):
        path.write_bytes(content[:length])
        # A record is whole when all but the end of its line is there.
        whole = sum(end - 1 <= length for end in ends)
        assert found(read_journal, path) == (EVENTS * 2)[:whole]
        with continue_journal(path, lambda event: None) as journal:
            journal.append({"event": "more"})
        assert found(read_journal, path) == [*(EVENTS * 2)[:whole], {"event": "more"}]


def test_a_bit_flipped_anywhere_is_refused(tmp_path):
    path = tmp_path / "journal"
    written(path)
    content = path.read_bytes()
    for place in range(len(content) - 1):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="does not agree with its checksum"):
            read_journal(path, lambda event: None)


def test_a_line_taken_out_or_put_elsewhere_is_noticed(tmp_path):
    path = tmp_path / "journal"
    written(path)
    lines = path.read_bytes().splitlines(keepends=True)
    for other in (
        lines[:3] + lines[4:],
        [lines[1], lines[0], *lines[2:]],
        [*lines[:2], lines[1], *lines[2:]],
    ):
        path.write_bytes(b"".join(other))
        with pytest.raises(InputError, match="line"):
            read_journal(path, lambda event: None)


def test_two_captures_cannot_write_one_journal(tmp_path):
    path = tmp_path / "journal"
    with create_journal(path):
        with pytest.raises(InputError, match="was begun earlier"):
            create_journal(path)
        with pytest.raises(InputError, match="being written by another program"):
            continue_journal(path, lambda event: None)
    continue_journal(path, lambda event: None).close()


def test_a_full_disk_is_said_and_what_was_whole_remains(tmp_path):
    path = tmp_path / "journal"
    with create_journal(path) as journal:
        journal.commit(EVENTS[0])
        taken = 1000 // path.stat().st_size
        for _ in range(taken - 1):
            journal.commit(EVENTS[0])
        with disk_of(1000), pytest.raises(InputError, match="make room"):
            journal.commit(EVENTS[0])
        assert found(read_journal, path) == [EVENTS[0]] * taken
        assert path.stat().st_size < 1000  # without the beginning of a record
        journal.commit(EVENTS[1])
    assert found(read_journal, path) == [EVENTS[0]] * taken + [EVENTS[1]]


def test_a_journal_that_is_not_there_is_said(tmp_path):
    with pytest.raises(InputError, match="--resume"):
        continue_journal(tmp_path / "journal", lambda event: None)


@pytest.fixture
def windows(monkeypatch):
    """No fcntl, folders that cannot be opened, and msvcrt, which locks bytes from the file's position on."""
    fcntl = pytest.importorskip("fcntl", reason="this system's own lock is tested by the others")
    lock, open_file, locked = fcntl.flock, os.open, []

    def locking(handle, mode, number):
        assert mode == 2
        locked.append((os.lseek(handle, 0, os.SEEK_CUR), number))
        lock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def open_no_folder(path, flags, *mode):
        if os.path.isdir(path):
            raise PermissionError(13, "Permission denied")
        return open_file(path, flags, *mode)

    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    monkeypatch.setattr(os, "open", open_no_folder)
    return locked


def test_two_captures_cannot_write_one_journal_on_windows(windows, tmp_path):
    test_two_captures_cannot_write_one_journal(tmp_path)
    assert len(windows) == 3


def test_on_windows_the_lock_leaves_every_byte_of_the_journal_readable(windows, tmp_path):
    path = tmp_path / "journal"
    written(path)
    with continue_journal(path, lambda event: None) as journal:
        journal.append({"event": "more"})
        assert all(position > 2**30 and number == 1 for position, number in windows)
        assert found(read_journal, path) == [*(EVENTS * 2), {"event": "more"}]
