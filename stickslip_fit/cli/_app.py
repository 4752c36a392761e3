"""The command line: one verb for each question."""

from __future__ import annotations

import gc
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from functools import cache, update_wrapper
from importlib import import_module
from inspect import Parameter, Signature, signature
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer.core import TyperGroup
from typer.main import get_command

from stickslip_fit import __version__
from stickslip_fit.cli._commands import APP_SETTINGS, COMMANDS, format_example
from stickslip_fit.cli._files import check_files
from stickslip_fit.cli._streams import open_standard_streams, run_with_streams, show_warning

if TYPE_CHECKING:
    from typer._click import Command, Context, HelpFormatter

GC_THRESHOLDS = 100_000, 20, 50


class _LoadedCommands(Mapping[str, Any]):
    """Commands by name, each imported when it is asked for."""

    def __getitem__(self, name: str) -> Command:
        return _load_command(name)

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


@cache
def _load_command(name: str) -> Command:
    entry = COMMANDS[name]
    module = import_module(f"stickslip_fit.cli.{entry.module}")
    if not entry.example:
        return get_command(module.app)
    own = typer.Typer(**APP_SETTINGS)
    own.command(name, epilog=format_example(entry.example))(
        check_files(expand_groups(getattr(module, name.replace("-", "_"))))
    )
    return get_command(own)


def expand_groups[R](command: Callable[..., R]) -> Callable[..., R]:
    """The command with the fields of each group of options, a dataclass, in place of the group.

    A field has the help and the default that it has in the group.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    if not groups:
        return command
    parameters = []
    for name, parameter in signature(command).parameters.items():
        own_hints = get_type_hints(groups[name], include_extras=True) if name in groups else hints
        own = signature(groups[name]).parameters if name in groups else {name: parameter}
        parameters += [
            one.replace(annotation=own_hints[key], kind=Parameter.KEYWORD_ONLY) for key, one in own.items()
        ]

    def expanded(**given: Any) -> R:
        for name, kind in groups.items():
            given[name] = kind(**{key: given.pop(key) for key in signature(kind).parameters if key in given})
        return command(**given)

    update_wrapper(expanded, command)
    del expanded.__wrapped__  # type: ignore[attr-defined]
    expanded.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    expanded.__annotations__ = {one.name: one.annotation for one in parameters}
    return expanded


class _Commands(TyperGroup):
    """All commands; their list is shown without importing any."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = _LoadedCommands()  # type: ignore[assignment]

    def list_commands(self, ctx: Context) -> list[str]:
        return list(COMMANDS)

    def format_commands(self, ctx: Context, formatter: HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.line) for name, entry in COMMANDS.items()])


app = typer.Typer(
    cls=_Commands,
    help="Step-size laws of piezoelectric stick-slip actuators: from step counts to calibrated moves.",
    **APP_SETTINGS,
)


@app.callback()
def _main_options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=lambda wanted: _print_version(wanted), is_eager=True, help="Version."
        ),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line, and exit with its status.

    2 for bad input, with one message; 1 for output that cannot be written, 141 if its reader has gone; 130 if
    a person interrupted it.
    """
    # The matrices are many and small: threads within one product cost more than they gain.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Next to nothing refers to itself in a circle: to look for it as often as Python does takes 3 % of a
    # diagnosis.
    gc.set_threshold(*GC_THRESHOLDS)
    open_standard_streams()
    with warnings.catch_warnings():
        warnings.showwarning = show_warning
        status = run_with_streams(app)
    raise SystemExit(status)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"stickslip-fit {__version__}")
        raise typer.Exit
