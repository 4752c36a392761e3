"""The commands that compare: an actuator with its past (changed), the published with the physical laws."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit._progress import show_progress
from stickslip_fit.cli._files import INPUT
from stickslip_fit.cli._options import (
    Alpha,
    Json,
    LawNames,
    LogPath,
    MachinePath,
    Sheet,
    check_savable,
    command_line,
    load_laws,
    load_log,
    parse_path,
)
from stickslip_fit.cli._show import Display, save_json, show
from stickslip_fit.errors import InputError


def changed(
    *,
    old: Annotated[
        Path,
        typer.Argument(
            metavar="OLD", parser=parse_path, help="Log of the past, or with --since of all time."
        ),
        INPUT,
    ],
    new: Annotated[
        Path | None, typer.Argument(metavar="[NEW]", parser=parse_path, help="Log of the present."), INPUT
    ] = None,
    since: Annotated[
        str | None,
        typer.Option(help="Instead of NEW: sessions of OLD from this date on against those before it."),
    ] = None,
    alpha: Alpha = 0.01,
    law: LawNames = None,
    machine: MachinePath = None,
    sheet: Sheet = None,
    json: Json = None,
    display: Display,
) -> None:
    """Test whether an actuator has changed from one log to another, beyond its scatter from day to day."""
    from stickslip_fit.changes import detect_changes

    if (new is None) == (since is None):
        raise InputError("name what to compare with: a second log, or the date of the change with --since")
    after = load_log([new or old], machine, since=since, sheet=sheet)  # first, to name --since in a fault
    before = load_log([old], machine, until=since, sheet=sheet)
    laws = load_laws(law, before.joints)
    check_savable(before, laws, json)
    changes = detect_changes(before, after, laws=laws, alpha=alpha, command=command_line())
    show(changes.summary(), display, [old, new or old], save_json(changes.save, json))


def compare_laws(
    *, log: LogPath, machine: MachinePath = None, sheet: Sheet = None, json: Json = None, display: Display
) -> None:
    """Compare the published laws with the physical ones: held-out errors, regime, and what would tell."""
    from stickslip_fit import law_comparison

    campaign = load_log(log, machine, sheet=sheet)
    with show_progress() as progress:
        comparison = law_comparison.compare_laws(campaign, command=command_line(), progress=progress)
    show(comparison.summary(), display, log, save_json(comparison.save, json))
