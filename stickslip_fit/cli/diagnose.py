"""Commands that analyze a log: anova, diagnose, plan."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stickslip_fit._io import write_atomically
from stickslip_fit._json import write_json
from stickslip_fit._progress import show_progress
from stickslip_fit.cli._files import INPUT, Output, write_template
from stickslip_fit.cli._options import (
    Alpha,
    ExtendedLawPath,
    Force,
    Json,
    LawNames,
    LogSource,
    MachinePath,
    ReportPath,
    Seed,
    Sheet,
    Since,
    Until,
    check_chart,
    check_savable,
    command_line,
    load_causes,
    load_law_values,
    load_laws,
    load_log,
    parse_path,
    parse_table_law,
    reference_law,
)
from stickslip_fit.cli._show import Display, save_chart, save_json, show
from stickslip_fit.errors import InputError, InputIssue

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from stickslip_fit._summary import Summary
    from stickslip_fit.causes import Cause
    from stickslip_fit.causes.law_file import LawsAndCauses
    from stickslip_fit.diagnosis import Diagnosis
    from stickslip_fit.estimation import Result, TableFit
    from stickslip_fit.logs import Log
    from stickslip_fit.logs.plan import Plan
    from stickslip_fit.machine import Machine
    from stickslip_fit.simulation import LawValues


def anova(
    *,
    joint: Annotated[int | None, typer.Option(min=1, help="This joint only.")] = None,
    session: Annotated[str | None, typer.Option(help="This session only.")] = None,
    formula: Annotated[
        str | None, typer.Option(help="A model formula, e.g. 'step_size ~ C(session) * direction'.")
    ] = None,
    kind: Annotated[
        int, typer.Option("--type", min=1, max=3, help="Formula: type of the sums of squares.")
    ] = 2,
    source: LogSource,
    json: Json = None,
    display: Display,
) -> None:
    """Analyse the variance: day, direction, configuration, normal force, position; or a formula's terms."""
    from stickslip_fit._summary import join_summaries
    from stickslip_fit.anova import analyze_formula, analyze_variance, save_records

    campaign = source.read()
    if formula is None:
        with show_progress() as progress:
            result = analyze_variance(campaign, joint=joint, session=session, progress=progress)
        summary, records = result.summary(), result.to_json()
    else:
        tables = analyze_formula(campaign, formula, joint=joint, session=session, kind=kind)
        summary = join_summaries(formula, [table.summary() for table in tables])
        records = [record for table in tables for record in table.to_json()]
    saved = save_json(partial(save_records, records), json)
    show(summary, display, source.log, saved)


def diagnose(
    *,
    json: Json = None,
    report: ReportPath = None,
    save_law: ExtendedLawPath = None,
    alpha: Alpha = 0.01,
    seed: Seed = 0,
    law: LawNames = None,
    source: LogSource,
    display: Display,
) -> None:
    """Test the laws against a log, name the causes of a misfit, and measure what modelling them gains."""
    try:
        campaign = source.read()
    except InputError as error:
        raise InputError([*error.problems, *suggest_table_command(source.log[0], source.sheet)]) from None
    laws = load_laws(law, campaign.joints)
    check_savable(campaign, laws, save_law)
    result = diagnose_with_progress(campaign, alpha, seed, laws, load_causes(law))
    # Saved before anything is printed: the reader of the output may close it.
    saved = save_diagnosis_outputs(result, json, report)
    extended = save_extended_law(result.extended_law(command=command_line()), save_law) if save_law else ""
    following = "" if save_law else suggest_next(result, partial(source.command, law=law))
    show(result.summary(), display, source.log, filter(None, [*saved, extended, following]))


def suggest_table_command(path: Path, sheet: str | None) -> list[InputIssue]:
    """The command for a file that is a table, and no log: it has neither joints nor steps."""
    from stickslip_fit._expression import is_name
    from stickslip_fit.logs.table_file import read_table_file

    try:
        frame = read_table_file(path, sheet).frame
    except InputError:
        return []
    names = [str(name) for name in frame if frame[name].dtype.kind in "if"]
    if {"joint", "steps"} & set(map(str, frame)) or not names:
        return []
    are_plain = len(names) > 1 and all(map(is_name, names))
    formula = f"{names[-1]} ~ a + b*{names[0]}" if are_plain else "RESPONSE ~ a + b*COLUMN"
    command = shlex.join(["stickslip-fit", "diagnose-table", str(path), "--law", formula])
    message = (
        f"has neither joints nor steps, so it is no step log. For any other table, with a law: {command}"
    )
    return [InputIssue(message, str(path))]


