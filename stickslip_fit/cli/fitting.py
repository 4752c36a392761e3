"""Verbs that estimate the laws' parameters, and what they predict."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit.cli.arguments import fitted_of, log_of, plan_conditions_of
from stickslip_fit.cli.estimating import Estimator, Outputs, estimate, refuse, save
from stickslip_fit.cli.moving import tell_of_conditions
from stickslip_fit.cli.options import (
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
    Session,
    Since,
    Until,
)
from stickslip_fit.files import check_folder


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
    if output is not None:
        write_atomically(output, predictions_csv(planned, predicted))
    print(predictions_text(result, planned, predicted))
    tell_of_conditions(result, conditions)
    if output is not None:
        print(f"\nall {len(predicted):,} written to {output}")


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
    saved = save(found, outputs)
    print("\n\n".join(filter(None, [found.text, "\n".join(saved)])))
