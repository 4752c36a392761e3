"""Verbs that ask what matters, what the laws get wrong, and what to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stickslip_fit.cli.arguments import law_values_of, log_of, reference_law
from stickslip_fit.cli.options import Json, LogPath, MachinePath, Since, Until
from stickslip_fit.files import check_folder


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
    from stickslip_fit.cli import diagnosing

    diagnosing.refuse(json, report, save_law)
    campaign = log_of(log, machine, since, until)
    found = diagnosing.diagnosed(campaign, alpha, seed)
    # Saved before anything is said: whoever reads the answer may stop reading.
    saved = diagnosing.save(found, json, report)
    law = diagnosing.save_law(diagnosing.law_found(campaign, found), save_law) if save_law else ""
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
    from stickslip_fit.cli import planning

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
    saved = planning.save(found, json, chart)
    print("\n\n".join(filter(None, [found.text, "\n".join(saved)])))
