"""JSON as the toolkit writes it: an unknown or unbounded number is null, since JSON has no NaN."""

from __future__ import annotations

import json
from collections.abc import Iterable
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from stickslip_fit._io import write_atomically


def to_plain(content: Any) -> Any:
    """The same in plain JSON types: lists for tuples and arrays, null for numbers that are not finite.

    Examples
    --------
    >>> to_plain({"radius": float("nan"), "tip": np.array([1.0, np.inf])})
    {'radius': None, 'tip': [1.0, None]}
    """
    if isinstance(content, dict):
        return {name: to_plain(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [to_plain(value) for value in content]
    if isinstance(content, np.ndarray):
        known = content.astype(object)
        known[~np.isfinite(content)] = None
        return known.tolist()
    if isinstance(content, float):
        return float(content) if isfinite(content) else None
    return content


def to_tuples(content: Any) -> Any:
    """Tuples in place of lists, and of lists in lists."""
    return tuple(map(to_tuples, content)) if isinstance(content, list | tuple) else content


def write_json(
    path: str | Path, content: Any, sources: Iterable[str | Path] = (), indent: int | None = 1
) -> None:
    """Write plain JSON types for people to read; `sources` and errors as `write_atomically`.

    Millions of numbers, a line each, take several times as long as without an `indent`.
    """
    text = json.dumps(content, indent=indent, ensure_ascii=False, allow_nan=False)
    write_atomically(path, text + "\n", sources)
