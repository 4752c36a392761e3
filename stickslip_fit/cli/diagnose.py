"""Commands that analyze a log: anova, diagnose, plan."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stickslip_fit._io import check_folder, write_atomically
from stickslip_fit.cli._options import (
    Json,
    LogPath,
    MachinePath,
    Since,
    Until,
    command_line,
    load_law_values,
    load_log,
    reference_law,
)
from stickslip_fit.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from stickslip_fit.diagnosis import Diagnosis
    from stickslip_fit.estimation import Result
    from stickslip_fit.logs import Log
    from stickslip_fit.logs.plan import Plan
    from stickslip_fit.machine import Machine
    from stickslip_fit.simulation import LawValues


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
    from stickslip_fit.anova import analyze_formula as by_formula
    from stickslip_fit.anova import analyze_variance, save_records

    if json is not None:
        check_folder(json)
    campaign = load_log(log, machine, since, until)
    if formula is None:
        found = analyze_variance(campaign, joint=joint, session=session)
        text, records = found.summary().as_text(full=True), found.to_json()
    else:
        tables = by_formula(campaign, formula, joint=joint, session=session, kind=kind)
        text = "\n\n".join(map(str, tables))
        records = [record for table in tables for record in table.to_json()]
    if json is not None:
        save_records(records, json)
        text += f"\n\nsaved to {json}"
    print(text)


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
    check_diagnosis_outputs(json, report, save_law)
    campaign = load_log(log, machine, since, until)
    found = diagnose_with_progress(campaign, alpha, seed)
    # Saved before anything is said: whoever reads the answer may stop reading.
    saved = save_diagnosis_outputs(found, json, report)
    law = save_extended_law(fit_extended_law(campaign, found), save_law) if save_law else ""
    print("\n\n".join(filter(None, [str(found), "\n".join(saved), law])))


def plan(
    source: Annotated[
        list[Path],
        typer.Argument(metavar="LOG|PLAN", help="A campaign log, or the plan of a campaign (TOML)."),
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
    check_plan_options(source, {"--law": law, "--chart": chart}, {"--since": since, "--until": until})
    check_plan_outputs(json, chart)
    if is_plan(source):
        from stickslip_fit.logs.plan_reader import read_plan
        from stickslip_fit.machine import load_machine

        chosen = load_machine(machine)
        planned = read_plan(source[0], chosen)
        truth = load_law_values(law or reference_law(), chosen, planned)
        found = advise_before_data(planned, truth, chosen, alpha, seed)
    else:
        found = advise_after_log(load_log(source, machine, since, until), alpha, seed)
    saved = save_plan_outputs(found, json, chart)
    print("\n\n".join(filter(None, [found.text, "\n".join(saved)])))


CLEAR_LINE = "\r\x1b[K"


def check_diagnosis_outputs(json_path: Path | None, report: Path | None, law: Path | None = None) -> None:
    """Refuse files that could not be written, before any work.

    Raises
    ------
    InputError
    """
    given = {"--json": json_path, "--report": report, "--save-law": law}
    for option, path in given.items():
        if path is None:
            continue
        check_folder(path)
        for other, taken in given.items():
            if other < option and taken == path:
                raise InputError(f"{other} and {option} both name {path}: give two files")


def diagnose_with_progress(log: Log, alpha: float = 0.01, seed: int = 0) -> Diagnosis:
    """Diagnose a log, telling how far that is where somebody watches."""
    from stickslip_fit._io import show_progress
    from stickslip_fit.diagnosis import diagnose

    with show_progress() as tell:
        return diagnose(log, alpha=alpha, seed=seed, progress=tell)


def fit_extended_law(log: Log, diagnosis: Diagnosis) -> Result:
    """The published laws extended by the causes that a diagnosis named, fitted to its log.

    Of causes that the log cannot tell apart it is the likeliest. Traverses in which the stop was misheard
    take no part; what is unknown has no place in a law.
    """
    from dataclasses import replace

    from stickslip_fit.estimation import fit_least_squares

    rows, usable = log.rows.copy(), log.rows.index[log.rows["status"] == "ok"]
    for each in diagnosis.findings:
        if each.traverses is not None:
            rows.loc[usable[each.traverses.index], "status"] = "excluded"
    versions = [each.version for each in diagnosis.findings if each.version is not None]
    return fit_least_squares(replace(log, rows=rows), causes=versions, command=command_line())


def save_extended_law(law: Result, path: Path) -> str:
    """Write a law; a line on what is in it."""
    from stickslip_fit.causes import ExtendedLaw

    law.save(path)
    extended = next(iter(law.joints.values())).law
    causes = extended.causes if isinstance(extended, ExtendedLaw) else ()
    names = ", ".join(cause.name for cause in causes)
    what = f"extended by {names}" if names else "published, since no cause was named"
    return f"law ({what}) saved to {path}"


def save_diagnosis_outputs(diagnosis: Diagnosis, json_path: Path | None, report: Path | None) -> list[str]:
    """Write what was asked for; a line for each file."""
    saved = []
    if json_path is not None:
        from stickslip_fit.diagnosis import save_diagnosis

        save_diagnosis(diagnosis, json_path)
        saved.append(f"saved to {json_path}")
    if report is not None:
        from stickslip_fit.reporting.diagnosis import diagnosis_page

        write_atomically(report, diagnosis_page(diagnosis, command=command_line()))
        saved.append(f"report written to {report}")
    return saved


NEXT_SCHEMA = "stickslip-fit/next/1"


@dataclass(frozen=True, eq=False)
class PlanAdvice:
    """What is printed, what is saved, and how to draw it where there is anything to draw."""

    text: str
    content: dict[str, Any]
    draw: Callable[[], Figure] | None = None


def is_plan(paths: list[Path]) -> bool:
    """Whether a plan is named, and not a log."""
    return len(paths) == 1 and paths[0].suffix.lower() == ".toml"


def check_plan_options(paths: list[Path], of_plan: dict[str, object], of_log: dict[str, object]) -> None:
    """Refuse options that belong to the other kind of file.

    Parameters
    ----------
    paths : list of Path
    of_plan, of_log : dict of str to object
        Options and their values; None where they were not given.

    Raises
    ------
    InputError
    """
    other, kind = (of_log, "a log") if is_plan(paths) else (of_plan, "a plan")
    for option, value in other.items():
        if value is not None:
            raise InputError(f"{option} belongs to {kind}; leave it out here")


def check_plan_outputs(json_path: Path | None, chart: Path | None) -> None:
    """Refuse files that could not be written, before any work.

    Raises
    ------
    InputError
    """
    for path in (json_path, chart):
        if path is not None:
            check_folder(path)
    if chart is not None:
        from stickslip_fit.plotting._style import check_suffix

        check_suffix(chart)


def advise_after_log(log: Log, alpha: float, seed: int) -> PlanAdvice:
    """The traverses worth making next."""
    from stickslip_fit.causes import covariates, library
    from stickslip_fit.diagnosis._summary import summarize_next
    from stickslip_fit.diagnosis.candidate_traverses import forecast_candidates
    from stickslip_fit.diagnosis.experiments import (
        find_inseparable_pairs,
        has_columns,
        next_experiment,
        suggest_traverses,
    )
    from stickslip_fit.diagnosis.pipeline import find_causes
    from stickslip_fit.diagnosis.result import traverse_to_json

    diagnosis = find_causes(log, alpha=alpha, seed=seed)
    problem = diagnosis.search.problem
    choices = forecast_candidates(problem, log.machine)
    traverses = next_experiment(diagnosis.search, diagnosis.findings, choices)
    beyond = find_inseparable_pairs(diagnosis.findings, traverses)
    causes = [
        cause.bind(problem.rows, log.machine) if has_columns(cause, problem.rows) else cause
        for cause in (*library(), *covariates(problem.rows))
    ]
    missed = suggest_traverses(diagnosis.untestable, causes, problem.rows, choices)
    content = {
        "schema": NEXT_SCHEMA,
        "log": {"file": Path(diagnosis.log_file).name, "sha256": diagnosis.log_sha256},
        "verdict": diagnosis.verdict,
        "next_experiment": [traverse_to_json(each) for each in traverses],
        "out_of_reach": [list(pair) for pair in beyond],
        "untestable": [
            {
                "cause": each.cause,
                "reason": each.reason,
                "shows_best": each.shows_best,
                "traverse": each.traverse and traverse_to_json(each.traverse),
            }
            for each in missed
        ],
    }
    return PlanAdvice(str(summarize_next(diagnosis, traverses, beyond, missed)), content)


def advise_before_data(plan: Plan, truth: LawValues, machine: Machine, alpha: float, seed: int) -> PlanAdvice:
    """What a plan could tell."""
    import numpy as np

    from stickslip_fit.diagnosis._summary import SHOWN_AT, summarize_plan
    from stickslip_fit.diagnosis.pipeline import bootstrap_size
    from stickslip_fit.diagnosis.separability import assess_design, problem_from_plan, separability_to_json

    problem, untestable = problem_from_plan(plan, truth, machine)
    found = assess_design(problem, untestable, alpha, bootstrap_size(alpha), np.random.default_rng(seed))

    def draw() -> Figure:
        from stickslip_fit.plotting.diagnosis import plot_separability

        return plot_separability(found, SHOWN_AT)

    summary = summarize_plan(found, plan.name, len(problem), len(plan.sessions))
    return PlanAdvice(str(summary), {"plan": plan.name} | separability_to_json(found, SHOWN_AT), draw)


def save_plan_outputs(found: PlanAdvice, json_path: Path | None, chart: Path | None) -> list[str]:
    """Write the files that were asked for; a line for each."""
    lines = []
    if json_path is not None:
        write_atomically(
            json_path, json.dumps(found.content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        )
        lines.append(f"saved to {json_path}")
    if chart is not None and found.draw is not None:
        from stickslip_fit.plotting._style import write_figure

        write_figure(found.draw(), chart, "separability")
        lines.append(f"chart written to {chart}")
    return lines
