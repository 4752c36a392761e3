"""Every verb of the command line with its arguments and options, as the app itself has them."""

from __future__ import annotations

from typing import Any

from markdown import code, table, text
from typer.main import get_command

from stickslip_fit.cli import app

SAME_EVERYWHERE = "help"


def page() -> str:
    """One section for each verb."""
    return "\n\n".join(_section(f"stickslip-fit {name}", verb) for name, verb in verbs(get_command(app)))


def verbs(group: Any) -> list[tuple[str, Any]]:
    """All verbs by the words that call them; those of a verb that has verbs of its own included."""
    found = []
    for name, command in group.commands.items():
        inner = verbs(command) if hasattr(command, "commands") else None
        found += [(name, command)] if inner is None else [(f"{name} {last}", each) for last, each in inner]
    return found


def _section(title: str, verb: Any) -> str:
    # Parsed as for completion: an argument that is lacking is no fault here.
    context = verb.make_context(title, [], resilient_parsing=True)
    arguments = [each for each in verb.params if each.param_type_name == "argument"]
    options = [each for each in verb.params if each not in arguments and each.name != SAME_EVERYWHERE]
    usage = " ".join([title, *map(_metavar, arguments), "[OPTIONS]"])
    rows = [(code(_metavar(each)), text(each.get_help_record(context)[1])) for each in arguments]
    rows += [(code(spelling.strip()), text(said)) for spelling, said in _records(options, context)]
    said = "\n\n".join(" ".join(part.split()) for part in (verb.help or "").split("\n\n"))
    listed = table(["argument or option", "meaning"], rows)
    return "\n\n".join([f"## {title}", text(said), f"```text\n{usage}\n```", listed])


def _metavar(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    several = f"{name}..." if argument.nargs == -1 else name
    return several if argument.required else f"[{several}]"


def _records(options: list[Any], context: Any) -> list[tuple[str, str]]:
    return [record for each in options if (record := each.get_help_record(context))]
