"""InputError: input that cannot be used, with every issue: where, what is wrong and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class InputIssue:
    """What is wrong with an input and what to do about it, in one or two sentences, and where it is.

    `line` counts from 1, the header; for Parquet it is the row.
    """

    message: str
    file: str | None = None
    line: int | None = None
    column: str | None = None
    value: str | None = None

    def __str__(self) -> str:
        place = self.file or ""
        if self.line is not None:
            place += f"{', ' if place else ''}line {self.line}"
        if self.column is not None:
            place += f"{', ' if place else ''}column {shorten(self.column, 100)}"
        if self.value is not None:
            place += f"{', ' if place else ''}value {shorten(self.value)!r}"
        return f"{place}: {self.message}" if place else self.message


class InputError(Exception):
    """Input that cannot be used, with all its issues; a plain sentence is an issue without a place.

    Examples
    --------
    >>> error = InputError([InputIssue("is empty; give a count", "day.csv", 3, "steps", "")])
    >>> print(error)
    day.csv, line 3, column steps, value '': is empty; give a count
    """

    def __init__(self, problems: str | InputIssue | Iterable[InputIssue]) -> None:
        if isinstance(problems, str):
            problems = InputIssue(problems)
        self.problems = (problems,) if isinstance(problems, InputIssue) else tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))


def shorten(value: str, width: int = 60) -> str:
    """Cut a value so that a binary blob in a cell does not fill the screen."""
    return value if len(value) <= width else value[: width - 3] + "..."