def suggest_next(diagnosis: Diagnosis, command: Callable[..., str]) -> str:
    """The command that goes on from a diagnosis, as `LogSource.command` writes it."""
    from stickslip_fit.diagnosis.misfit import UNKNOWN

    if any(finding.equivalent for finding in diagnosis.findings):
        return f"To separate the causes: {command('plan')}"
    if any(one.version is not None or one.cause != UNKNOWN for one in diagnosis.findings):
        return f"To save the extended law: {command('diagnose', '--save-law', 'law.json')}"
    if diagnosis.verdict == "nothing wrong":
        return f"To save the law as it is: {command('fit', '--json', 'fit.json')}"
    return f"For traverses that would tell more: {command('plan')}"


def diagnose_table(
    *,
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA",
            parser=parse_path,
            help="Table: CSV, Excel or Parquet, a row for each measurement.",
        ),
        INPUT,
    ],
    law: Annotated[
        Path,
        typer.Option(
            metavar="FORMULA|FILE",
            parser=parse_table_law,
            help="Formula such as 'y ~ a + b*x', or law file (TOML): formula, units, roles of columns, "
            "causes of your own.",
        ),
        INPUT,
    ],
    session: Annotated[
        str | None, typer.Option(help="Column: rows with equal values share the law's own parameters.")
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(help="Column of times or seconds; 'order': rows are in order of measurement."),
    ] = None,
    position: Annotated[str | None, typer.Option(help="Column: where it stands.")] = None,
    direction: Annotated[str | None, typer.Option(help="Column: which way it moves.")] = None,
    group: Annotated[
        str | None, typer.Option(help="Column: what belongs together, held out as a whole.")
    ] = None,
    sigma: Annotated[
        str | None, typer.Option(help="Column: uncertainty of the response, by which rows are weighted.")
    ] = None,
    json: Json = None,
    report: ReportPath = None,
    save_law: ExtendedLawPath = None,
    sheet: Sheet = None,
    alpha: Alpha = 0.01,
    seed: Seed = 0,
    display: Display,
) -> None:
    """Test a law of your own on any table, name the causes of a misfit, and measure what they gain.

    An example, with the columns t, vel, acc and F in bench.csv:

    stickslip-fit diagnose-table bench.csv --law 'F ~ M*acc + Fv*vel + Fc*sign(vel)' --time t

    A law file has units and causes as well, and roles of columns under [roles], which options replace.
    """
    from stickslip_fit.diagnosis import diagnose_table as diagnose

    file = load_table_law(law)
    given = {"session": session, "time": time, "position": position, "direction": direction}
    given |= {"group": group, "sigma": sigma}
    roles: dict[str, Any] = {**file.roles}
    roles |= {role: column for role, column in given.items() if column is not None}
    with show_progress() as progress:
        result = diagnose(
            data,
            file.law,
            causes=file.causes,
            sheet=sheet,
            alpha=alpha,
            seed=seed,
            progress=progress,
            **roles,
        )
    saved = save_diagnosis_outputs(result, json, report)
    if save_law is not None:
        result.extended_law(command=command_line()).save(save_law)
        saved.append(f"law ({describe_extension(result)}) saved to {save_law}")
    read = [path for path in (data, law) if isinstance(path, Path)]
    show(result.summary(), display, read, saved)


def load_table_law(law: Path | str) -> LawsAndCauses:
    """The law of a table, and what its file has beside it; a formula has nothing beside it."""
    from stickslip_fit.causes.law_file import LawsAndCauses, read_law_file
    from stickslip_fit.laws import Law

    if isinstance(law, str):
        return LawsAndCauses(law=Law(law), laws={}, causes=(), roles={})
    file = read_law_file(law)
    if file.law is None:
        message = "has laws of a log's joints alone; give the table's law as formula, above all [tables]"
        raise InputError(InputIssue(message, str(law)))
    return file


def describe_extension(diagnosis: Diagnosis) -> str:
    """Whether the law was extended, and by what."""
    from stickslip_fit.diagnosis._unknown_summary import name_findings

    names = name_findings([finding for finding in diagnosis.findings if finding.version is not None])
    return f"extended by {', '.join(names)}" if names else "as it was: nothing was found that extends it"


