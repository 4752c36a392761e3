"""Verbs that write the report."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit.cli.arguments import browser_is_there, command, default_output, log_of, reference_campaign
from stickslip_fit.cli.diagnosing import CLEAR, diagnosed
from stickslip_fit.cli.estimating import causes_of
from stickslip_fit.cli.options import CauseNames, LogPath, MachinePath, Since, Until
from stickslip_fit.errors import InputError
from stickslip_fit.files import check_folder

SESSIONS_COMPARED = 12

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stickslip_fit.causes import Cause
    from stickslip_fit.diagnose import Diagnosis
    from stickslip_fit.logs import Log
    from stickslip_fit.strategies import Comparison


def report(
    log: LogPath,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="HTML file to write.")] = None,
    diagnosis: Annotated[bool, typer.Option(help="With what the laws get wrong, and why.")] = True,
    strategies: Annotated[
        bool, typer.Option(help="With what each way to calibrate costs and reaches.")
    ] = True,
    cause: CauseNames = None,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Write the whole report of a log: one HTML page."""
    wanted = output or default_output(log)
    check_folder(wanted)
    campaign = log_of(log, machine, since, until)
    causes = causes_of(cause or (), campaign)
    with _telling() as tell:
        found = _if_it_can(lambda: diagnosed(campaign)) if diagnosis else None
        tell("comparing ways to calibrate" if strategies else "")
        comparison = _if_it_can(lambda: _compared(campaign, causes)) if strategies else None
        tell("fitting and drawing")
        written = _write_report(campaign, wanted, causes, found, comparison)
    print(f"report written to {written}")


def demo(
    log: Annotated[
        list[Path] | None, typer.Argument(metavar="LOG", help="The reference campaign without it.")
    ] = None,
    machine: MachinePath = None,
    browse: Annotated[bool, typer.Option(help="Open the report in a browser where there is one.")] = True,
) -> None:
    """Go the whole way on the reference campaign, or on a log."""
    from stickslip_fit.fit import closed_form

    chosen = log or [reference_campaign()]
    campaign = log_of(chosen, machine)
    print(campaign.summary())
    print(f"\n{closed_form(campaign, command=command())}")
    with _telling() as tell:
        tell("fitting and drawing")
        written = _write_report(campaign, default_output(chosen)).resolve()
    print(f"\nreport written to {written}")
    print(f"what the law gets wrong, and which calibration to choose: {_whole_report(chosen)}")
    if browse and browser_is_there():
        import webbrowser

        webbrowser.open(written.as_uri())


def _whole_report(paths: list[Path]) -> str:
    return shlex.join(["stickslip-fit", "report", *map(str, paths)])


@contextmanager
def _telling() -> Iterator[Callable[[str], None]]:
    """Where somebody watches, tells what is being done; wiped in the end."""

    def tell(step: str) -> None:
        if sys.stderr.isatty():
            print(f"{CLEAR}{step}", end="", file=sys.stderr, flush=True)

    try:
        yield tell
    finally:
        tell("")


def _if_it_can[Section](make: Callable[[], Section]) -> Section | InputError:
    """A section of the report, or why this log has none: that must not cost the rest of the page."""
    try:
        return make()
    except InputError as error:
        return error


def _compared(log: Log, causes: Sequence[Cause]) -> Comparison:
    """The usual strategies on the latest sessions: each looks back on all others, so that many take hours."""
    from stickslip_fit import strategies

    log = log.select(log.rows["session"].isin(log.sessions[-SESSIONS_COMPARED:]))
    compared = strategies.usual_strategies()
    if causes:
        compared += strategies.causes_strategies(strategies.from_other_sessions(log, causes))
    return strategies.compare(log, compared, command=command())


def _write_report(
    log: Log,
    output: Path,
    causes: Sequence[Cause] = (),
    diagnosis: Diagnosis | InputError | None = None,
    comparison: Comparison | InputError | None = None,
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
