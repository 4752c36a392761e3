"""Files that are whole or not there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from stickslip_fit.errors import InputError, Problem


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write to a temporary file beside `path`, then rename it into place.

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written to.
    """
    path = Path(path)
    raw = content.encode("utf-8") if isinstance(content, str) else content
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(raw)
            os.chmod(name, 0o666 & ~_umask())
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise InputError(
            Problem(f"cannot be written ({error.strerror}); give a path in an existing folder", str(path))
        ) from None


def check_folder(path: str | Path) -> None:
    """Refuse a path whose folder is not there, before the work that would fill the file.

    Raises
    ------
    InputError
        As `write_atomically` would.
    """
    folder = Path(path).parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(Problem("cannot be written; give a path in an existing folder of yours", str(path)))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
