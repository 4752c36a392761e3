"""One progress bar for all that takes a while: in a notebook and at a terminal alike, silent elsewhere."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm


def bar(shown: bool, **options: Any) -> tqdm:
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
