"""Commands that fit laws: calibrate, fit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stickslip_fit._progress import show_progress
from stickslip_fit.cli._files import Output
from stickslip_fit.cli._options import (
    CauseNames,
    CausesFrom,
    Chart,
    Json,
    LawNames,
    LogSource,
    Method,
    check_chart,
    check_savable,
    command_line,
    load_causes,
    load_laws,
    parse_bound,
    parse_repeatabilities,
)
from stickslip_fit.cli._show import Display, save_chart, save_json, show
from stickslip_fit.errors import InputError, InputIssue, suggest

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from stickslip_fit._summary import Summary
    from stickslip_fit.bayes import Posterior
    from stickslip_fit.causes import Cause
    from stickslip_fit.estimation import Result
    from stickslip_fit.estimation.profile import ComparableFit
    from stickslip_fit.logs import Log


@dataclass(frozen=True)
class EstimatorOptions:
    """Options of `fit`, as typed.

    Attributes
    ----------
    heavy_tails, profile : bool
        Of least squares, as are the next three.
    campaign_wide : tuple of str
        Parameters that all sessions share.
    bounds : tuple of str
        NAME=LOW:HIGH.
    repeatability : tuple of str
        PERCENT or JOINT±=PERCENT.
    chains : Path or None
        Of Bayes.
    causes : tuple of str
        Names of causes to fit with the laws; not by the closed form.
    causes_from : Path or None
        Of the closed form or least squares: a saved result whose causes are known.
    laws : mapping of int to law
        Laws of one's own, by joint.
    own_causes : tuple of Cause
        Causes of one's own, beside those of the library.
    """

    method: Method
    heavy_tails: bool = False
    profile: bool = False
    campaign_wide: tuple[str, ...] = ()
    bounds: tuple[str, ...] = ()
    repeatability: tuple[str, ...] = ()
    seed: int = 0
    chains: Path | None = None
    causes: tuple[str, ...] = ()
    causes_from: Path | None = None
    laws: Mapping[int, Any] = field(default_factory=dict)
    own_causes: tuple[Cause, ...] = ()


@dataclass(frozen=True)
class FitOutputs:
    """Files to write beside what is printed: the result, its control chart, the posterior's tree."""

    json: Path | None = None
    chart: Path | None = None
    tree: Path | None = None


def result_path(tree: Path) -> Path:
    """The result, beside the draws that it sums up."""
    return tree.with_suffix(".json")


@dataclass(frozen=True, eq=False)
class Estimate:
    """A result, its summary, by Bayes the posterior, and the fit whose sessions are compared."""

    result: Result
    summary: Summary
    posterior: Posterior | None = None
    comparable: ComparableFit | None = None


def check_fit_options(options: EstimatorOptions, outputs: FitOutputs) -> None:
    """Refuse options that exclude each other and files that could not be written; raises InputError."""
    least_squares = options.method is Method.least_squares
    if (not least_squares and (options.heavy_tails or options.profile)) or (
        options.heavy_tails and options.profile
    ):
        raise InputError("--profile and --heavy-tails are alternatives of --method least-squares; choose one")
    for option, method, value in (
        ("--campaign-wide", Method.least_squares, options.campaign_wide),
        ("--bound", Method.least_squares, options.bounds),
        ("--repeatability", Method.least_squares, options.repeatability),
        ("--chains", Method.bayes, options.chains),
        ("--tree", Method.bayes, outputs.tree),
    ):
        if value and options.method is not method:
            raise InputError(f"{option} belongs to --method {method.value}")
    if options.causes and options.method is Method.closed_form:
        raise InputError("the closed form fits no cause; take those of a saved result by --causes-from")
    if options.causes_from is not None:
        if options.method is Method.bayes:
            raise InputError("--causes-from belongs to the closed form and to least squares")
        others = {
            "--cause": options.causes,
            "--campaign-wide": options.campaign_wide,
            "--profile": options.profile,
        }
        for option in (name for name, value in others.items() if value):
            raise InputError(f"--causes-from and {option} are alternatives; choose one")
    check_chart(outputs.chart)
    if outputs.tree is not None and outputs.tree.suffix != ".nc":
        message = "is netCDF: end its name in .nc"
        raise InputError(InputIssue(message, column="--tree", value=str(outputs.tree)))


def estimate_laws(log: Log, options: EstimatorOptions) -> Estimate:
    """Fit a log and format the result."""
    from stickslip_fit.estimation import fit_closed_form, fit_least_squares, load_result
    from stickslip_fit.estimation.noise import Gaussian, StudentT
    from stickslip_fit.estimation.prediction import (
        describe_excess_scatter,
        format_latest_control,
        has_order,
        latest_control,
    )
    from stickslip_fit.estimation.profile import make_comparable
    from stickslip_fit.laws import choose_laws

    if options.method is Method.bayes:
        return _fit_bayes(log, options)
    known = None
    if options.causes_from is not None:
        known = load_result(options.causes_from, options.own_causes, laws=options.laws)
    if options.method is Method.closed_form:
        result = fit_closed_form(log, laws=options.laws, causes_from=known, command=command_line())
    else:
        likelihood = StudentT() if options.heavy_tails else Gaussian()
        laws = choose_laws(log.usable, log.machine, options.laws).values() if options.bounds else ()
        repeatabilities = parse_repeatabilities(options.repeatability, "--repeatability", log.machine.joints)
        with show_progress() as progress:
            result = fit_least_squares(
                log,
                laws=options.laws,
                causes=select_named_causes(options.causes, log, options.own_causes),
                causes_from=known,
                likelihood=likelihood,
                shared=options.campaign_wide,
                bounds=dict(parse_bound(text, "--bound", laws) for text in options.bounds),
                repeatability=repeatabilities,
                command=command_line(),
                progress=progress,
            )
    summary, comparable = result.summary(), None
    if options.method is Method.least_squares and has_order(result):
        comparable = make_comparable(log, result)
        if comparable.note:
            control = format_latest_control(latest_control(comparable.fit))
            summary = replace(summary, headline=(f"{control}\n{comparable.note}",))
    if hint := describe_excess_scatter(log, result):
        summary = replace(summary, headline=(hint, *summary.headline))
    if options.profile:
        from stickslip_fit.estimation._summary import describe_profile, profile_section
        from stickslip_fit.estimation.least_squares import profile_intervals

        profile = profile_intervals(log, result)
        summary = replace(
            summary,
            headline=(describe_profile(profile), *summary.headline),
            sections=(*summary.sections, profile_section(profile)),
        )
    return Estimate(result, summary, comparable=comparable)


