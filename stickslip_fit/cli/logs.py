"""Commands on logs: check, simulate, sheet, report, demo."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit._io import check_folder
from stickslip_fit.cli._options import (
    CauseNames,
    LogPath,
    MachinePath,
    PlanPath,
    Since,
    Until,
    command_line,
    default_output,
    has_browser,
    load_law_values,
    load_log,
    reference_campaign,
)
from stickslip_fit.cli.diagnose import CLEAR_LINE, diagnose_with_progress
from stickslip_fit.cli.fit import select_named_causes
from stickslip_fit.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stickslip_fit.causes import Cause
    from stickslip_fit.diagnosis import Diagnosis
    from stickslip_fit.logs import Log
    from stickslip_fit.strategies import Comparison


def check(log: LogPath, machine: MachinePath = None, since: Since = None, until: Until = None) -> None:
    """Check a log for faults and summarize it."""
    print(load_log(log, machine, since, until).summary())


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
    from stickslip_fit import simulation
    from stickslip_fit.logs import write_log
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.moves.arm import column_key, required_columns

    geometry = load_machine(machine)
    planned = read_plan(plan, geometry)
    truth = load_law_values(law, geometry, planned)
    log = simulation.simulate(planned, truth, geometry, seed)
    write_log(log, output)
    print(f"{len(log.rows):,} simulated traverses written to {output}")
    known = log.rows.dropna(axis=1, how="all")
    missing = [column_key(name) for name in required_columns(truth.laws.values()) if name not in known]
    if missing:
        print(f"the plan does not say {', '.join(missing)}: the law was taken at its mean")


def sheet(
    plan: PlanPath,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="CSV to fill in; a page to print goes beside it.")
    ],
    machine: MachinePath = None,
) -> None:
    """Write a sheet for counts taken by hand: a CSV, a page to print."""
    from stickslip_fit.logs.plan import write_sheet_csv
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.reporting.moves import write_sheet_page

    if output.suffix == ".html":
        raise InputError("-o names the CSV to fill in; the page to print goes beside it as .html")
    chosen = read_plan(plan, load_machine(machine))
    page = output.with_suffix(".html")
    write_sheet_csv(chosen, output)
    write_sheet_page(chosen, page)
    print(f"sheet to fill in: {output}\npage to print: {page}")


MAX_COMPARED_SESSIONS = 12


def report(
    log: LogPath,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="HTML file to write.")] = None,
    diagnosis: Annotated[bool, typer.Option(help="With the diagnosis.")] = True,
    strategies: Annotated[bool, typer.Option(help="With the comparison of strategies.")] = True,
    cause: CauseNames = None,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Write the whole report of a log: one HTML page."""
    page = output or default_output(log)
    check_folder(page)
    campaign = load_log(log, machine, since, until)
    causes = select_named_causes(cause or (), campaign)
    with _show_step() as show:
        result = _try_section(lambda: diagnose_with_progress(campaign)) if diagnosis else None
        show("comparing strategies" if strategies else "")
        comparison = _try_section(lambda: _compare_strategies(campaign, causes)) if strategies else None
        show("fitting and drawing")
        written = _write_report(campaign, page, causes, result, comparison)
    print(f"report written to {written}")


def demo(
    log: Annotated[
        list[Path] | None, typer.Argument(metavar="LOG", help="The reference campaign without it.")
    ] = None,
    machine: MachinePath = None,
    browse: Annotated[bool, typer.Option(help="Open the report in a browser where there is one.")] = True,
) -> None:
    """Check, calibrate and report the reference campaign, or a log."""
    from stickslip_fit.estimation import fit_closed_form

    chosen = log or [reference_campaign()]
    campaign = load_log(chosen, machine)
    print(campaign.summary())
    print(f"\n{fit_closed_form(campaign, command=command_line())}")
    with _show_step() as show:
        show("fitting and drawing")
        written = _write_report(campaign, default_output(chosen)).resolve()
    print(f"\nreport written to {written}")
    whole = shlex.join(["stickslip-fit", "report", *map(str, chosen)])
    print(f"with diagnosis and comparison of strategies: {whole}")
    if browse and has_browser():
        import webbrowser

        webbrowser.open(written.as_uri())


@contextmanager
def _show_step() -> Iterator[Callable[[str], None]]:
    """A function that shows the current step at a terminal; erased in the end."""

    def show(step: str) -> None:
        if sys.stderr.isatty():
            print(f"{CLEAR_LINE}{step}", end="", file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        show("")


def _try_section[Section](make: Callable[[], Section]) -> Section | InputError:
    """A section of the report, or the error instead, so that the rest of the page is still written."""
    try:
        return make()
    except InputError as error:
        return error


def _compare_strategies(log: Log, causes: Sequence[Cause]) -> Comparison:
    """The default strategies on the latest sessions: each uses all others, so that many would take hours."""
    from stickslip_fit.strategies import (
        causes_from_other_sessions,
        compare_strategies,
        default_strategies,
        default_strategies_with_causes,
    )

    log = log.select(log.rows["session"].isin(log.sessions[-MAX_COMPARED_SESSIONS:]))
    strategies = default_strategies()
    if causes:
        strategies += default_strategies_with_causes(causes_from_other_sessions(log, causes))
    return compare_strategies(log, strategies, command=command_line())


def _write_report(
    log: Log,
    output: Path,
    causes: Sequence[Cause] = (),
    diagnosis: Diagnosis | InputError | None = None,
    comparison: Comparison | InputError | None = None,
) -> Path:
    from stickslip_fit._io import write_atomically
    from stickslip_fit.estimation import fit_closed_form, fit_constant_step, fit_least_squares
    from stickslip_fit.reporting import report_html

    best = fit_least_squares(log, causes=causes, command=command_line())
    calibration = fit_closed_form(log, causes_from=best if causes else None, command=command_line())
    constant = fit_constant_step(log, calibration)
    page = report_html(
        log, calibration, constant, best, diagnosis=diagnosis, comparison=comparison, command=command_line()
    )
    write_atomically(output, page)
    return output
