"""InputError: input that cannot be used, with every issue: where, what is wrong and what to do about it.

False-alarm rates, counts, seeds and types that callers give are checked here, in one way everywhere.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from numbers import Integral, Real


@dataclass(frozen=True)
class InputIssue:
    """What is wrong with an input and what to do about it, in one or two sentences, and where it is.

    `line` counts from 1, the header; for Parquet it is the row. `place` is shown instead where the file's own
    program numbers otherwise, as ``sheet 'Log', cell E7``. `column` may be a command's option. `argument` is
    one of a function, which is an option of the same name at the shell.
    """

    message: str
    file: str | None = None
    line: int | None = None
    column: str | None = None
    value: str | None = None
    place: str | None = None
    argument: str | None = None

    @property
    def at_shell(self) -> InputIssue:
        """The same as a command has it: an argument is an option.

        Examples
        --------
        >>> issue = InputIssue("is no date", value="spring", argument="since")
        >>> print(issue, issue.at_shell, sep="; ")
        since, value 'spring': is no date; --since, value 'spring': is no date
        """
        if self.argument is None:
            return self
        return replace(self, column=f"--{self.argument.replace('_', '-')}", argument=None)

    def __str__(self) -> str:
        place = self.file or ""
        if self.place is not None or self.line is not None:
            place += f"{', ' if place else ''}{self.place or f'line {self.line}'}"
        if self.argument is not None:
            place += f"{', ' if place else ''}{self.argument}"
        if self.column is not None:
            kind = "" if self.column.startswith("--") else "column "
            place += f"{', ' if place else ''}{kind}{shorten(self.column, 100)}"
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

    @property
    def at_shell(self) -> str:
        """All issues as a command tells them, see `InputIssue.at_shell`."""
        return "\n".join(str(issue.at_shell) for issue in self.problems)


def shorten(value: str, width: int = 60) -> str:
    """Cut a value so that a binary blob in a cell does not fill the screen."""
    return value if len(value) <= width else value[: width - 3] + "..."


def suggest(name: str, known: Iterable[str]) -> str:
    """What was perhaps meant, as the end of a message; empty where nothing is similar.

    Examples
    --------
    >>> suggest("thermal-warmup", ["drift", "thermal-warm-up"])
    '; did you mean thermal-warm-up?'
    """
    similar = get_close_matches(shorten(name), list(known), 1)
    return f"; did you mean {similar[0]}?" if similar else ""


def describe_type(value: object) -> str:
    """The name of a value's type with its article.

    Examples
    --------
    >>> describe_type(5), describe_type("day.csv")
    ('an int', 'a str')
    """
    name = type(value).__name__
    return f"{'an' if name[0] in 'aeiou' else 'a'} {name}"


# What reads a type from a file, and what makes one where that is another call.
_READERS = {
    "DataFrame": "read_drives({}, law)",
    "LawValues": "read_law_values({}, machine)",
    "Log": "read_log({})",
    "Machine": "load_machine({})",
    "Plan": "read_plan({}, machine)",
    "Posterior": "load_posterior({})",
    "Result": "load_result({})",
}
_MAKERS = {"Diagnosis": "diagnose(log)", "Posterior": "fit(log, 'bayes')", "Result": "fit(log)"}


def check_type(argument: str, value: object, *kinds: type) -> None:
    """Refuse what is of none of these types, such as a file's name or a log in place of a plan.

    Examples
    --------
    >>> from stickslip_fit.logs import Log
    >>> check_type("log", "my-log.csv", Log)
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: log: a Log is wanted, not a str; read it with ssf.read_log('my-log.csv')
    """
    if isinstance(value, kinds):
        return
    names, given = [kind.__name__ for kind in kinds], describe_type(value)
    readers = {name: _READERS[name] for name in names if name in _READERS}
    if isinstance(value, str | os.PathLike) and readers:
        how, calls, path = "read it", readers, repr(os.fspath(value))
    else:
        made = {name: _MAKERS[name] for name in names if name in _MAKERS}
        how, calls, path = "get one", readers | made, "path"
    advice = f"{how} with " + " or ".join(f"ssf.{call.format(path)}" for call in calls.values())
    if given == "a DataFrame" and "Log" in names:
        advice += ", or test a table with ssf.diagnose_table(table, law)"
    message = f"a {' or '.join(names)} is wanted, not {given}; {advice}"
    raise InputError(InputIssue(message, argument=argument))


# Of a false-alarm rate: the bootstrap has samples in inverse proportion to it.
ALPHA_LIMITS = (0.001, 0.2)


def check_alpha(value: float) -> None:
    """Check a false-alarm rate.

    Examples
    --------
    >>> check_alpha(1e-9)
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: alpha must lie between 0.001 and 0.2, not 1e-09
    """
    low, high = ALPHA_LIMITS
    if not isinstance(value, Real) or isinstance(value, bool) or not low <= value <= high:
        raise InputError(f"alpha must lie between {low} and {high}, not {value!r}")


def check_count(name: str, value: int, least: int = 1) -> None:
    """Check a whole number; a seed is at `least` 0.

    Examples
    --------
    >>> check_count("seed", -1, least=0)
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: seed must be a whole number of at least 0, not -1
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise InputError(f"{name} must be a whole number of at least {least}, not {value!r}")


def check_workers(value: int) -> None:
    """Check a number of processes: -1 for as many as there are cores, or at least 1."""
    if not isinstance(value, Integral) or isinstance(value, bool) or (value < 1 and value != -1):
        raise InputError(f"workers must be -1 (as many as there are cores) or at least 1, not {value!r}")
