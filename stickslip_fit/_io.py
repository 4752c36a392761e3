"""Files written completely or not at all, and progress bars.

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
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        message = f"cannot be written ({error.strerror}); give a path in an existing folder"
        raise InputError(InputIssue(message, str(path))) from None


def check_folder(path: str | Path) -> None:
    """Raise the InputError of `write_atomically` for a missing or read-only folder, before long work."""
    folder = Path(path).parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        message = "cannot be written; give a path in an existing folder of yours"
        raise InputError(InputIssue(message, str(path)))


def progress_bar(shown: bool, **options: Any) -> tqdm:
    """A tqdm that disappears when done, with its options; if `shown`, then at a terminal or in a notebook."""
    with warnings.catch_warnings():
        # A notebook without ipywidgets shows no warning.
        warnings.filterwarnings("ignore", message="IProgress not found")
        from tqdm.auto import tqdm

    return tqdm(disable=None if shown else True, leave=False, **options)


ProgressCallback = Callable[[str, float], None]
"""Called with the step that begins and the share of the work that is done."""


def ignore_progress(step: str, done: float) -> None:
    """Show nothing."""


@contextmanager
def show_progress() -> Iterator[ProgressCallback]:
    """A progress bar: ``with show_progress() as callback: diagnose(log, progress=callback)``."""
    with progress_bar(True, total=1.0, bar_format="{desc} {percentage:3.0f}% |{bar}|") as bar:

        def update(step: str, done: float) -> None:
            bar.set_description_str(step, refresh=False)
            bar.n = done
            bar.refresh()

        yield update
