"""Verbs that write the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit.cli.arguments import browser_is_there, command, default_output, log_of, reference_campaign
from stickslip_fit.cli.estimating import causes_of
from stickslip_fit.cli.options import CauseNames, LogPath, MachinePath, Since, Until
from stickslip_fit.files import check_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stickslip_fit.causes import Cause
    from stickslip_fit.diagnose import Diagnosis
    from stickslip_fit.logs import Log
    from stickslip_fit.strategies import Comparison


def report(
    log: LogPath,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="HTML file to write.")] = None,
    diagnosis: Annotated[
        bool, typer.Option("--diagnosis", help="With what the laws get wrong, and why; takes longer.")
    ] = False,
    strategies: Annotated[
        bool, typer.Option("--strategies", help="With what each way to calibrate costs and reaches.")
    ] = False,
    cause: CauseNames = None,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Write the accuracy report of a log: one HTML page."""
    from stickslip_fit.cli.diagnosing import diagnosed

    wanted = output or default_output(log)
    check_folder(wanted)
    campaign = log_of(log, machine, since, until)
    causes = causes_of(cause or (), campaign)
    written = _write_report(
        campaign, wanted, causes,
        diagnosed(campaign) if diagnosis else None,
        _compared(campaign, causes) if strategies else None,
    )  # fmt: skip
    print(f"report written to {written}")


def demo(
    log: Annotated[
        list[Path] | None, typer.Argument(metavar="[LOG...]", help="The reference campaign without it.")
    ] = None,
    machine: MachinePath = None,
    browse: Annotated[bool, typer.Option(help="Open the report in a browser where there is one.")] = True,
) -> None:
    """Go the whole way on the reference campaign, or on a log."""
    from stickslip_fit.fit import closed_form, summary

    chosen = log or [reference_campaign()]
    campaign = log_of(chosen, machine)
    print(campaign.summary())
    print("\n" + summary(closed_form(campaign, command=command())))
    written = _write_report(campaign, default_output(chosen)).resolve()
    print(f"\nreport written to {written}")
    if browse and browser_is_there():
        import webbrowser

        webbrowser.open(written.as_uri())


def _compared(log: Log, causes: Sequence[Cause]) -> Comparison:
    from stickslip_fit import strategies

    compared = strategies.usual_strategies()
    if causes:
        compared += strategies.causes_strategies(strategies.from_other_sessions(log, causes))
    return strategies.compare(log, compared, command=command())


def _write_report(
    log: Log,
    output: Path,
    causes: Sequence[Cause] = (),
    diagnosis: Diagnosis | None = None,
    comparison: Comparison | None = None,
) -> Path:
    from stickslip_fit.files import write_atomically
    from stickslip_fit.fit import closed_form, constant_step, least_squares
    from stickslip_fit.report import report_html

    best = least_squares(log, causes=causes, command=command())
    calibration = closed_form(log, causes_from=best if causes else None, command=command())
    constant = constant_step(log, calibration)
    page = report_html(
        log, calibration, constant, best, diagnosis=diagnosis, comparison=comparison, command=command()
    )
    write_atomically(output, page)
    return output
