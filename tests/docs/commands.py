"""Lines of a shell as a page has them: run, or checked for their options where they need a rig."""

import re
import shlex
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typer.main import get_command

from stickslip_fit.cli import app

ROOT = Path(__file__).parents[2]
# Hardware, other machines, recordings: options are parsed, nothing is run.
OUT_OF_REACH = re.compile(r"--port|--cluster|.*\.wav")


@dataclass(frozen=True)
class Line:
    """One command, comment and prompt taken off; continued lines are one."""

    number: int
    text: str


def lines(text: str, first: int) -> list[Line]:
    """The commands of a block that begins at line `first`."""
    found, held, began = [], "", 0
    for number, line in enumerate(text.splitlines(), start=first):
        line = held + re.sub(r"(^|\s)#.*", "", line).strip()
        began = began if held else number
        held = line[:-1] if line.endswith("\\") else ""
        if line and not held:
            found.append(Line(began, line))
    return found


def obey(line: Line, run: Callable[..., tuple[int, str, str]]) -> str:
    """Do what a line says; what it printed.

    Raises
    ------
    AssertionError
        If it fails, or is of a kind that nobody has taught this function.
    """
    words = shlex.split(line.text)
    words[0] = words[0].removeprefix(".venv/bin/")
    if words[0] == "stickslip-fit":
        if any(map(OUT_OF_REACH.fullmatch, words)):
            parse(words[1:])
            return ""
        status, printed, complained = run(*words[1:])
        assert status == 0, f"ends with status {status}: {complained}"
        return printed
    _of_the_shell(words)
    return ""


def parse(words: list[str]) -> None:
    """Parse a command's arguments as the app does, and leave it at that."""
    command: Any = get_command(app)
    context = command.make_context("stickslip-fit", list(words))
    while hasattr(command, "commands"):
        rest = [*context._protected_args, *context.args]
        _, command, rest = command.resolve_command(context, rest)
        context = command.make_context(command.name, rest, parent=context)


def _of_the_shell(words: list[str]) -> None:
    """Commands that are not ours: each kind has its own check."""
    text = " ".join(words)
    if words[0] == "make":
        assert words[1] in make_targets(), f"Makefile has no target {words[1]}"
    elif words[:2] == ["pip", "install"]:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
        wanted = re.fullmatch(r"stickslip-fit\[(\w+)\]", words[2])
        assert wanted is not None, f"{words[2]} is not this package with an extra"
        assert wanted[1] in project["optional-dependencies"], f"pyproject.toml has no extra {wanted[1]}"
    elif words[0] == "cp" and len(words) == 3:
        shutil.copyfile(words[1], words[2])
    elif words[0] == "cat" and words[2] == ">>":
        with Path(words[3]).open("a") as longer:
            longer.write(Path(words[1]).read_text())
    else:
        assert text == "source .venv/bin/activate", f"{text}: no test knows this kind of command"


def make_targets() -> set[str]:
    """What `make` can be asked for."""
    return set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))


def all_options() -> set[str]:
    """Every option that any command has."""

    def of(command: Any) -> set[str]:
        inner = set().union(*map(of, getattr(command, "commands", {}).values()))
        return inner.union(*(each.opts for each in command.params if each.param_type_name == "option"))

    return {each for each in of(get_command(app)) if each.startswith("--")}
