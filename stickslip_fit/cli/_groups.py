"""Options that several commands share as one parameter: a dataclass whose fields are options.

typer sees each field as a parameter of the command, with the help and the default that it has in the group.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from functools import update_wrapper
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints


def expand_groups[R](command: Callable[..., R]) -> Callable[..., R]:
    """The command with the fields of each group of options in place of the group."""
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
