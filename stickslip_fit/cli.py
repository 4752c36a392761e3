"""The command line: one verb a question."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit import __version__
from stickslip_fit.arguments import (
    arm_of,
    browser_is_there,
    command,
    default_output,
    drive_of,
    joint_order,
    law_values_of,
    log_of,
    positions,
    reference_campaign,
    tip_position,
)
from stickslip_fit.errors import InputError
from stickslip_fit.files import check_folder
from stickslip_fit.options import (
    At,
    Calibration,
    Json,
    LogPath,
    MachinePath,
    Method,
    Psi,
    Session,
    Since,
    Theta,
    Until,
)

if TYPE_CHECKING:
    from stickslip_fit.fit import Result
    from stickslip_fit.logs import Log

app = typer.Typer(
    help="Step-size laws of piezoelectric stick-slip actuators: from step counts to calibrated moves.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def check(log: LogPath, machine: MachinePath = None, since: Since = None, until: Until = None) -> None:
    """Read a log, report every fault in it, and say what it holds."""
    print(log_of(log, machine, since, until).summary())


@app.command()
def calibrate(
    log: LogPath, machine: MachinePath = None, since: Since = None, until: Until = None, json: Json = None
) -> None:
    """Calibrate each session from its first few traverses."""
    fit(log, Method.closed_form, machine, since, until, json, False, False, 0, None)


@app.command()
def fit(
    log: LogPath,
    method: Annotated[Method, typer.Option(help="Estimator.")] = Method.least_squares,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
    json: Json = None,
    heavy_tails: Annotated[
        bool,
        typer.Option("--heavy-tails", help="Least squares: Student's t, so that misheard stops pull little."),
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Least squares: show profile-likelihood intervals too.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Bayes: seed of the draws.")] = 0,
    walks: Annotated[
        Path | None,
        typer.Option(help="Bayes: HDF5 file that keeps the walks; the same call carries on there."),
    ] = None,
) -> None:
    """Fit the laws' parameters for each session and direction."""
    from stickslip_fit.fit import save_result
    from stickslip_fit.fit.expectation import expectation, expectation_text

    _refuse_foreign_options(method, heavy_tails, profile, walks)
    if json is not None:
        check_folder(json)
    campaign = log_of(log, machine, since, until)
    result, text = _estimate(campaign, method, heavy_tails, seed, walks)
    print(f"{text}\n\n{expectation_text(expectation(result))}")
    if profile:
        print("\n" + _profile(campaign, result))
    if json is not None:
        save_result(result, json)
        print(f"\nsaved to {json}")


