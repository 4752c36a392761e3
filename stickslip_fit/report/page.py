"""The report: one self-contained page made of a log and what was fitted to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd

from stickslip_fit._format import joint_name, typeset
from stickslip_fit._summary import Summary, Table, embedded, template, trusted
from stickslip_fit.anova import Anova, analyse
from stickslip_fit.anova.summary import CAUTIONS, sentences_by_joint
from stickslip_fit.diagnose import Diagnosis
from stickslip_fit.errors import InputError
from stickslip_fit.fit import Result
from stickslip_fit.fit import errors as errors_of
from stickslip_fit.fit.summary import departures_tables, remarks
from stickslip_fit.logs import Log
from stickslip_fit.report import accuracy, calibrated
from stickslip_fit.report.answer import answer, answer_table
from stickslip_fit.report.compared import compared
from stickslip_fit.report.d_table import d_table
from stickslip_fit.report.diagnosis import diagnosed
from stickslip_fit.report.figures.factors import factor_pictures
from stickslip_fit.report.gallery import gallery
from stickslip_fit.report.interactive.traverses import shown_traverses
from stickslip_fit.report.load_coefficient import load_coefficients
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.claims import claims_table


def report_html(
    log: Log,
    calibration: Result,
    constant: Result,
    fit: Result,
    *,
    diagnosis: Diagnosis | InputError | None = None,
    comparison: Comparison | InputError | None = None,
    command: str = "",
) -> str:
    """The report of a log.

    Parameters
    ----------
    log : Log
    calibration : Result
        Closed form.
    constant : Result
        The constant step of each session and direction.
    fit : Result
        Least squares.
    diagnosis : Diagnosis or InputError, optional
        For a section on what the laws get wrong; or why this log has none.
    comparison : Comparison or InputError, optional
        For a section on calibration strategies; or why this log has none.
    command : str, optional
        As typed; where empty, the fit's own.

    Returns
    -------
    str
        An HTML page that needs nothing but itself: it makes no request, runs no script but its own, and says
        the same without that. The same input gives the same page.
    """
    errors = errors_of(log, calibration, constant)
    coefficients = load_coefficients(log, calibration, fit)
    both = calibrated.compared(calibration, fit)
    variance = analyse(log)
    traverses = shown_traverses(log, calibration, fit)
    return template("report.html.j2").render(
        title=_title(log),
        answer=answer(log, calibration, errors),
        answer_table=answer_table(log, calibration, fit, errors) if len(errors) else None,
        measured=log.summary(),
        agreement=calibrated.agreement(both),
        parameters=[*calibrated.parameter_tables(both, fit), *departures_tables(fit)],
        repeatability=calibrated.repeatability_table(calibration, fit),
        d_table=d_table(coefficients) if len(coefficients) else None,
        figures=gallery(log, calibration, fit, errors, coefficients),
        accuracy_explained=accuracy.explain(errors),
        accuracy=_accuracy(errors, log),
        claims=claims_table(errors) if len(errors) else None,
        factors=factors(variance),
        diagnosed=diagnosed(diagnosis) if isinstance(diagnosis, Diagnosis) else None,
        not_diagnosed=_why_not(diagnosis),
        compared=compared(comparison, len(log.sessions)) if isinstance(comparison, Comparison) else None,
        not_compared=_why_not(comparison),
        remarks=remarks(calibration, fit),
        provenance=_provenance(log, fit, command),
        joints=traverses["joints"],
        traverses=embedded(traverses),
        trusted=trusted(script=True),
    )


def factors(variance: Anova) -> Summary:
    """The section on factors, each joint's sentences and figures beside its tables."""
    summary, sentences = variance.summary(), sentences_by_joint(variance)
    sections = [
        replace(
            section,
            paragraphs=tuple(map(typeset, sentences[joint])),
            figures=tuple(factor_pictures(joint, variance.answers)),
        )
        for joint, section in zip(sentences, summary.sections, strict=False)
    ]
    rest = [section for section in summary.sections if section.title == CAUTIONS]
    return replace(summary, headline=(), sections=(*sections, *rest))


def _why_not(section: object) -> str:
    return typeset(str(section)) if isinstance(section, InputError) else ""


def _title(log: Log) -> str:
    names = [Path(name).name for name, _ in log.sources]
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1:,} more"


def _accuracy(errors: pd.DataFrame, log: Log) -> list[tuple[str, list[Table]]]:
    """A heading and three tables for each joint that has errors."""
    sections = []
    for joint in sorted(errors["joint"].unique()):
        worst = accuracy.configurations_of(errors, joint)
        tables = [accuracy.by_direction(errors, joint)]
        if len(log.sessions) > 1:
            tables.append(accuracy.by_session(errors, joint))
        tables.append(accuracy.by_configuration(worst, log.machine))
        sections.append((joint_name(joint).capitalize(), tables))
    return sections


def _provenance(log: Log, fit: Result, command: str) -> list[tuple[str, str]]:
    source = fit.provenance
    return [
        *((name, f"sha256 {sha}") for name, sha in log.sources),
        *([("all files together", f"sha256 {log.sha256}")] if len(log.sources) > 1 else []),
        (f"machine {source.machine_name}", f"sha256 {source.machine_sha256}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in source.versions.items())),
        ("command", command or source.command or "none: made from Python"),
    ]
