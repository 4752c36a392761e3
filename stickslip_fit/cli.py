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
    fitted_of,
    joint_order,
    law_values_of,
    log_of,
    plan_conditions_of,
    positions,
    reference_campaign,
    reference_law,
    tip_position,
)
from stickslip_fit.errors import InputError
from stickslip_fit.estimating import Estimator, Outputs, causes_of, estimate, refuse, save
from stickslip_fit.files import check_folder
from stickslip_fit.options import (
    At,
    Calibration,
    CauseNames,
    CausesFrom,
    Chart,
    Condition,
    Json,
    LogPath,
    MachinePath,
    Method,
    PlanPath,
    Psi,
    Session,
    Since,
    Theta,
    Until,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from stickslip_fit.causes import Cause
    from stickslip_fit.diagnose import Diagnosis
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
    log: LogPath,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
    causes_from: CausesFrom = None,
    json: Json = None,
    chart: Chart = None,
) -> None:
    """Calibrate each session from its first few traverses."""
    how = Estimator(Method.closed_form, causes_from=causes_from)
    _fit(log, machine, since, until, how, Outputs(json, chart))


@app.command()
def fit(
    log: LogPath,
    method: Annotated[Method, typer.Option(help="Estimator.")] = Method.least_squares,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
    json: Json = None,
    chart: Chart = None,
    cause: CauseNames = None,
    causes_from: CausesFrom = None,
    heavy_tails: Annotated[
        bool,
        typer.Option("--heavy-tails", help="Least squares: Student's t, so that misheard stops pull little."),
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Least squares: show profile-likelihood intervals too.")
    ] = False,
    campaign_wide: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Least squares: a parameter that all sessions share; repeatable."),
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LOW:HIGH", help="Least squares: bounds of a parameter; repeatable."),
    ] = None,
    repeatability: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[JOINT±=]PERCENT", help="Least squares: known repeatability, e.g. 0.3 or 3+=0.25."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Bayes: seed of the draws.")] = 0,
    walks: Annotated[
        Path | None,
        typer.Option(help="Bayes: HDF5 file that keeps the walks; the same call carries on there."),
    ] = None,
    tree: Annotated[
        Path | None, typer.Option(help="Bayes: also save the draws here, netCDF (.nc) that ArviZ reads.")
    ] = None,
) -> None:
    """Fit the laws' parameters for each session and direction."""
    terms = (tuple(campaign_wide or ()), tuple(bound or ()), tuple(repeatability or ()))
    how = Estimator(method, heavy_tails, profile, *terms, seed, walks, tuple(cause or ()), causes_from)
    _fit(log, machine, since, until, how, Outputs(json, chart, tree))


@app.command()
def predict(
    calibration: Calibration,
    plan: PlanPath,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="CSV to write with every traverse.")
    ] = None,
    session: Session = None,
    condition: Condition = None,
    machine: MachinePath = None,
) -> None:
    """Say what counts the traverses of a plan will give, with 95 % intervals."""
    from stickslip_fit.files import write_atomically
    from stickslip_fit.fit.predict import predict_plan
    from stickslip_fit.logs.read_plan import read_plan
    from stickslip_fit.report.predictions import predictions_csv, predictions_text

    if output is not None:
        check_folder(output)
    fitted, result = fitted_of(calibration, machine)
    planned = read_plan(plan, result.machine)
    conditions = plan_conditions_of(condition, result)
    predicted = predict_plan(fitted, planned, session, conditions)
    print(predictions_text(result, planned, predicted))
    _tell_of(result, conditions)
    if output is not None:
        write_atomically(output, predictions_csv(planned, predicted))
        print(f"\nall {len(predicted):,} written to {output}")


@app.command()
def anova(
    log: LogPath,
    joint: Annotated[int | None, typer.Option(min=1, max=3, help="Of this joint only.")] = None,
    session: Annotated[str | None, typer.Option(help="Within this session only.")] = None,
    formula: Annotated[
        str | None, typer.Option(help="A model of one's own, e.g. 'step_size ~ C(session) * direction'.")
    ] = None,
    kind: Annotated[
        int, typer.Option("--type", min=1, max=3, help="Formula: type of the sums of squares.")
    ] = 2,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
    json: Json = None,
) -> None:
    """Say which factors matter: day, direction, normal force; or those of a formula."""
    from stickslip_fit.anova import analyse, save_records
    from stickslip_fit.anova import formula as by_formula

    if json is not None:
        check_folder(json)
    campaign = log_of(log, machine, since, until)
    if formula is None:
        found = analyse(campaign, joint=joint, session=session)
        text, records = str(found), found.to_json()
    else:
        tables = by_formula(campaign, formula, joint=joint, session=session, kind=kind)
        text = "\n\n".join(map(str, tables))
        records = [record for table in tables for record in table.to_json()]
    print(text)
    if json is not None:
        save_records(records, json)
        print(f"\nsaved to {json}")


