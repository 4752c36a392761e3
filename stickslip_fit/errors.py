"""InputError: input that cannot be used, with every fault that was found.

Each fault is an InputIssue: file, line, column, value, what is wrong and what to do about it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class InputIssue:
    """One fault of one input.

    Attributes
    ----------
    message : str
        What is wrong and what to do about it, one or two sentences.
    file, column, value : str, optional
        Where the fault stands and what stands there.
    line : int, optional
        Line of the file, the header being line 1; row number for Parquet.
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
            place += f"{', ' if place else ''}column {self.column}"
        if self.value is not None:
            place += f"{', ' if place else ''}value {shorten(self.value)!r}"
        return f"{place}: {self.message}" if place else self.message


class InputError(Exception):
    """Input that cannot be used; carries every problem that was found, not only the first.

    Parameters
    ----------
    problems : str, Problem or iterable of Problem
        A plain sentence is taken as a problem without a place.

    Examples
    --------
    >>> error = InputError([InputIssue("is empty; give a count", "day.csv", 3, "steps", "")])
    >>> print(error)
    day.csv, line 3, column steps, value '': is empty; give a count
    """

    def __init__(self, problems: str | InputIssue | Iterable[InputIssue]) -> None:
        if isinstance(problems, str):
            problems = [InputIssue(problems)]
        elif isinstance(problems, InputIssue):
            problems = [problems]
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


def shorten(value: str, width: int = 60) -> str:
    """Cut a value so that a binary blob in a cell does not fill the screen."""
    return value if len(value) <= width else value[: width - 3] + "..."
