"""Files that are read: only those on a disk, and no larger than anything that people write.

Opening a pipe waits for ever, and a device may have no end; both are refused before they are opened.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from stickslip_fit.errors import InputError, InputIssue, describe_type

_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
}


def check_path(path: object, kind: str) -> None:
    """Refuse what is no path, such as what was read from one.

    Examples
    --------
    >>> check_path(5, "plan file")
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: a path is wanted, not an int; name an existing plan file
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"a path is wanted, not {describe_type(path)}; name an existing {kind}")


def read_file(path: str | Path, kind: str, max_bytes: int) -> bytes:
    """What is in a file that `kind` names, such as "plan file".

    Files without a size, such as those of ``/proc``, are empty.

    Raises
    ------
    InputError
        If it cannot be read, is no path of a regular file, or is larger than `max_bytes`.
    """
    check_path(path, kind)
    try:
        status = os.stat(path)
        other = _KINDS.get(stat.S_IFMT(status.st_mode))
        if other:
            raise InputError(InputIssue(f"is {other}, no file; name an existing {kind}", format_path(path)))
        raw = b""
        if 0 < status.st_size <= max_bytes:
            with open(path, "rb") as stream:
                raw = stream.read(max_bytes + 1)
    except (OSError, ValueError) as error:
        message = f"cannot be read ({explain_os_error(error)}); name an existing {kind}"
        raise InputError(InputIssue(message, format_path(path))) from None
    if max(status.st_size, len(raw)) > max_bytes:
        size, most = (f"{count / 2**20:,.1f} MiB" for count in (status.st_size, max_bytes))
        message = f"has {size}, and no more than {most} are read; name another {kind}, or split it"
        raise InputError(InputIssue(message, format_path(path)))
    return raw


def explain_os_error(error: Exception) -> str:
    """Why a file cannot be read, in the system's words."""
    return getattr(error, "strerror", None) or str(error)


def format_path(path: str | Path) -> str:
    r"""A path as text that can be written anywhere: bytes that are no text become ``\xNN``."""
    try:
        raw = os.fsencode(path)
    except UnicodeEncodeError:  # half a surrogate pair, which no file name can have
        raw = str(path).encode("utf-8", "backslashreplace")
    return raw.decode("utf-8", "backslashreplace")
