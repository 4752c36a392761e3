"""What several pages do: the same command on the same files, or analysis of the same log, is run once."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from hashlib import sha256
from inspect import signature
from pathlib import Path
from pickle import PicklingError
from typing import Any

import joblib

Run = Callable[..., tuple[int, str, str]]
Answer = tuple[int, str, str]


class Remembered:
    """What commands answered, and the files that they left."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], tuple[Answer, dict[str, bytes]]] = {}

    def run(self, run: Run, *words: str) -> Answer:
        """Run a command in the current folder, or put in place what it left there before."""
        before = _files()
        key = (words, *((word, before[word][1]) for word in words if word in before))
        if key not in self._known:
            answer = run(*words)
            left = {
                name: Path(name).read_bytes() for name, now in _files().items() if before.get(name) != now
            }
            self._known[key] = (answer, left)
        answer, left = self._known[key]
        for name, content in left.items():
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            Path(name).write_bytes(content)
        return answer


NO_DIFFERENCE = ("progress", "command")  # to the numbers


def remember[Result](function: Callable[..., Result], apart: str = "") -> Callable[..., Result]:
    """The function, which gives for equal arguments the result that it gave first.

    Not compared is the argument `apart`, which the function would make itself of the others.
    """
    known: dict[str, Result] = {}

    @wraps(function)
    def call(*arguments: Any, **options: Any) -> Result:
        given = signature(function).bind(*arguments, **options)
        given.apply_defaults()
        compared = {
            name: _plain(value)
            for name, value in given.arguments.items()
            if name not in (*NO_DIFFERENCE, apart)
        }
        try:
            key = joblib.hash(compared)
        except PicklingError:  # a page's own class
            return function(*arguments, **options)
        if key not in known:
            known[key] = function(*arguments, **options)
        return known[key]

    return call


def _plain(value: Any) -> Any:
    """An argument as others may give it: a list for a tuple, none for an empty one."""
    if not isinstance(value, list | tuple | dict):
        return value
    return None if not value else value if isinstance(value, dict) else tuple(value)


def _files() -> dict[str, tuple[int, str]]:
    """Every file below the current folder: when it was written, and its hash."""
    found = [path for path in Path().rglob("*") if path.is_file()]
    return {str(each): (each.stat().st_mtime_ns, sha256(each.read_bytes()).hexdigest()) for each in found}