class ThesisPlan(StrEnum):
    """Procedures of the thesis, as plans that can be run."""

    calibration = "calibration"
    prismatic = "prismatic"
    rotary = "rotary"


def plan(
    *,
    source: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="LOG|PLAN", parser=parse_path, help="A campaign log, or the plan of a campaign (TOML)."
        ),
        INPUT,
    ] = None,
    law: Annotated[
        list[Path] | None,
        typer.Option(
            "--law",
            metavar="[JOINT=]LAW",
            parser=parse_path,
            help="Of a log: a law of your own, as of `fit`. Of a plan: law file (TOML) or saved result; "
            "typical values without it.",
        ),
        INPUT,
    ] = None,
    machine: MachinePath = None,
    since: Since = None,
    until: Until = None,
    sheet: Sheet = None,
    alpha: Alpha = 0.01,
    seed: Seed = 0,
    json: Json = None,
    chart: Annotated[
        Path | None,
        typer.Option("--chart", help="Of a plan: also draw which causes are confused: .png, .svg or .pdf."),
        Output(),
    ] = None,
    thesis: Annotated[
        ThesisPlan | None,
        typer.Option(
            help="Instead: a plan that follows the thesis, of its calibration (6.1, 6.2) or of its "
            "experiments on joint 3 (prismatic, 4.3) or joint 2 (rotary, 5.3, 5.4)."
        ),
    ] = None,
    example: Annotated[
        bool, typer.Option("--example", help="Instead: a short plan with comments, to be changed.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Of --thesis, --example: plan to write; printed without it."),
        Output(permits=("force",)),
    ] = None,
    force: Force = False,
    display: Display,
) -> None:
    """Propose the most informative next traverses; of a plan, say which causes it could distinguish."""
    if thesis is not None or example:
        option = "--thesis" if thesis is not None else "--example"
        given: dict[str, object] = {"LOG|PLAN": source, "--law": law, "--chart": chart, "--json": json}
        given |= {"--example": example} if thesis is not None else {}
        if others := [name for name, value in given.items() if value]:
            raise InputError(f"{option} makes a plan, and takes no {', '.join(others)}")
        write_template(f"plan_{thesis or 'example'}.toml", output, "plan")
        return
    if not source:
        raise InputError("name a LOG or a PLAN; --example or --thesis writes a plan to begin with")
    if output is not None:
        raise InputError("--output is for --thesis and --example; save proposed traverses with --json")
    check_plan_options(source, {"--chart": chart}, {"--since": since, "--until": until, "--sheet": sheet})
    check_chart(chart)
    if is_plan(source):
        from stickslip_fit.logs.plan_reader import read_plan
        from stickslip_fit.machine import load_machine

        geometry = load_machine(machine)
        planned = read_plan(source[0], geometry)
        if law and len(law) > 1:
            raise InputError("give one --law: of a plan it is a law file or a saved result")
        truth = load_law_values(law[0] if law else reference_law(), geometry, planned)
        advice = advise_before_data(planned, truth, geometry, alpha, seed)
    else:
        campaign = load_log(source, machine, since, until, sheet)
        advice = advise_after_log(campaign, alpha, seed, load_laws(law, campaign.joints))
    saved = save_json(partial(write_json, content=advice.content), json)
    if advice.draw is not None:
        saved += save_chart(advice.draw, chart, "separability")
    show(advice.summary, display, source, saved)


def diagnose_with_progress(
    log: Log,
    alpha: float = 0.01,
    seed: int = 0,
    laws: Mapping[int, Any] | None = None,
    own_causes: tuple[Cause, ...] = (),
) -> Diagnosis:
    """Diagnose a log, with a progress bar at a terminal; candidates are one's own causes, too."""
    from stickslip_fit.causes import covariates, library
    from stickslip_fit.diagnosis import diagnose

    candidates = (*library(), *covariates(log.usable), *own_causes) if own_causes else None
    with show_progress() as progress:
        return diagnose(log, laws=laws, causes=candidates, alpha=alpha, seed=seed, progress=progress)