@app.command()
def report(
    log: LogPath,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="HTML file to write.")] = None,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Write the accuracy report of a log: one HTML page."""
    wanted = output or default_output(log)
    check_folder(wanted)
    written = _write_report(log_of(log, machine, since, until), wanted)
    print(f"report written to {written}")


@app.command()
def simulate(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Plan of a campaign (TOML).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Log to write.")],
    law: Annotated[Path, typer.Option(help="Law file (TOML), or a result saved with `fit --json`.")],
    machine: MachinePath = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the plan's seed.")] = None,
) -> None:
    """Simulate a plan under a law; the same seed, the same log."""
    from stickslip_fit.logs import write_log
    from stickslip_fit.logs.read_plan import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.simulate import simulate as run

    chosen = load_machine(machine)
    log = run(read_plan(plan, chosen), law_values_of(law, chosen), chosen, seed)
    write_log(log, output)
    print(f"{len(log.rows):,} simulated traverses written to {output}")


@app.command()
def sheet(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Plan of a campaign (TOML).")],
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


@app.command()
def steps(
    calibration: Calibration,
    at: At,
    tip: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Where the tip is to go, base frame, mm.")
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="Q1,Q2,Q3", help="Or where the joints are to go: deg,deg,mm.")
    ] = None,
    order: Annotated[str, typer.Option(help="Which joint moves first.")] = "1,2,3",
    session: Session = None,
    theta: Theta = 0.0,
    psi: Psi = 0.0,
    machine: MachinePath = None,
) -> None:
    """Say how many steps take the tip from here to there."""
    from stickslip_fit.machine import nearest_solution
    from stickslip_fit.moves import steps_for_move
    from stickslip_fit.report.text import move_text

    arm = arm_of(calibration, machine, session, theta, psi)
    start = positions(at, "--at")
    if (tip is None) == (joints is None):
        raise InputError("say where to go: either --tip X,Y,Z (mm) or --joints Q1,Q2,Q3 (deg,deg,mm)")
    if tip is not None:
        target = nearest_solution(arm.machine, tip_position(tip, "--tip"), start)
    else:
        target = positions(str(joints), "--joints")
    print(move_text(arm, steps_for_move(arm, start, target, joint_order(order, "--order"))))


@app.command()
def where(
    calibration: Calibration,
    at: At,
    drive: Annotated[
        list[str],
        typer.Option(metavar="JOINT±STEPS", help="A drive, e.g. 3+5000 or 2-1200; repeat for a run."),
    ],
    tolerance: Annotated[
        float, typer.Option(help="Say when the tip is no longer known to within this many µm (95 %).")
    ] = 10.0,
    session: Session = None,
    theta: Theta = 0.0,
    psi: Psi = 0.0,
    machine: MachinePath = None,
) -> None:
    """Say where the tip is after N steps, and when to re-home."""
    from stickslip_fit.moves import where_after
    from stickslip_fit.report.text import whereabouts_text
    from stickslip_fit.units import to_si

    arm = arm_of(calibration, machine, session, theta, psi)
    found = where_after(arm, positions(at, "--at"), [drive_of(text, "--drive") for text in drive])
    print(whereabouts_text(arm, found, to_si(tolerance, "µm")))


@app.command()
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


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=lambda wanted: _version(wanted), is_eager=True, help="Version."),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; bad input ends with one clear message and status 2."""
    try:
        app()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted; nothing was left half-written", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # The reader of our output has gone; closing quietly is what other tools do.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"stickslip-fit {__version__}")
        raise typer.Exit


def _refuse_foreign_options(method: Method, heavy_tails: bool, profile: bool, walks: Path | None) -> None:
    if (method is not Method.least_squares and (heavy_tails or profile)) or (heavy_tails and profile):
        raise InputError("--profile and --heavy-tails are two ways of --method least-squares; choose one")
    if method is not Method.bayes and walks is not None:
        raise InputError("--walks belongs to --method bayes")


def _estimate(
    log: Log, method: Method, heavy_tails: bool, seed: int, walks: Path | None
) -> tuple[Result, str]:
    from stickslip_fit.fit import closed_form, least_squares, summary
    from stickslip_fit.fit.likelihood import Gaussian, StudentT

    if method is Method.bayes:
        from stickslip_fit.fit.bayes import bayes

        watched = sys.stderr.isatty()
        posterior = bayes(log, seed=seed, backend=walks, progress=watched, command=command())
        return posterior.result, str(posterior)
    if method is Method.closed_form:
        result = closed_form(log, command=command())
    else:
        result = least_squares(log, likelihood=StudentT() if heavy_tails else Gaussian(), command=command())
    return result, summary(result)


def _profile(log: Log, result: Result) -> str:
    from stickslip_fit.fit.profile import profile_intervals
    from stickslip_fit.fit.summary import profile_summary

    return profile_summary(profile_intervals(log, result))


def _write_report(log: Log, output: Path) -> Path:
    from stickslip_fit.files import write_atomically
    from stickslip_fit.fit import closed_form, constant_step, least_squares
    from stickslip_fit.report import report_html

    calibration = closed_form(log, command=command())
    constant = constant_step(log, calibration)
    best = least_squares(log, command=command())
    write_atomically(output, report_html(log, calibration, constant, best, command=command()))
    return output
