"""No command writes over what it reads, nor writes two things to one file: asked of every command."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from inspect import Parameter, signature, unwrap
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import pytest
import typer
from typer.main import get_command

from stickslip_fit.cli import app
from stickslip_fit.cli._files import INPUT, Input, Output, check_files, path_roles
from stickslip_fit.errors import InputError

# A new output has its name added here; anything else that is a path is read.
OUTPUT_NAMES = {"output", "json", "chart", "report", "save_law", "numbers", "tree", "chains", "csv", "latex"}
OUTPUT_NAMES |= {"true_steps", "journal", "homing_log"}


@dataclass(frozen=True)
class Command:
    """A command of the app, by the words that call it."""

    name: str
    run: Any

    @property
    def roles(self) -> dict[str, Input | Output]:
        return path_roles(unwrap(self.run))

    def named(self, kind: type, folder: bool = False) -> list[str]:
        return [
            name
            for name, role in self.roles.items()
            if isinstance(role, kind) and getattr(role, "folder", False) is folder
        ]

    def call(self, folder: Path, **paths: Path) -> None:
        """With these paths and new ones where another is required, as typer calls it."""
        arguments = {}
        for name, parameter in signature(self.run).parameters.items():
            if name in paths or parameter.default is Parameter.empty:
                path = paths.get(name, folder / f"unnamed-{name}")
                several = "list" in str(get_type_hints(self.run)[name])
                arguments[name] = [path] if several else path
        self.run(**arguments)


def commands(group: Any, prefix: str = "") -> Iterator[Command]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{name} ")
        else:
            yield Command(f"{prefix}{name}", command.callback.__wrapped__)


COMMANDS = list(commands(get_command(app)))
WRITERS = [command for command in COMMANDS if command.named(Output)]
CLASHES = [
    pytest.param(command, read, written, id=f"{command.name}-{read}-{written}")
    for command in COMMANDS
    for written in command.named(Output)
    for read in command.named(Input)
]
DOUBLES = [
    pytest.param(command, *pair, id=f"{command.name}-{'-'.join(pair)}")
    for command in COMMANDS
    for pair in combinations(command.named(Output), 2)
]
FOLDERS = [
    pytest.param(command, read, written, id=f"{command.name}-{read}-{written}")
    for command in COMMANDS
    for written in command.named(Output, folder=True)
    for read in command.named(Input)
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_every_path_of_a_command_is_an_input_or_an_output(command):
    hints = get_type_hints(unwrap(command.run))
    assert set(command.roles) == {name for name, kind in hints.items() if "Path" in str(kind)}
    outputs = {name for name, role in command.roles.items() if isinstance(role, Output)}
    assert outputs == OUTPUT_NAMES & set(command.roles)
    permits = [name for role in command.roles.values() for name in getattr(role, "permits", ())]
    assert set(permits) <= set(hints)


def test_a_path_without_a_role_is_a_fault_of_the_command():
    @check_files
    def careless(path: Annotated[Path | None, typer.Option()] = None) -> None: ...

    with pytest.raises(TypeError, match="path of careless is a path"):
        careless(path=Path("x"))


def test_there_are_commands_to_ask():
    assert len(COMMANDS) >= 18
    assert len(CLASHES) >= 30


def aliases(path: Path) -> Iterator[Path]:
    yield path
    yield path.parent / "." / ".." / path.parent.name / path.name
    for make, name in ((os.symlink, "symbolic"), (os.link, "hard")):
        alias = path.with_name(f"{name}-{path.name}")
        make(path, alias)
        yield alias
    linked = path.parent / "linked"
    linked.symlink_to(path.parent, target_is_directory=True)
    yield linked / path.name


@pytest.mark.parametrize(("command", "read", "written"), CLASHES)
def test_an_output_that_is_an_input_is_refused(command, read, written, tmp_path):
    mine = tmp_path / "mine.csv"
    mine.write_text("what a lab measured")
    for alias in aliases(mine):
        with pytest.raises(InputError, match=f"--{written.replace('_', '-')} would overwrite .*mine.csv"):
            command.call(tmp_path, **{read: mine, written: alias})
        with pytest.raises(InputError, match="would overwrite"):
            command.call(tmp_path, **{read: alias, written: mine})
    assert mine.read_text() == "what a lab measured"


@pytest.mark.parametrize(("command", "one", "other"), DOUBLES)
def test_two_outputs_that_are_one_file_are_refused(command, one, other, tmp_path):
    for first, second in (("both.csv", "both.csv"), ("both.csv", "Both.csv"), ("x/../both.csv", "both.csv")):
        with pytest.raises(InputError, match="would be written twice"):
            command.call(tmp_path, **{one: tmp_path / first, other: tmp_path / second})


@pytest.mark.parametrize(("command", "read", "written"), FOLDERS)
def test_tables_are_not_written_among_logs(command, read, written, tmp_path):
    with pytest.raises(InputError, match=r"is in .* where the command reads all logs"):
        command.call(tmp_path, **{read: tmp_path, written: tmp_path / "new"})


@pytest.mark.parametrize(("command", "read", "written"), CLASHES)
def test_a_folder_that_is_read_is_kept_as_it_is(command, read, written, tmp_path):
    folder = tmp_path / "logs"
    mine = folder / "below" / "mine.csv"
    mine.parent.mkdir(parents=True)
    mine.write_text("what a lab measured")
    (folder / "round").symlink_to(folder, target_is_directory=True)
    with pytest.raises(InputError, match="would overwrite"):
        command.call(tmp_path, **{read: folder, written: mine})
    with pytest.raises(InputError, match="would become one of the logs"):
        command.call(tmp_path, **{read: folder, written: folder / "new.csv"})
    assert mine.read_text() == "what a lab measured"


@pytest.mark.parametrize("command", WRITERS, ids=lambda command: command.name)
def test_what_is_written_beside_an_output_counts_too_and_needs_force(command, tmp_path):
    for written in command.named(Output):
        role = command.roles[written]
        paths = role.paths(tmp_path / "new.csv")
        for path in paths:
            path.write_text("earlier work")
            if role.permits:
                with pytest.raises(InputError, match=f"{path.name}: exists already; .* --force"):
                    command.call(tmp_path, **{written: paths[0]})
            for read in command.named(Input):
                with pytest.raises(InputError, match="would overwrite"):
                    command.call(tmp_path, **{read: path, written: paths[0]})
            assert path.read_text() == "earlier work"
            path.unlink()


def test_simulate_sheet_and_tune_replace_nothing_unasked():
    asked = {
        command.name
        for command in COMMANDS
        for role in command.roles.values()
        if getattr(role, "permits", ())
    }
    assert asked >= {"simulate", "sheet", "capture tune"}


def test_force_replaces_what_exists_but_never_an_input(tmp_path):
    written = []

    @check_files
    def write(
        source: Annotated[Path, typer.Argument(), INPUT],
        output: Annotated[Path, typer.Option(), Output(permits=("force",))],
        force: bool = False,
    ) -> None:
        written.append(output)

    source, output = tmp_path / "source", tmp_path / "output"
    source.write_text("")
    output.write_text("")
    with pytest.raises(InputError, match="exists already"):
        write(source, output)
    write(source, output, force=True)
    assert written == [output]
    with pytest.raises(InputError, match="would overwrite"):
        write(source, source, force=True)


def test_all_faults_of_all_outputs_come_at_once(refused, campaign, tmp_path):
    campaign(("2012-03-05",)).to_csv(tmp_path / "log.csv", index=False)
    log = tmp_path / "log.csv"
    err = refused("diagnose", log, "--json", log, "--report", tmp_path, "--save-law", "no/law.json")
    assert [line.split(": ")[1][:20] for line in err.splitlines()] == [
        "--json would overwri",
        "is a folder; name a ",
        "cannot be written; g",
    ]
