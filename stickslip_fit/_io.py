"""Files written completely or not at all.

A file is written under a temporary name in its own folder and then renamed, so that a reader never sees
half of one. The writer holds a lock on its temporary file: one without a lock was left by a process that was
killed, and the next write to the folder deletes it.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
import time
import unicodedata
from collections.abc import Hashable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from stickslip_fit.errors import InputError, InputIssue

_PREFIX, _SUFFIX = ".stickslip-fit-", ".tmp"
_TEMPORARY_NAME = re.compile(rf"{re.escape(_PREFIX)}\w{{8}}{re.escape(_SUFFIX)}")
_STALE_AGE = 86_400.0  # s, where files cannot be locked
_FULL = (errno.ENOSPC, errno.EDQUOT) if hasattr(errno, "EDQUOT") else (errno.ENOSPC,)


def write_atomically(path: str | Path, content: str | bytes, sources: Iterable[str | Path] = ()) -> None:
    """Write to a temporary file, then rename it to `path`.

    A symbolic link is followed, and a device or a pipe is written to as it is. A file that is replaced hands
    on its permissions.

    Parameters
    ----------
    content : str or bytes
        Text becomes UTF-8; what UTF-8 cannot hold, such as a file name's stray bytes, is escaped.
    sources : iterable of str or Path
        Files that the content was computed from, none of which may be replaced.

    Raises
    ------
    InputError
        If `path` is one of the sources, is read-only, or cannot be written to.
    """
    raw = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    try:
        if is_stream(path):
            _write_to_stream(path, raw)
            return
        if clash := find_source(path, sources):
            raise InputError(clash)
        _replace(follow_links(path), raw)
    except (OSError, ValueError) as error:
        raise InputError(InputIssue(_describe_failure(error), str(path))) from None


def make_folder(folder: Path) -> None:
    """Make a folder in an existing one, unless it exists.

    Raises
    ------
    InputError
        If it cannot be made.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        message = f"cannot be made ({error.strerror}); name a folder in an existing one"
        raise InputError(InputIssue(message, str(folder))) from None


def find_source(path: str | Path, sources: Iterable[str | Path]) -> InputIssue | None:
    """That a file to be written is one of the sources; None if it is not."""
    if os.path.lexists(path) and identify_file(path) in map(identify_file, sources):
        return InputIssue("is a log that this was computed from; name another file", str(path))
    return None


def find_write_fault(path: str | Path) -> InputIssue | None:
    """Why a file could not be written, known before long work; None if nothing speaks against it."""
    try:
        if is_stream(path):
            return None
        target = follow_links(path)
        if target.is_dir():
            return InputIssue("is a folder; name a file", str(path))
        if target.parent.is_dir() and os.access(target.parent, os.W_OK) and _may_replace(target):
            return None
    except (OSError, ValueError) as error:
        return InputIssue(_describe_failure(error), str(path))
    return InputIssue("cannot be written; give a path in an existing folder of yours", str(path))


def identify_file(path: str | Path) -> Hashable:
    """The same for two paths to one file: by its inode, or by the path that a new file will have.

    New files whose names differ in case, or in how accents are composed, are one file on some systems.
    """
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return unicodedata.normalize("NFC", os.path.realpath(path)).casefold()
    return status.st_dev, status.st_ino


def is_stream(path: str | Path) -> bool:
    """Whether there is a device, pipe or socket, which is written to and not replaced."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def follow_links(path: str | Path) -> Path:
    """Where the symbolic links end; raises OSError if they go round in circles."""
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    return target


def _describe_failure(error: OSError | ValueError) -> str:
    reason = getattr(error, "strerror", None) or error
    full = getattr(error, "errno", None) in _FULL
    cure = "make room, or give a path elsewhere" if full else "give a path in an existing folder"
    return f"cannot be written ({reason}); {cure}"


def _may_replace(target: Path) -> bool:
    return os.access(target, os.W_OK) or not target.exists()


def _write_to_stream(path: str | Path, raw: bytes) -> None:
    # A pipe that nobody reads is an error at once, not a wait for ever.
    handle = os.open(path, os.O_WRONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0))
    with os.fdopen(handle, "wb") as stream:
        os.set_blocking(handle, True)
        stream.write(raw)


def _replace(target: Path, raw: bytes) -> None:
    if not _may_replace(target):
        raise OSError(errno.EACCES, "it is read-only")
    _delete_stale_files(target.parent)
    with _temporary_file(target.parent) as (handle, name):
        with os.fdopen(handle, "wb") as stream:
            stream.write(raw)
        os.chmod(name, _mode_of(target))
        os.replace(name, target)


def _mode_of(target: Path) -> int:
    with suppress(FileNotFoundError):
        return stat.S_IMODE(target.stat().st_mode)
    umask = os.umask(0)
    os.umask(umask)
    return 0o666 & ~umask


@contextmanager
def _temporary_file(folder: Path) -> Iterator[tuple[int, str]]:
    """A temporary file's handle, to be closed, and its name; deleted after a failure."""
    handle, lock, name = _create_locked(folder)
    try:
        yield handle, name
    except BaseException:
        with suppress(FileNotFoundError):
            os.unlink(name)
        raise
    finally:
        if lock is not None:
            os.close(lock)


def _create_locked(folder: Path) -> tuple[int, int | None, str]:
    while True:
        handle, name = tempfile.mkstemp(dir=folder, prefix=_PREFIX, suffix=_SUFFIX)
        lock = _lock(handle, wait=True)
        # Another process may have deleted it in the moment before it was locked.
        if os.path.exists(name):
            return handle, lock, name
        os.close(handle)
        if lock is not None:
            os.close(lock)


def _lock(handle: int, wait: bool) -> int | None:
    """A second handle that keeps the file locked until it is closed; None where there are no locks.

    Raises
    ------
    OSError
        If another process has locked it and `wait` is false.
    """
    try:
        import fcntl
    except ImportError:  # Windows, where a file with a second handle could not be renamed
        return None
    lock = os.dup(handle)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        # Some network folders have no locks.
        if not wait:
            os.close(lock)
            raise
    return lock


def _delete_stale_files(folder: Path) -> None:
    """Delete temporary files of processes that were killed, and of no other."""
    with suppress(OSError), os.scandir(folder) as entries:
        names = [entry.path for entry in entries if _TEMPORARY_NAME.fullmatch(entry.name)]
        for name in names:
            with suppress(OSError):
                _delete_if_stale(name)


def _delete_if_stale(name: str) -> None:
    handle = os.open(name, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
    try:
        lock = _lock(handle, wait=False)
        old = time.time() - os.fstat(handle).st_mtime > _STALE_AGE
    finally:
        os.close(handle)
    if lock is not None:
        os.unlink(name)
        os.close(lock)
    elif old:
        os.unlink(name)