@app.command()
def diagnose(
    log: LogPath,
    json: Json = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Also show it as one HTML page here, with figures.")
    ] = None,
    save_law: Annotated[
        Path | None,
        typer.Option("--save-law", help="Also fit the law with what was named in it, and save that here."),
    ] = None,
    alpha: Annotated[float, typer.Option(min=0.001, max=0.2, help="False-alarm rate.")] = 0.01,
    seed: Annotated[int, typer.Option(min=0, help="Of the logs in which nothing is wrong.")] = 0,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Say what the laws get wrong in a log, why, and what knowing it gains."""
    from stickslip_fit import diagnosing

    diagnosing.refuse(json, report, save_law)
    campaign = log_of(log, machine, since, until)
    found = diagnosing.diagnosed(campaign, alpha, seed)
    print(found)
    if saved := diagnosing.save(found, json, report):
        print("\n" + "\n".join(saved))
    if save_law is not None:
        print("\n" + diagnosing.save_law(diagnosing.law_found(campaign, found), save_law))


@app.command()
def report(
    log: LogPath,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="HTML file to write.")] = None,
    diagnosis: Annotated[
        bool, typer.Option("--diagnosis", help="With what the laws get wrong, and why; takes longer.")
    ] = False,
    cause: CauseNames = None,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Write the accuracy report of a log: one HTML page."""
    from stickslip_fit.diagnosing import diagnosed

    wanted = output or default_output(log)
    check_folder(wanted)
    campaign = log_of(log, machine, since, until)
    causes = causes_of(cause or (), campaign)
    written = _write_report(campaign, wanted, causes, diagnosed(campaign) if diagnosis else None)
    print(f"report written to {written}")


@app.command()
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
    from stickslip_fit.report.claimed import claimed_text

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
    print("\n\n".join(filter(None, (str(found), claimed_text(found)))))
    if numbers is not None:
        written = strategies.save_numbers(found, numbers)
        print(f"\n{len(written)} tables saved in {numbers}")
    if chart is not None:
        write_figure(found.plot_pareto(), chart, "pareto")
        print(f"\nchart written to {chart}")


@app.command()
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


@app.command()
def plan(
    source: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...|PLAN", help="A campaign log, or the plan of a campaign (TOML)."),
    ],
    law: Annotated[
        Path | None,
        typer.Option(help="Of a plan: law file (TOML), or a result saved with `fit --json`; else ours."),
    ] = None,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
    alpha: Annotated[float, typer.Option(min=0.001, max=0.2, help="False-alarm rate.")] = 0.01,
    seed: Annotated[int, typer.Option(min=0, help="Of the logs in which nothing is wrong.")] = 0,
    json: Json = None,
    chart: Annotated[
        Path | None,
        typer.Option("--chart", help="Of a plan: also draw which causes are confused: .png, .svg or .pdf."),
    ] = None,
) -> None:
    """Say which traverses are worth making next; of a plan, which causes it could tell apart."""
    from stickslip_fit import planning

    planning.refuse(source, {"--law": law, "--chart": chart}, {"--since": since, "--until": until})
    planning.refuse_outputs(json, chart)
    if planning.is_plan(source):
        from stickslip_fit.logs.read_plan import read_plan
        from stickslip_fit.machine import load_machine

        chosen = load_machine(machine)
        planned = read_plan(source[0], chosen)
        truth = law_values_of(law or reference_law(), chosen, planned)
        found = planning.before_data(planned, truth, chosen, alpha, seed)
    else:
        found = planning.after_log(log_of(source, machine, since, until), alpha, seed)
    print(found.text)
    if saved := planning.save(found, json, chart):
        print("\n" + "\n".join(saved))


@app.command()
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
    condition: Condition = None,
    machine: MachinePath = None,
) -> None:
    """Say how many steps take the tip from here to there."""
    from stickslip_fit.machine import nearest_solution
    from stickslip_fit.moves import steps_for_move
    from stickslip_fit.report.text import move_text

    arm = arm_of(calibration, machine, session, theta, psi, condition)
    start = positions(at, "--at")
    if (tip is None) == (joints is None):
        raise InputError("say where to go: either --tip X,Y,Z (mm) or --joints Q1,Q2,Q3 (deg,deg,mm)")
    if tip is not None:
        target = nearest_solution(arm.machine, tip_position(tip, "--tip"), start)
    else:
        target = positions(str(joints), "--joints")
    print(move_text(arm, steps_for_move(arm, start, target, joint_order(order, "--order"))))
    _tell_of(arm.result, arm.conditions)


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
    condition: Condition = None,
    machine: MachinePath = None,
) -> None:
    """Say where the tip is after N steps, and when to re-home."""
    from stickslip_fit.moves import where_after
    from stickslip_fit.report.text import whereabouts_text
    from stickslip_fit.units import to_si

    arm = arm_of(calibration, machine, session, theta, psi, condition)
    found = where_after(arm, positions(at, "--at"), [drive_of(text, "--drive") for text in drive])
    print(whereabouts_text(arm, found, to_si(tolerance, "µm")))
    _tell_of(arm.result, arm.conditions)


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


def _fit(
    paths: list[Path],
    machine: Path | None,
    since: str | None,
    until: str | None,
    how: Estimator,
    outputs: Outputs,
) -> None:
    refuse(how, outputs)
    found = estimate(log_of(paths, machine, since, until), how)
    print(found.text)
    if saved := save(found, outputs):
        print("\n" + "\n".join(saved))


def _tell_of(result: Result, conditions: Mapping[str, float]) -> None:
    from stickslip_fit.moves.conditions import conditions_text

    if told := conditions_text(result, conditions, "--condition"):
        print("\n" + told)


def _write_report(
    log: Log, output: Path, causes: Sequence[Cause] = (), diagnosis: Diagnosis | None = None
) -> Path:
    from stickslip_fit.files import write_atomically
    from stickslip_fit.fit import closed_form, constant_step, least_squares
    from stickslip_fit.report import report_html

    best = least_squares(log, causes=causes, command=command())
    calibration = closed_form(log, causes_from=best if causes else None, command=command())
    constant = constant_step(log, calibration)
    page = report_html(log, calibration, constant, best, diagnosis=diagnosis, command=command())
    write_atomically(output, page)
    return output