def select_named_causes(names: Iterable[str], log: Log, own: Iterable[Cause] = ()) -> tuple[Cause, ...]:
    """The causes of the library, the log's own columns and one's own causes, with these names.

    Raises
    ------
    InputError
        For an unknown name and for a cause that the log cannot show, with those that it can.
    """
    from stickslip_fit.causes import covariates, explain_missing, library

    rows = log.usable
    known = {cause.name: cause for cause in (*library(), *covariates(rows), *own)}
    reasons = {name: explain_missing(cause, rows, log.machine) for name, cause in known.items()}
    missing = {name: reason for name, reason in reasons.items() if reason is not None}
    missing["end-stop-misfire"] = "it changes no expected count; misfires are met by --heavy-tails"
    names = list(dict.fromkeys(names))
    issues = [
        InputIssue(
            missing.get(name, f"is no cause that is known{suggest(name, known)}"),
            column="--cause",
            value=name,
        )
        for name in names
        if name not in known or name in missing
    ]
    if issues:
        possible = ", ".join(name for name in known if name not in missing)
        raise InputError([*issues, InputIssue(f"this log can show {possible}")])
    return tuple(known[name] for name in names)


def save_fit_outputs(estimate: Estimate, outputs: FitOutputs) -> list[str]:
    """Write the requested files; a line for each."""
    lines = save_json(estimate.result.save, outputs.json)
    if outputs.tree is not None and estimate.posterior is not None:
        estimate.posterior.save(outputs.tree)
        lines.append(f"draws saved to {outputs.tree}, their result to {result_path(outputs.tree)}")
    if outputs.chart is not None:
        from stickslip_fit.plotting.parameters import plot_control

        charted = estimate.comparable.fit if estimate.comparable else estimate.result
        lines += save_chart(partial(plot_control, charted), outputs.chart, "control", "control chart")
    return lines


def _fit_bayes(log: Log, options: EstimatorOptions) -> Estimate:
    import sys

    from stickslip_fit.bayes import fit_bayes
    from stickslip_fit.bayes.checks import checks_section

    watched = sys.stderr.isatty()
    causes = select_named_causes(options.causes, log, options.own_causes)
    posterior = fit_bayes(
        log,
        laws=options.laws,
        causes=causes,
        seed=options.seed,
        backend=options.chains,
        progress=watched,
        command=command_line(),
    )
    summary = posterior.summary()
    summary = replace(summary, sections=(*summary.sections, checks_section(posterior)))
    return Estimate(posterior.result, summary, posterior)


def calibrate(
    *,
    law: LawNames = None,
    source: LogSource,
    causes_from: CausesFrom = None,
    json: Json = None,
    chart: Chart = None,
    display: Display,
) -> None:
    """Calibrate each session from its first few traverses."""
    options = EstimatorOptions(Method.closed_form, causes_from=causes_from)
    outputs = FitOutputs(json, chart)
    _fit_and_show(source, law, options, outputs, display)


def fit(
    *,
    method: Annotated[Method, typer.Option(help="Estimator.")] = Method.least_squares,
    law: LawNames = None,
    source: LogSource,
    json: Json = None,
    chart: Chart = None,
    cause: CauseNames = None,
    causes_from: CausesFrom = None,
    heavy_tails: Annotated[
        bool,
        typer.Option("--heavy-tails", help="Least squares: Student's t, robust against misdetected stops."),
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
    chains: Annotated[
        Path | None,
        typer.Option(help="Bayes: HDF5 file of the MCMC chains; the same call continues them."),
        Output(),
    ] = None,
    tree: Annotated[
        Path | None,
        typer.Option(help="Bayes: also save the draws here, netCDF (.nc) that ArviZ reads."),
        Output(beside=(result_path,)),
    ] = None,
    display: Display,
) -> None:
    """Fit the laws' parameters for each session and direction."""
    terms = (tuple(campaign_wide or ()), tuple(bound or ()), tuple(repeatability or ()))
    causes = (tuple(cause or ()), causes_from)
    options = EstimatorOptions(method, heavy_tails, profile, *terms, seed, chains, *causes)
    outputs = FitOutputs(json, chart, tree)
    _fit_and_show(source, law, options, outputs, display)


def _fit_and_show(
    source: LogSource,
    law: list[Path] | None,
    options: EstimatorOptions,
    outputs: FitOutputs,
    display: Display,
) -> None:
    check_fit_options(options, outputs)
    log = source.read()
    options = replace(options, laws=load_laws(law, log.joints), own_causes=load_causes(law))
    check_savable(log, options.laws, outputs.json or outputs.tree)
    estimate = estimate_laws(log, options)
    saved = save_fit_outputs(estimate, outputs)
    show(estimate.summary, display, source.log, saved)
