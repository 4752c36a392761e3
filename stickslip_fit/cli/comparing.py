"""The verb that compares calibration strategies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit.cli.arguments import command, log_of
from stickslip_fit.cli.estimating import causes_of
from stickslip_fit.cli.options import LogPath, MachinePath, Since, Until
from stickslip_fit.errors import InputError
from stickslip_fit.files import check_folder


def compare(
    log: LogPath,
    earlier: Annotated[
        bool, typer.Option("--earlier", help="Look back on earlier sessions only, not on all others.")
    ] = False,
    more: Annotated[
        int, typer.Option(min=1, help="Traverses beyond the parameters, where least squares takes more.")
    ] = 4,
    cause: Annotated[
        list[str] | None,
        typer.Option(
            "--cause", metavar="NAME", help="Also with this cause, fitted to the other sessions; repeatable."
        ),
    ] = None,
    causes_from: Annotated[
        Path | None,
        typer.Option(metavar="RESULT", help="Also with the causes of this result of another log."),
    ] = None,
    numbers: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Save every number there, as CSV and Parquet.")
    ] = None,
    chart: Annotated[
        Path | None, typer.Option("--chart", help="Draw time against error here: .png, .svg or .pdf.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the traverses chosen at random.")] = 0,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Say which way to calibrate buys how much accuracy, and in how many minutes."""
    from stickslip_fit import strategies
    from stickslip_fit.fit import load_result
    from stickslip_fit.report.chart import check_suffix, write_figure
    from stickslip_fit.report.figures.pareto import plot_pareto

    for path in (numbers, chart):
        if path is not None:
            check_folder(path)
    if chart is not None:
        check_suffix(chart)
    if cause and causes_from is not None:
        raise InputError("--cause and --causes-from exclude each other: give one of them")
    campaign = log_of(log, machine, since, until)
    at_hand = strategies.earlier_sessions if earlier else strategies.other_sessions
    compared = strategies.usual_strategies(more, seed)
    if cause:
        known = strategies.from_other_sessions(campaign, causes_of(cause, campaign), at_hand)
        compared += strategies.causes_strategies(known, more)
    if causes_from is not None:
        known = strategies.from_result(campaign, load_result(causes_from))
        compared += strategies.causes_strategies(known, more)
    found = strategies.compare(campaign, compared, at_hand=at_hand, command=command())
    told = [found.summary().as_text(full=True)]
    if numbers is not None:
        written = strategies.save_numbers(found, numbers)
        told.append(f"{len(written)} tables saved in {numbers}")
    if chart is not None:
        write_figure(plot_pareto(found), chart, "pareto")
        told.append(f"chart written to {chart}")
    print("\n\n".join(told))