def save_extended_law(law: Result | TableFit, path: Path) -> str:
    """Write the law of a log; a line on its causes."""
    from stickslip_fit.causes import ExtendedLaw
    from stickslip_fit.estimation import Result

    assert isinstance(law, Result)
    law.save(path)
    extended = next(iter(law.joints.values())).law
    causes = extended.causes if isinstance(extended, ExtendedLaw) else ()
    names = ", ".join(cause.name for cause in causes)
    kind = f"extended by {names}" if names else "as it was: nothing was found that extends it"
    return f"law ({kind}) saved to {path}"


def save_diagnosis_outputs(diagnosis: Diagnosis, json_path: Path | None, report: Path | None) -> list[str]:
    """Write the requested files; a line for each."""
    from stickslip_fit.diagnosis import save_diagnosis

    saved = save_json(partial(save_diagnosis, diagnosis), json_path)
    if report is not None:
        from stickslip_fit.reporting.page import diagnosis_page

        write_atomically(report, diagnosis_page(diagnosis, command=command_line()))
        saved.append(f"report written to {report}")
    return saved


NEXT_SCHEMA = "stickslip-fit/next/1"


@dataclass(frozen=True, eq=False)
class PlanAdvice:
    """Its summary, JSON content, and the figure of a plan."""

    summary: Summary
    content: dict[str, Any]
    draw: Callable[[], Figure] | None = None


def is_plan(paths: list[Path]) -> bool:
    """Whether a plan is named, and not a log."""
    return len(paths) == 1 and paths[0].suffix.lower() == ".toml"


def check_plan_options(paths: list[Path], of_plan: dict[str, object], of_log: dict[str, object]) -> None:
    """Refuse options that belong to the other kind of file; raises InputError."""
    other, kind = (of_log, "a log") if is_plan(paths) else (of_plan, "a plan")
    for option, value in other.items():
        if value is not None:
            raise InputError(f"{option} belongs to {kind}; leave it out here")


def advise_after_log(log: Log, alpha: float, seed: int, laws: Mapping[int, Any] | None = None) -> PlanAdvice:
    """The most informative next traverses."""
    from stickslip_fit.diagnosis import diagnose, next_experiment
    from stickslip_fit.diagnosis._design_summary import summarize_next
    from stickslip_fit.diagnosis._json import traverse_to_json
    from stickslip_fit.diagnosis.experiments import find_inseparable_pairs, suggest_traverses

    with show_progress() as progress:
        diagnosis = diagnose(log, laws=laws, alpha=alpha, seed=seed, gain=False, progress=progress)
    traverses = next_experiment(diagnosis)
    inseparable = find_inseparable_pairs(diagnosis.findings, traverses)
    suggestions = suggest_traverses(diagnosis)
    content = {
        "schema": NEXT_SCHEMA,
        "log": {"file": Path(diagnosis.log_file).name, "sha256": diagnosis.log_sha256},
        "verdict": diagnosis.verdict,
        "next_experiment": [traverse_to_json(traverse) for traverse in traverses],
        "out_of_reach": [list(pair) for pair in inseparable],
        "untestable": [
            {
                "cause": suggestion.cause,
                "reason": suggestion.reason,
                "shows_best": suggestion.shows_best,
                "traverse": suggestion.traverse and traverse_to_json(suggestion.traverse),
            }
            for suggestion in suggestions
        ],
    }
    return PlanAdvice(summarize_next(diagnosis, traverses, inseparable, suggestions), content)


def advise_before_data(plan: Plan, truth: LawValues, machine: Machine, alpha: float, seed: int) -> PlanAdvice:
    """Which causes a plan could detect and distinguish."""
    import numpy as np

    from stickslip_fit.diagnosis._design_summary import SHOWN_AT, summarize_plan
    from stickslip_fit.diagnosis.pipeline import bootstrap_size
    from stickslip_fit.diagnosis.separability import assess_design, problem_from_plan, separability_to_json

    problem, untestable = problem_from_plan(plan, truth, machine)
    separability = assess_design(
        problem, untestable, alpha, bootstrap_size(alpha), np.random.default_rng(seed)
    )

    def draw() -> Figure:
        from stickslip_fit.plotting.diagnosis import plot_separability

        return plot_separability(separability, SHOWN_AT)

    summary = summarize_plan(separability, plan.name, len(problem), len(plan.sessions))
    return PlanAdvice(summary, {"plan": plan.name} | separability_to_json(separability, SHOWN_AT), draw)
