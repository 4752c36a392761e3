"""Commands that fit laws and use them: calibrate, fit, predict, steps, where."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit._io import check_folder
from stickslip_fit.cli._options import (
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
    command_line,
    load_arm,
    load_fit,
    load_log,
    parse_bound,
    parse_drive,
    parse_joint_order,
    parse_plan_conditions,
    parse_positions,
    parse_repeatabilities,
    parse_tip_position,
)
from stickslip_fit.errors import InputError, InputIssue

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from stickslip_fit.bayes import Posterior
    from stickslip_fit.causes import Cause
    from stickslip_fit.estimation import Result
    from stickslip_fit.logs import Log


@dataclass(frozen=True)
class EstimatorOptions:
    """How to fit, as the options say it.

    Attributes
    ----------
    method : Method
    heavy_tails, profile : bool
        Of least squares, as are the next three.
    campaign_wide : tuple of str
        Parameters that all sessions share.
    bounds : tuple of str
        As typed: NAME=LOW:HIGH.
    repeatability : tuple of str
        As typed: PERCENT or JOINT±=PERCENT.
    seed : int
    walks : Path or None
        Of Bayes.
    causes : tuple of str
        Names of causes to fit with the laws; not by the closed form.
    causes_from : Path or None
        Of the closed form: a saved result whose causes are known.
    """

    method: Method
    heavy_tails: bool = False
    profile: bool = False
    campaign_wide: tuple[str, ...] = ()
    bounds: tuple[str, ...] = ()
    repeatability: tuple[str, ...] = ()
    seed: int = 0
    walks: Path | None = None
    causes: tuple[str, ...] = ()
    causes_from: Path | None = None


@dataclass(frozen=True)
class FitOutputs:
    """Files to write beside what is printed: the result, its control chart, the posterior's tree."""

    json: Path | None = None
    chart: Path | None = None
    tree: Path | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """A result, what is printed of it, and by Bayes the posterior behind it."""

    result: Result
    text: str
    posterior: Posterior | None = None


def check_fit_options(how: EstimatorOptions, outputs: FitOutputs) -> None:
    """Refuse options that do not go together and files that could not be written, before any work.

    Raises
    ------
    InputError
    """
    least_squares = how.method is Method.least_squares
    if (not least_squares and (how.heavy_tails or how.profile)) or (how.heavy_tails and how.profile):
        raise InputError("--profile and --heavy-tails are two ways of --method least-squares; choose one")
    for option, texts in (
        ("--campaign-wide", how.campaign_wide),
        ("--bound", how.bounds),
        ("--repeatability", how.repeatability),
    ):
        if texts and not least_squares:
            raise InputError(f"{option} belongs to --method least-squares")
    for option, given in (("--walks", how.walks), ("--tree", outputs.tree)):
        if how.method is not Method.bayes and given is not None:
            raise InputError(f"{option} belongs to --method bayes")
    if how.causes and how.method is Method.closed_form:
        raise InputError("the closed form fits no cause; take those of a saved result by --causes-from")
    if how.causes_from is not None and how.method is not Method.closed_form:
        raise InputError("--causes-from belongs to the closed form; fit causes by --cause")
    for path in (outputs.json, outputs.chart, outputs.tree):
        if path is not None:
            check_folder(path)
    if outputs.chart is not None:
        from stickslip_fit.plotting._style import check_suffix

        check_suffix(outputs.chart)
    if outputs.tree is not None and outputs.tree.suffix != ".nc":
        raise InputError(
            InputIssue("is netCDF: end its name in .nc", column="--tree", value=str(outputs.tree))
        )


def estimate_laws(log: Log, how: EstimatorOptions) -> Estimate:
    """Fit a log and put the result into words."""
    from stickslip_fit.estimation import fit_closed_form, fit_least_squares, load_result
    from stickslip_fit.estimation.noise import Gaussian, StudentT

    if how.method is Method.bayes:
        return _fit_bayes(log, how)
    if how.method is Method.closed_form:
        known = load_result(how.causes_from) if how.causes_from else None
        result = fit_closed_form(log, causes_from=known, command=command_line())
    else:
        likelihood = StudentT() if how.heavy_tails else Gaussian()
        result = fit_least_squares(
            log,
            causes=select_named_causes(how.causes, log),
            likelihood=likelihood,
            shared=how.campaign_wide,
            bounds=dict(parse_bound(text, "--bound") for text in how.bounds),
            repeatability=parse_repeatabilities(how.repeatability, "--repeatability"),
            command=command_line(),
        )
    summary = result.summary()
    if how.profile:
        from stickslip_fit.estimation._summary import profile_section
        from stickslip_fit.estimation.least_squares import profile_intervals

        profile = profile_section(profile_intervals(log, result))
        summary = replace(summary, sections=(*summary.sections, profile))
    return Estimate(result, str(summary))


