"""Commands on calibration strategies: compare, study."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit._io import make_folder
from stickslip_fit._progress import show_progress
from stickslip_fit.cli._files import INPUT, Output
from stickslip_fit.cli._options import (
    LawNames,
    LogSource,
    MachinePath,
    check_chart,
    command_line,
    load_causes,
    load_laws,
)
from stickslip_fit.cli._show import Display, save_chart, show
from stickslip_fit.cli.fit import select_named_causes
from stickslip_fit.errors import InputError


def compare(
    *,
    earlier: Annotated[
        bool, typer.Option("--earlier", help="Use earlier sessions only, not all others.")
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
        INPUT,
    ] = None,
    numbers: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Save every number there, as CSV and Parquet."),
        Output(folder=True),
    ] = None,
    chart: Annotated[
        Path | None,
        typer.Option("--chart", help="Draw time against error here: .png, .svg or .pdf."),
        Output(),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the traverses chosen at random.")] = 0,
    law: LawNames = None,
    source: LogSource,
    display: Display,
) -> None:
    """Compare calibration strategies by their held-out accuracy and the minutes they take."""
    from stickslip_fit.estimation import load_result
    from stickslip_fit.strategies import (
        causes_from_other_sessions,
        causes_from_result,
        compare_strategies,
        default_strategies,
        default_strategies_with_causes,
        earlier_sessions,
        other_sessions,
        save_comparison,
    )

    check_chart(chart)
    if cause and causes_from is not None:
        raise InputError("--cause and --causes-from exclude each other: give one of them")
    campaign = source.read()
    laws = load_laws(law, campaign.joints)
    session_selector = earlier_sessions if earlier else other_sessions
    strategies = default_strategies(more, seed)
    if cause:
        known = causes_from_other_sessions(
            campaign, select_named_causes(cause, campaign, load_causes(law)), session_selector, laws
        )
        strategies += default_strategies_with_causes(known, more)
    if causes_from is not None:
        known = causes_from_result(campaign, load_result(causes_from, load_causes(law), laws=laws))
        strategies += default_strategies_with_causes(known, more)
    with show_progress() as progress:
        comparison = compare_strategies(
            campaign,
            strategies,
            laws=laws,
            session_selector=session_selector,
            command=command_line(),
            progress=progress,
        )
    saved = []
    if numbers is not None:
        saved.append(f"{len(save_comparison(comparison, numbers))} tables saved in {numbers}")
    if chart is not None:
        from stickslip_fit.plotting.strategies import plot_pareto

        saved += save_chart(partial(plot_pareto, comparison), chart, "pareto")
    show(comparison.summary(), display, source.log, saved)


def study(
    *,
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Plan of a study (TOML)."), INPUT],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder that keeps finished campaigns, numbers and charts."),
        Output(folder=True),
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
    display: Display,
) -> None:
    """Simulate campaigns with hidden causes, and compare how strategies cope with them.

    Finished campaigns are kept in the folder (by default named after the plan, in reports/): the same
    command continues an interrupted study.
    """
    from dataclasses import replace

    from stickslip_fit.machine import load_machine
    from stickslip_fit.plotting._style import write_figure
    from stickslip_fit.plotting.strategies import plot_study_errors, plot_study_tips
    from stickslip_fit.studies import Cluster, Cores, read_study, run_study, save_study

    if cluster is not None and workers is not None:
        raise InputError("--cluster and --workers exclude each other: a cluster has its own workers")
    planned = read_study(plan, load_machine(machine))
    if campaigns is not None:
        planned = replace(planned, campaigns=campaigns)
    if output is None:
        make_folder(Path("reports"))
    folder = output or Path("reports", plan.resolve().stem)
    make_folder(folder)
    backend = Cores(workers or -1) if cluster is None else Cluster(cluster)
    try:
        result = run_study(planned, folder, backend, progress=True, command=command_line())
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command continues from {folder}", file=sys.stderr)
        raise
    written = save_study(result, folder)
    charts = {"errors": plot_study_errors} | ({"tips": plot_study_tips} if planned.moves else {})
    for name, plot in charts.items():
        write_figure(plot(result), folder / f"{name}.png", name)
    saved = f"{len(written) // 2} tables (CSV and Parquet) and {', '.join(charts)}.png saved in {folder}"
    show(result.summary(), display, [plan], [saved])
