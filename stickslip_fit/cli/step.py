"""The command on the physics of one step: step."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit._progress import show_progress
from stickslip_fit.cli._files import INPUT, Output, write_template
from stickslip_fit.cli._options import Force, check_chart, parse_path, reject_options
from stickslip_fit.cli._show import Display, save_chart, show
from stickslip_fit.errors import InputError


def step(
    *,
    stage: Annotated[
        Path | None,
        typer.Argument(metavar="[STAGE]", parser=parse_path, help="Stage file: slider, contact, drive."),
        INPUT,
    ] = None,
    chart: Annotated[
        Path | None,
        typer.Option("--chart", help="Also draw the step and the sweeps here: .png, .svg or .pdf."),
        Output(),
    ] = None,
    example: Annotated[
        bool, typer.Option("--example", help="Instead: a stage file with comments, to be changed.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Of --example: file to write; printed without it."),
        Output(permits=("force",)),
    ] = None,
    force: Force = False,
    display: Display,
) -> None:
    """Compute a stage's step from its physics, and what the step depends on."""
    if example:
        given = {"STAGE": stage, "--chart": chart, "--csv": display.csv, "--latex": display.latex}
        reject_options(given, "with --example")
        write_template("stage_example.toml", output, "stage file")
        return
    if stage is None:
        raise InputError("name a STAGE file; --example writes one to begin with")
    reject_options({"--output": output}, "without --example")
    check_chart(chart)
    from stickslip_fit.step import analyse_stage
    from stickslip_fit.step.stage_file import read_stage

    read = read_stage(stage)
    with show_progress() as progress:
        analysis = analyse_stage(read, progress=progress)
    saved = save_chart(analysis.plot_step, chart, "step")
    show(analysis.summary(), display, [stage], saved)
