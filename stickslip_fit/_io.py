"""Files written whole or not at all, and progress bars.

A file is written under a temporary name in its own folder and then renamed, so that a reader never sees
half of one. Progress bars appear at a terminal or in a notebook, and nowhere else.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stickslip_fit.errors import InputError, InputIssue

if TYPE_CHECKING:
    from tqdm import tqdm


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
            os.chmod(name, 0o666 & ~_read_umask())
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise InputError(
            InputIssue(f"cannot be written ({error.strerror}); give a path in an existing folder", str(path))
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
        raise InputError(
            InputIssue("cannot be written; give a path in an existing folder of yours", str(path))
        )


def _read_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def progress_bar(shown: bool, **options: Any) -> tqdm:
    """A tqdm that goes away when its work is done.

    Parameters
    ----------
    shown : bool
        Whether somebody asked for it. Even then only a terminal, or a notebook that has ipywidgets, shows it.
    **options
        Of `tqdm.tqdm`.
    """
    with warnings.catch_warnings():
        # That a notebook has no ipywidgets is no reason to complain on its page.
        warnings.filterwarnings("ignore", message="IProgress not found")
        from tqdm.auto import tqdm

    return tqdm(disable=None if shown else True, leave=False, **options)


ProgressCallback = Callable[[str, float], None]
"""Is told what begins now, and the share of the work that is done."""


def ignore_progress(step: str, done: float) -> None:
    """Tell nobody."""


@contextmanager
def show_progress() -> Iterator[ProgressCallback]:
    """A bar in a notebook or at a terminal: ``with shown() as told: diagnose(log, progress=told)``."""
    with progress_bar(True, total=1.0, bar_format="{desc} {percentage:3.0f}% |{bar}|") as each:

        def tell(step: str, done: float) -> None:
            each.set_description_str(step, refresh=False)
            each.n = done
            each.refresh()

        yield tell
