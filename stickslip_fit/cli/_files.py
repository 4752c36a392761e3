"""Which files a command reads and writes; an output that would destroy another file is refused.

Each parameter that is a path is annotated with `INPUT` or an `Output`. `check_files` wraps a command: before
it does anything, its outputs are compared with its inputs and with each other, by what the paths lead to.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, wraps
from inspect import signature
from pathlib import Path
from typing import Any, get_args, get_type_hints

from stickslip_fit._io import find_write_fault, follow_links, identify_file, is_stream, write_atomically
from stickslip_fit.errors import InputError, InputIssue

LOG_SUFFIXES = (".csv", ".parquet", ".xlsx")


@dataclass(frozen=True)
class Input:
    """A file, or a folder of logs, that a command reads."""


@dataclass(frozen=True)
class Output:
    """A file that a command writes.

    Attributes
    ----------
    beside : tuple of callable
        Paths of files that are written beside it.
    permits : tuple of str
        Options, one of which has to be given where the file exists already; none if it is replaced.
    folder : bool
        A folder instead, for tables and figures.
    """

    beside: tuple[Callable[[Path], Path], ...] = ()
    permits: tuple[str, ...] = ()
    folder: bool = False

    def paths(self, path: Path) -> tuple[Path, ...]:
        """All paths that are written."""
        return (path, *(name(path) for name in self.beside)) if path.name else (path,)


INPUT = Input()


@dataclass(frozen=True)
class NamedPath:
    """A path of a command, what it is for, and the option or argument that names it."""

    path: Path
    role: Input | Output
    option: str


@cache
def path_roles(command: Callable[..., Any]) -> dict[str, Input | Output]:
    """The role of each parameter that is a path.

    Raises
    ------
    TypeError
        If a parameter is a path and has no role.
    """
    roles = {}
    for name, annotation in get_type_hints(command, include_extras=True).items():
        kind, *extras = get_args(annotation) or (annotation,)
        if "Path" not in repr(kind):
            continue
        found = [extra for extra in extras if isinstance(extra, Input | Output)]
        if len(found) != 1:
            raise TypeError(f"parameter {name} of {command.__name__} is a path: annotate INPUT or an Output")
        roles[name] = found[0]
    return roles


def check_files[R](command: Callable[..., R]) -> Callable[..., R]:
    """A command that first refuses outputs that would destroy another file; it then raises InputError."""

    @wraps(command)
    def checked(*args: Any, **kwargs: Any) -> R:
        arguments = signature(command).bind(*args, **kwargs).arguments
        named = [
            NamedPath(path, role, f"--{name.replace('_', '-')}")
            for name, role in path_roles(command).items()
            for path in _to_paths(arguments.get(name))
        ]
        if issues := list(dict.fromkeys(_find_issues(named, arguments))):
            raise InputError(issues)
        return command(*args, **kwargs)

    return checked


def _to_paths(value: Any) -> list[Path]:
    if value is None:
        return []
    return [Path(each) for each in value] if isinstance(value, list | tuple) else [Path(value)]


def _find_issues(named: list[NamedPath], arguments: Mapping[str, Any]) -> Iterator[InputIssue]:
    outputs = [(each, each.role) for each in named if isinstance(each.role, Output)]
    if not outputs:
        return
    inputs = [each.path for each in named if isinstance(each.role, Input)]
    folders = [path for path in inputs if path.is_dir()]
    read = {identify_file(path): path for folder in folders for path in list_log_files(folder)}
    read |= {identify_file(path): path for path in inputs}
    written = _printed_files()
    for output, role in outputs:
        if role.folder:
            yield from _find_folder_issues(output, folders)
            continue
        for path in role.paths(output.path):
            if fault := find_write_fault(path):
                yield fault
            elif not is_stream(path):
                yield from _find_clashes(path, output.option, read, written)
                yield from _find_stray_log(path, folders)
                if role.permits and path.exists() and not any(map(arguments.get, role.permits)):
                    options = " or ".join(f"--{name}" for name in role.permits)
                    yield InputIssue(f"exists already; name another file, or give {options}", str(path))


def _printed_files() -> dict[Hashable, str]:
    """Files that standard output and standard error go to."""
    files: dict[Hashable, str] = {}
    for handle, name in ((1, "standard output"), (2, "standard error")):
        with suppress(OSError):
            status = os.fstat(handle)
            files[status.st_dev, status.st_ino] = name
    return files


def _find_clashes(
    path: Path, option: str, read: Mapping[Hashable, Path], written: dict[Hashable, str]
) -> Iterator[InputIssue]:
    identity = identify_file(path)
    if identity in read:
        message = f"{option} would overwrite what the command reads as {read[identity]}; name another file"
        yield InputIssue(message, str(path))
    elif identity in written:
        if written[identity] == option:
            message = f"is the name of a second file that {option} also writes; give another ending"
        else:
            message = f"would be written twice, by {written[identity]} and {option}; give two files"
        yield InputIssue(message, str(path))
    written[identity] = option


def _find_stray_log(path: Path, folders: list[Path]) -> Iterator[InputIssue]:
    """A table in a folder of logs would be read as a log the next time."""
    if path.suffix.lower() in LOG_SUFFIXES:
        for folder in folders:
            if follow_links(path).is_relative_to(folder.resolve()):
                message = f"would become one of the logs in {folder}; name a file elsewhere"
                yield InputIssue(message, str(path))


def _find_folder_issues(output: NamedPath, folders: list[Path]) -> Iterator[InputIssue]:
    path = output.path
    if path.exists() and not path.is_dir():
        yield InputIssue(f"is a file; name a folder with {output.option}", str(path))
    elif not path.exists() and (fault := find_write_fault(path)):
        yield fault
    for folder in folders:
        if path.resolve().is_relative_to(folder.resolve()):
            yield InputIssue(
                f"is in {folder}, where the command reads all logs; name a folder elsewhere", str(path)
            )


def list_log_files(folder: Path) -> Iterator[Path]:
    """The files in a folder of logs that could be read as logs; symbolic links are followed once."""
    visited = set()
    for here, below, names in os.walk(folder, followlinks=True):
        visited.add(identify_file(here))
        below[:] = [name for name in below if identify_file(Path(here, name)) not in visited]
        yield from (Path(here, name) for name in names if name.lower().endswith(LOG_SUFFIXES))


def read_template(name: str) -> str:
    """The text of a file that comes with the package, to be changed."""
    from importlib.resources import files

    return files("stickslip_fit").joinpath("templates", name).read_text("utf-8")


def write_template(name: str, output: Path | None, kind: str) -> None:
    """Write such a file, or print it."""
    if output is None:
        print(read_template(name), end="")
    else:
        write_atomically(output, read_template(name))
        print(f"{kind} written to {output}")
