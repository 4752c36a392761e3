"""The verb that runs a simulated study."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit.cli.arguments import command
from stickslip_fit.cli.options import MachinePath
from stickslip_fit.errors import InputError


def study(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Plan of a study (TOML).")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder that keeps finished campaigns, numbers and charts."),
    ] = None,
    campaigns: Annotated[
        int | None, typer.Option(min=1, help="Of each scenario, instead of what the plan says.")
    ] = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Run on this Dask cluster.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes on this machine; one a core without it.")
    ] = None,
    machine: MachinePath = None,
) -> None:
    """Simulate campaigns in which something is hidden, and say which calibration survives what.

    What is finished is kept in the folder (by default named after the plan, in reports/): the same command
    carries on where it was interrupted.
    """
    from dataclasses import replace

    from stickslip_fit.machine import load_machine
    from stickslip_fit.report.chart import write_figure
    from stickslip_fit.report.figures.study import plot_errors, plot_tips
    from stickslip_fit.strategies import study as studies
    from stickslip_fit.strategies.study.numbers import make_folder

    if cluster is not None and workers is not None:
        raise InputError("--cluster and --workers exclude each other: a cluster has its own workers")
    planned = studies.read_study(plan, load_machine(machine))
    if campaigns is not None:
        planned = replace(planned, campaigns=campaigns)
    if output is None:
        make_folder(Path("reports"))
    folder = output or Path("reports", plan.resolve().stem)
    make_folder(folder)
    backend = studies.Cores(workers or -1) if cluster is None else studies.Cluster(cluster)
    try:
        found = studies.run_study(planned, folder, backend, progress=True, command=command())
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command carries on from what {folder} keeps", file=sys.stderr)
        raise
    written = studies.save_study(found, folder)
    charts = {"errors": plot_errors} | ({"tips": plot_tips} if planned.moves else {})
    for name, plot in charts.items():
        write_figure(plot(found), folder / f"{name}.png", name)
    saved = f"{len(written) // 2} tables (CSV and Parquet) and {', '.join(charts)}.png saved in {folder}"
    print(f"{found}\n\n{saved}")
