"""drive: the tip by hand, at a real or an emulated rig."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit.cli._files import INPUT, Output
from stickslip_fit.cli._options import (
    ArmSource,
    Device,
    Dialect,
    DialectOption,
    Port,
    parse_positions,
    reject_options,
    require_option,
)
from stickslip_fit.errors import InputError


class InputKind(StrEnum):
    """What a person drives by."""

    keyboard = "keyboard"
    gamepad = "gamepad"
    spacemouse = "spacemouse"


def drive(
    *,
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="Q1,Q2,Q3", help="Where the joints stand: deg,deg,mm; best at stops."),
    ] = None,
    script: Annotated[
        Path | None,
        typer.Option(help="CSV of velocities: time_s,vx_um_s,vy_um_s,vz_um_s; else a person drives."),
        INPUT,
    ] = None,
    by: Annotated[InputKind, typer.Option("--by", help="What a person drives by.")] = InputKind.keyboard,
    page: Annotated[
        bool,
        typer.Option("--page", help="Show it on a page in a browser of this computer, and drive by that."),
    ] = False,
    page_port: Annotated[
        int, typer.Option(min=0, max=65_535, help="Of the page; any free one without it.")
    ] = 0,
    tolerance: Annotated[
        float, typer.Option(min=0.001, help="Uncertainty of the tip, µm (95 %), before which to re-home.")
    ] = 10.0,
    speed: Annotated[
        float, typer.Option(min=1.0, max=500.0, help="Of the tip by a key or a stick, µm/s.")
    ] = 20.0,
    hold: Annotated[float, typer.Option(min=10.0, max=1000.0, help="How long a key moves it, ms.")] = 50.0,
    journal: Annotated[
        Path | None, typer.Option(help="Keep the position here, so that it survives a crash."), Output()
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from where the journal says the joints stand.")
    ] = False,
    homing_log: Annotated[
        Path | None, typer.Option("--log", help="Campaign log to write: each going home is a row."), Output()
    ] = None,
    port: Port = None,
    dialect: DialectOption = Dialect.new,
    device: Device = None,
    tuning: Annotated[
        Path | None, typer.Option(help="What `capture tune` wrote today, to hear stops."), INPUT
    ] = None,
    step_period: Annotated[float, typer.Option(min=0.1, help="Of the controller, ms.")] = 10.0,
    emulate: Annotated[bool, typer.Option("--emulate", help="Try it without hardware.")] = False,
    truth: Annotated[
        Path | None,
        typer.Option(help="Emulated: law file by which the joints step; drawn from the fit without it."),
        INPUT,
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Emulated: of the true laws and the noise.")] = 0,
    source: ArmSource,
) -> None:
    """Drive the tip by hand: a velocity becomes steps, with where the tip is and how surely."""
    from stickslip_fit.drive.session import DriveJob, drive_real
    from stickslip_fit.units import to_si

    if page:
        reject_options({"--script": script, "--by": by is not InputKind.keyboard}, "beside --page")
    else:
        reject_options({"--page-port": page_port}, "without --page")
    if resume:
        reject_options({"--at": at}, "with --resume: the journal says where the joints stand")
        require_option(journal, "--journal, the one to go on with")
    elif at is None:
        raise InputError("give --at Q1,Q2,Q3, where the joints stand (deg,deg,mm); or --resume")
    arm = source.load()
    start = None if at is None else parse_positions(at, "--at")
    job = DriveJob(
        arm=arm,
        start=start,
        tolerance=to_si(tolerance, "µm"),
        journal=journal,
        log=homing_log,
        script=script,
        device="page" if page else by.value,
        page_port=page_port,
        speed=to_si(speed, "µm"),
        hold=to_si(hold, "ms"),
        step_period=to_si(step_period, "ms"),
    )
    if emulate:
        at_rig = {"--port": port, "--device": device, "--tuning": tuning}
        reject_options(at_rig, "at an emulated rig")
        from stickslip_fit.drive.emulated import drive_emulated
        from stickslip_fit.simulation import read_law_values

        laws = read_law_values(truth, arm.machine) if truth else None
        if dialect is Dialect.anc300:
            raise InputError("an ANC300 is not emulated; choose --dialect new or old")
        print(drive_emulated(job, laws, dialect.value, seed))
    else:
        reject_options({"--truth": truth, "--seed": seed}, "at a real rig")
        usage = "--port; or try it without hardware, with --emulate"
        print(drive_real(job, require_option(port, usage), dialect.value, device, tuning))