def select_named_causes(names: Iterable[str], log: Log) -> tuple[Cause, ...]:
    """The causes of the library, and the log's own columns, that are named.

    Raises
    ------
    InputError
        For a name that is none, and for a cause that the log cannot show; with those that it can.
    """
    from stickslip_fit.causes import covariates, library

    rows = log.usable
    known = {cause.name: cause for cause in (*library(), *covariates(rows))}
    missing = {name: why for name, cause in known.items() if (why := cause.missing(rows)) is not None}
    missing["end-stop-misfire"] = "it changes no expected count; misfires are met by --heavy-tails"
    names = list(dict.fromkeys(names))
    faults = [
        InputIssue(missing.get(name, "is no cause that is known"), column="--cause", value=name)
        for name in names
        if name not in known or name in missing
    ]
    if faults:
        there = ", ".join(name for name in known if name not in missing)
        raise InputError([*faults, InputIssue(f"this log can show {there}")])
    return tuple(known[name] for name in names)


def save_fit_outputs(found: Estimate, outputs: FitOutputs) -> list[str]:
    """Write the files that were asked for; a line for each."""
    lines = []
    if outputs.json is not None:
        found.result.save(outputs.json)
        lines.append(f"saved to {outputs.json}")
    if outputs.tree is not None and found.posterior is not None:
        found.posterior.save(outputs.tree)
        lines.append(f"draws saved to {outputs.tree}, their result to {outputs.tree.with_suffix('.json')}")
    if outputs.chart is not None:
        from stickslip_fit.plotting._style import write_chart

        write_chart(found.result, outputs.chart)
        lines.append(f"control chart written to {outputs.chart}")
    return lines


def _fit_bayes(log: Log, how: EstimatorOptions) -> Estimate:
    import sys

    from stickslip_fit.bayes import fit_bayes
    from stickslip_fit.bayes.checks import checks_section

    watched = sys.stderr.isatty()
    causes = select_named_causes(how.causes, log)
    posterior = fit_bayes(
        log, causes=causes, seed=how.seed, backend=how.walks, progress=watched, command=command_line()
    )
    summary = posterior.summary()
    summary = replace(summary, sections=(*summary.sections, checks_section(posterior)))
    return Estimate(posterior.result, str(summary), posterior)


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
    from stickslip_fit.moves import plan_move
    from stickslip_fit.reporting.moves import format_move

    arm = load_arm(calibration, machine, session, theta, psi, condition)
    start = parse_positions(at, "--at")
    if (tip is None) == (joints is None):
        raise InputError("say where to go: either --tip X,Y,Z (mm) or --joints Q1,Q2,Q3 (deg,deg,mm)")
    if tip is not None:
        target = nearest_solution(arm.machine, parse_tip_position(tip, "--tip"), start)
    else:
        target = parse_positions(str(joints), "--joints")
    print(format_move(arm, plan_move(arm, start, target, parse_joint_order(order, "--order"))))
    print_conditions(arm.result, arm.conditions)


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
    from stickslip_fit.moves import dead_reckon
    from stickslip_fit.reporting.moves import format_pose
    from stickslip_fit.units import to_si

    arm = load_arm(calibration, machine, session, theta, psi, condition)
    found = dead_reckon(arm, parse_positions(at, "--at"), [parse_drive(text, "--drive") for text in drive])
    print(format_pose(arm, found, to_si(tolerance, "µm")))
    print_conditions(arm.result, arm.conditions)


def print_conditions(result: Result, conditions: Mapping[str, float]) -> None:
    """Say under which conditions an extended law was taken, where it looks at any."""
    from stickslip_fit.moves.arm import describe_conditions

    if told := describe_conditions(result, conditions, "--condition"):
        print("\n" + told)


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
    how = EstimatorOptions(Method.closed_form, causes_from=causes_from)
    _fit_and_print(log, machine, since, until, how, FitOutputs(json, chart))


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
    how = EstimatorOptions(method, heavy_tails, profile, *terms, seed, walks, tuple(cause or ()), causes_from)
    _fit_and_print(log, machine, since, until, how, FitOutputs(json, chart, tree))


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
    from stickslip_fit._io import write_atomically
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.moves.prediction import predict_plan
    from stickslip_fit.reporting.moves import format_predictions, predictions_csv

    if output is not None:
        check_folder(output)
    fitted, result = load_fit(calibration, machine)
    planned = read_plan(plan, result.machine)
    conditions = parse_plan_conditions(condition, result)
    predicted = predict_plan(fitted, planned, session, conditions)
    if output is not None:
        write_atomically(output, predictions_csv(planned, predicted))
    print(format_predictions(result, planned, predicted))
    print_conditions(result, conditions)
    if output is not None:
        print(f"\nall {len(predicted):,} written to {output}")


def _fit_and_print(
    paths: list[Path],
    machine: Path | None,
    since: str | None,
    until: str | None,
    how: EstimatorOptions,
    outputs: FitOutputs,
) -> None:
    check_fit_options(how, outputs)
    found = estimate_laws(load_log(paths, machine, since, until), how)
    saved = save_fit_outputs(found, outputs)
    print("\n\n".join(filter(None, [found.text, "\n".join(saved)])))
