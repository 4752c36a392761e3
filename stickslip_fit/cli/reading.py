"""Verbs around logs: check one, simulate one, a sheet to fill one in by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit.cli.arguments import law_values_of, log_of
from stickslip_fit.cli.options import LogPath, MachinePath, PlanPath, Since, Until
from stickslip_fit.errors import InputError


def check(log: LogPath, machine: MachinePath = None, since: Since = None, until: Until = None) -> None:
    """Read a log, report every fault in it, and say what it holds."""
    print(log_of(log, machine, since, until).summary())


def simulate(
    plan: PlanPath,
    output: Annotated[Path, typer.Option("-o", "--output", help="Log to write.")],
    law: Annotated[
        Path, typer.Option(help="Law file (TOML), causes and all, or a result saved with `fit --json`.")
    ],
    machine: MachinePath = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the plan's seed.")] = None,
) -> None:
    """Simulate a plan under a law; the same seed, the same log."""
    from stickslip_fit.logs import write_log
    from stickslip_fit.logs.read_plan import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.moves.conditions import looked_at, spelled
    from stickslip_fit.simulate import simulate as run

    chosen = load_machine(machine)
    planned = read_plan(plan, chosen)
    truth = law_values_of(law, chosen, planned)
    log = run(planned, truth, chosen, seed)
    write_log(log, output)
    print(f"{len(log.rows):,} simulated traverses written to {output}")
    unsaid = [
        name for name in looked_at(truth.laws.values()) if name not in log.rows.dropna(axis=1, how="all")
    ]
    if unsaid:
        print(f"the plan does not say {', '.join(map(spelled, unsaid))}: the law was taken at its mean")


def sheet(
    plan: PlanPath,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="CSV to fill in; a page to print goes beside it.")
    ],
    machine: MachinePath = None,
) -> None:
    """Write a sheet for counts taken by hand: a CSV, a page to print."""
    from stickslip_fit.logs.read_plan import read_plan
    from stickslip_fit.logs.sheet import write_sheet_csv
    from stickslip_fit.machine import load_machine
    from stickslip_fit.report.sheet import write_sheet_page

    if output.suffix == ".html":
        raise InputError("-o names the CSV to fill in; the page to print goes beside it as .html")
    chosen = read_plan(plan, load_machine(machine))
    page = output.with_suffix(".html")
    write_sheet_csv(chosen, output)
    write_sheet_page(chosen, page)
    print(f"sheet to fill in: {output}\npage to print: {page}")
