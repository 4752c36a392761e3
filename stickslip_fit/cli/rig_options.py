"""Options that say which rig, shared by what drives one and what listens to one."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated

import typer

from stickslip_fit.errors import InputError


class Dialect(StrEnum):
    """What the controller speaks."""

    new = "new"
    old = "old"
    anc300 = "anc300"


Port = Annotated[str | None, typer.Option(help="Serial port of the controller; VISA resource of an ANC300.")]
DialectOption = Annotated[Dialect, typer.Option(help="What the controller speaks.")]
Device = Annotated[str | None, typer.Option(help="Microphone: its name, a part of it, or its number.")]
Ratio = Annotated[float, typer.Option(help="Emulated: how loud the stop is, dB over the room.")]


def refuse(options: Mapping[str, object], where: str) -> None:
    """Refuse options that mean nothing where they are given.

    Raises
    ------
    InputError
    """
    for option, value in options.items():
        if value:
            raise InputError(f"{option} means nothing {where}; leave it out")


def given[Value](value: Value | None, option: str) -> Value:
    """Ask for an option that is needed.

    Raises
    ------
    InputError
    """
    if value is None:
        raise InputError(f"give {option}")
    return value
