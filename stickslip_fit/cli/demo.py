"""The demonstration: an effect hidden in a simulated campaign is found, and nothing in another."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit._io import make_folder, write_atomically
from stickslip_fit._progress import show_progress
from stickslip_fit.cli._files import INPUT, read_template
from stickslip_fit.cli._options import (
    MachinePath,
    command_line,
    default_output,
    has_browser,
    load_log,
    parse_path,
    reference_law,
)
from stickslip_fit.cli._show import Display, show
from stickslip_fit.cli.diagnose import diagnose_with_progress

if TYPE_CHECKING:
    from stickslip_fit._summary import Summary
    from stickslip_fit.diagnosis import Diagnosis
    from stickslip_fit.logs import Log
    from stickslip_fit.logs.plan import Plan

FOLDER = Path("reports", "demo")
HIDDEN = """
# Hidden in the demonstration's first campaign:
[[cause]]
name = "thermal-warm-up"
A = "3 %"
tau = "40 min"
"""


def demo(
    log: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG", parser=parse_path, help="Two simulated campaigns without it."),
        INPUT,
    ] = None,
    machine: MachinePath = None,
    browse: Annotated[bool, typer.Option(help="Open the report in a browser where there is one.")] = True,
) -> None:
    """Find an effect hidden in a simulated campaign, step by step; or calibrate and report a log."""
    report = report_log(log, machine) if log else find_hidden_effect()
    if browse and has_browser():
        import webbrowser

        webbrowser.open(report.resolve().as_uri())


def report_log(log: list[Path], machine: Path | None) -> Path:
    """Check, calibrate and report a log; the report's file."""
    from stickslip_fit.estimation import fit_closed_form
    from stickslip_fit.reporting import report as make_report

    campaign = load_log(log, machine)
    show(campaign.summary(), Display())
    calibration = fit_closed_form(campaign, command=command_line())
    print()
    show(calibration.summary(), Display())
    written = default_output(log).resolve()
    with show_progress() as progress:
        page = make_report(
            campaign, calibration=calibration, sections=(), command=command_line(), progress=progress
        )
    page.save(written)
    print(f"\nreport written to {written}")
    for verb, what in (("diagnose", "what is wrong, and why"), ("report", "the whole report")):
        print(f"{what}: {shlex.join(['stickslip-fit', verb, *map(str, log)])}")
    return written


def find_hidden_effect() -> Path:
    """Simulate a campaign with an effect and one without, and diagnose both; the report's file."""
    from stickslip_fit.estimation import fit_closed_form
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.reporting import report as make_report

    for folder in (FOLDER.parent, FOLDER):
        make_folder(folder)
    plan, law, changed = (FOLDER / name for name in ("plan.toml", "law.toml", "hidden-law.toml"))
    hidden, nothing = FOLDER / "campaign.csv", FOLDER / "nothing-hidden.csv"
    true_law = reference_law().read_text("utf-8")
    example = read_template("plan_example.toml")
    for path, text in ((plan, example), (law, true_law), (changed, true_law + HIDDEN)):
        write_atomically(path, text)
    machine = load_machine()
    planned = read_plan(plan, machine)

    _tell(
        "1. A campaign is simulated. Something is hidden in it.",
        "simulate",
        plan,
        "--law",
        changed,
        "-o",
        hidden,
    )
    campaign = _simulate(planned, changed, hidden)
    _tell("2. What does the log hold?", "check", hidden)
    _print(campaign.summary())
    _tell("3. Each session is calibrated from its first few traverses.", "calibrate", hidden)
    calibration = fit_closed_form(campaign, command=command_line())
    _print(calibration.summary(), tables=1)
    extended, page = FOLDER / "law.json", FOLDER / "report.html"
    _tell("4. What does the law get wrong, and why?", "diagnose", hidden, "--save-law", extended)
    diagnosis = diagnose_with_progress(campaign)
    _print(diagnosis.summary(), tables=2)
    diagnosis.extended_law(command=command_line()).save(extended)
    print(f"\nThe law extended by what was found is in {extended}. It predicts the next campaign:")
    print(f"$ {shlex.join(['stickslip-fit', 'predict', str(extended), str(plan)])}")
    _tell("5. All of it on one page.", "report", hidden, "-o", page)
    with show_progress() as progress:
        make_report(
            campaign,
            calibration=calibration,
            diagnosis=diagnosis,
            sections=(),
            command=command_line(),
            progress=progress,
        ).save(page)
    print(f"report written to {page}")
    _tell("6. The same campaign, and nothing hidden.", "simulate", plan, "--law", law, "-o", nothing)
    control = _simulate(planned, law, nothing)
    _tell("7. A diagnosis that finds something in every log would be worth nothing.", "diagnose", nothing)
    without = diagnose_with_progress(control)
    _print(without.summary())
    print(f"\n8. What was hidden? The end of {changed}:{HIDDEN.rstrip()}")
    print(
        f"Found in the first campaign: {_name_findings(diagnosis)}. In the second: {_name_findings(without)}."
    )
    print("\nYour own log: stickslip-fit diagnose my-log.csv")
    return page


def _tell(sentence: str, *words: str | Path) -> None:
    """A step, and the command that does it."""
    print(f"\n{sentence}\n$ {shlex.join(['stickslip-fit', *map(str, words)])}", flush=True)


def _print(summary: Summary, tables: int = 0) -> None:
    """The headline, and the first tables."""
    from stickslip_fit._summary import paragraph

    for text in summary.headline:
        print(paragraph(text))
    for table in summary.tables[:tables]:
        print(f"\n{table.as_text()}")


def _simulate(plan: Plan, law: Path, path: Path) -> Log:
    """Simulate a campaign, write its log and read it again."""
    from stickslip_fit.logs import write_log
    from stickslip_fit.machine import load_machine
    from stickslip_fit.simulation import read_law_values, simulate

    machine = load_machine()
    write_log(simulate(plan, read_law_values(law, machine), machine), path)
    log = load_log([path], None)
    print(f"{len(log.rows):,} simulated traverses written to {path}")
    return log


def _name_findings(diagnosis: Diagnosis) -> str:
    from stickslip_fit.diagnosis._unknown_summary import name_findings

    names: Sequence[str] = name_findings(diagnosis.findings)
    return ", ".join(names) or "nothing"
