"""Every command with its arguments and options, as the app itself has them."""

from typing import Any

from markdown import code, table, text
from typer.main import get_command

from stickslip_fit.cli import app

HELP = "help"  # an option of every command


def page() -> str:
    """One section for each command."""
    sections = commands(get_command(app))
    return "\n\n".join(_section(f"stickslip-fit {name}", command) for name, command in sections)


def commands(group: Any) -> list[tuple[str, Any]]:
    """All commands by name, subcommands by both names."""
    named = []
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            named += [(f"{name} {last}", subcommand) for last, subcommand in commands(command)]
        else:
            named.append((name, command))
    return named


def _section(title: str, command: Any) -> str:
    # Parsed as for completion: a missing argument is no fault here.
    context = command.make_context(title, [], resilient_parsing=True)
    arguments = [parameter for parameter in command.params if parameter.param_type_name == "argument"]
    options = [option for option in command.params if option not in arguments and option.name != HELP]
    usage = " ".join([title, *map(_metavar, arguments), "[OPTIONS]"])
    rows = [(code(_metavar(argument)), text(argument.get_help_record(context)[1])) for argument in arguments]
    records = filter(None, (option.get_help_record(context) for option in options))
    rows += [(code(spelling.strip()), text(meaning)) for spelling, meaning in records]
    about = "\n\n".join(" ".join(paragraph.split()) for paragraph in (command.help or "").split("\n\n"))
    listing = table(["argument or option", "meaning"], rows)
    return "\n\n".join([f"## {title}", text(about), f"```text\n{usage}\n```", listing])


def _metavar(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    repeated = f"{name}..." if argument.nargs == -1 else name
    return repeated if argument.required else f"[{repeated}]"
