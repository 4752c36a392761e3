"""Commands on logs: check, simulate, sheet, report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit._io import write_atomically
from stickslip_fit._progress import show_progress
from stickslip_fit.cli._files import INPUT, Output
from stickslip_fit.cli._options import (
    CauseNames,
    Force,
    LawNames,
    LogSource,
    MachinePath,
    PlanPath,
    command_line,
    default_output,
    load_causes,
    load_law_values,
    load_laws,
)
from stickslip_fit.cli._show import Display, show
from stickslip_fit.cli.fit import select_named_causes


def check(*, source: LogSource, display: Display) -> None:
    """Check a log for faults and summarize it."""
    following = f"What is wrong with it, if anything: {source.command('diagnose')}"
    show(source.read().summary(), display, source.log, [following])


def simulate(
    plan: PlanPath,
    output: Annotated[Path, typer.Option("-o", "--output", help="Log to write."), Output(permits=("force",))],
    law: Annotated[
        Path,
        typer.Option(
            help="Law file (TOML), with laws or stages, causes and all, or a result saved with `fit --json`."
        ),
        INPUT,
    ],
    machine: MachinePath = None,
    true_steps: Annotated[
        Path | None,
        typer.Option(
            help="Also write here, as CSV, the true step of each traverse and its stage's quantities."
        ),
        Output(permits=("force",)),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the plan's seed.")] = None,
    force: Force = False,
) -> None:
    """Simulate a plan under a law, or with stages whose quantities change; the same seed, the same log."""
    from stickslip_fit import simulation
    from stickslip_fit.logs import write_log
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.moves.arm import column_key, required_columns
    from stickslip_fit.simulation.truth_table import format_true_steps

    geometry = load_machine(machine)
    planned = read_plan(plan, geometry)
    known = load_law_values(law, geometry, planned)
    log = simulation.simulate(planned, known, geometry, seed)
    write_log(log, output)
    print(f"{len(log.rows):,} simulated traverses written to {output}")
    if true_steps is not None:
        table = simulation.true_steps(log, known, planned)
        write_atomically(true_steps, format_true_steps(table, geometry))
        print(f"true steps written to {true_steps}")
    given = log.rows.dropna(axis=1, how="all")
    missing = [column_key(name) for name in required_columns(known.laws.values()) if name not in given]
    if missing:
        print(f"the plan does not say {', '.join(missing)}: the law was taken at its mean")


def page_path(sheet: Path) -> Path:
    """The page to print, beside the CSV to fill in."""
    return sheet.with_suffix(".html")


def sheet(
    plan: PlanPath,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="CSV to fill in; a page to print goes beside it."),
        Output(beside=(page_path,), permits=("force",)),
    ],
    machine: MachinePath = None,
    force: Force = False,
) -> None:
    """Write a sheet for counts taken by hand: a CSV, a page to print."""
    from stickslip_fit.logs.plan import write_sheet_csv
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.reporting.moves import write_sheet_page

    chosen = read_plan(plan, load_machine(machine))
    page = page_path(output)
    write_sheet_csv(chosen, output)
    write_sheet_page(chosen, page)
    print(f"sheet to fill in: {output}\npage to print: {page}")


def report(
    *,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="HTML file to write."), Output()
    ] = None,
    diagnosis: Annotated[bool, typer.Option(help="With the diagnosis.")] = True,
    strategies: Annotated[bool, typer.Option(help="With the comparison of strategies.")] = True,
    figures: Annotated[bool, typer.Option("--figures", help="With further figures, folded.")] = False,
    cause: CauseNames = None,
    law: LawNames = None,
    source: LogSource,
) -> None:
    """Write the whole report of a log: one HTML page."""
    from stickslip_fit.reporting import report as make_report

    wanted = output or default_output(source.log)
    campaign = source.read()
    causes, laws = (
        select_named_causes(cause or (), campaign, load_causes(law)),
        load_laws(law, campaign.joints),
    )
    wishes = {"diagnosis": diagnosis, "strategies": strategies, "figures": figures}
    sections = [name for name, chosen in wishes.items() if chosen]
    with show_progress() as progress:
        page = make_report(
            campaign, laws=laws, causes=causes, sections=sections, command=command_line(), progress=progress
        )
    page.save(wanted)
    print(f"report written to {wanted}")
