"""A diagnosis as a page of its own, and as a section of a log's report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stickslip_fit._format import format_p_value, format_percent, join_words, typeset_text
from stickslip_fit._summary import Section, Summary, load_page_assets, load_template
from stickslip_fit.diagnosis import Diagnosis, TableInfo
from stickslip_fit.diagnosis._unknown_summary import name_findings
from stickslip_fit.diagnosis.extended_table import make_table_fit
from stickslip_fit.diagnosis.residuals import ResidualComparison, compare_residuals, finding_shape
from stickslip_fit.estimation._table_summary import describe_fit, parameters_table
from stickslip_fit.plotting._svg import Picture
from stickslip_fit.plotting.diagnosis import confusion_picture, gain_picture, machine_of, ranking_picture
from stickslip_fit.plotting.profile import travel_picture
from stickslip_fit.plotting.residuals import finding_picture, residuals_overview_picture
from stickslip_fit.plotting.table import columns_picture, finding_pictures, measured_picture


def diagnosis_page(diagnosis: Diagnosis, *, command: str = "") -> str:
    """A diagnosis as a self-contained HTML page; `command` as typed."""
    return load_template("diagnosis.html.j2").render(
        diagnosed=make_diagnosis_section(diagnosis, command),
        data=diagnosis.info.data,
        assets=load_page_assets(script=False),
    )


def make_diagnosis_section(diagnosis: Diagnosis, command: str = "") -> Summary:
    """A diagnosis with its figures; of a table also the law with what was found in it."""
    table, summary = diagnosis.table, diagnosis.summary()
    findings, *stage, alternatives, untestable = summary.sections
    if table is not None:
        pictures = [*finding_pictures(diagnosis, table), columns_picture(diagnosis, table)]
    else:
        comparison, machine = number_residuals(diagnosis), machine_of(diagnosis)
        joints = sorted(comparison.rows["joint"].unique())
        pictures = list(_finding_pictures(diagnosis, comparison))
        pictures += [residuals_overview_picture(int(joint), comparison, machine) for joint in joints]
    sections = (
        findings,
        *stage,
        *([_law_section(diagnosis, table, command)] if table is not None else []),
        Section("The evidence", figures=(*pictures, gain_picture(diagnosis)), key="evidence"),
        replace(alternatives, figures=(ranking_picture(diagnosis), confusion_picture(diagnosis))),
        untestable,
    )
    source = ("command", command or "none: made from Python")
    return replace(summary, sections=sections, provenance=(*summary.provenance, source))


def _law_section(diagnosis: Diagnosis, table: TableInfo, command: str) -> Section:
    """The law of a table with what was found in it."""
    fit = make_table_fit(diagnosis.selection.problem, diagnosis.selection.fit, table, command=command)
    named = any(finding.version is not None for finding in diagnosis.findings)
    return Section(
        "The law with what was found in it" if named else "The law",
        (describe_fit(fit), *(f"Of the law: {flag}." for flag in fit.flags)),
        (parameters_table(fit),),
        (measured_picture(fit),),
        key="law",
    )


def _finding_pictures(diagnosis: Diagnosis, comparison: ResidualComparison) -> Iterator[Picture]:
    """Residuals before and after each finding that has a shape, and its profile along the travel."""
    machine = machine_of(diagnosis)
    for finding in diagnosis.findings:
        cause = diagnosis.selection.behind(finding)
        if cause.misfit is not None:
            shape = finding_shape(diagnosis.selection, cause)
            yield finding_picture(finding, cause, shape, comparison, machine)
        if finding.travel:
            yield travel_picture(finding, machine)


def first_finding_picture(diagnosis: Diagnosis) -> Picture | None:
    """Residuals before and after the largest finding that has a shape; None where none has."""
    return next(_finding_pictures(diagnosis, number_residuals(diagnosis)), None)


def diagnosis_section(diagnosis: Diagnosis) -> Section:
    """A diagnosis as a section of a report, whose headline and first figure stand above."""
    summary = diagnosis.summary()
    findings, *stage, alternatives, untestable = summary.sections
    gain, ranking = gain_picture(diagnosis), ranking_picture(diagnosis)
    said = 1 + len(diagnosis.findings) if diagnosis.findings else 1
    return Section(
        "What the simulation gets wrong",
        summary.headline[said:],
        findings.tables,
        (gain,) if gain.svg is not None else (),
        key="diagnosis",
        conclusion=_conclude(diagnosis),
        folded=tuple(
            part
            for part in (
                *(replace(one, key="") for one in stage),
                replace(alternatives, figures=(ranking,) if ranking.svg is not None else (), key=""),
                replace(untestable, key=""),
            )
            if part.paragraphs or part.tables or part.figures
        ),
    )


def _conclude(diagnosis: Diagnosis) -> str:
    if not diagnosis.findings:
        return diagnosis.summary().headline[0]
    found = [
        f"{name} ({format_percent(one.effect.estimate)} rms in "
        f"{'joint' if len(one.joints) == 1 else 'joints'} {join_words([str(joint) for joint in one.joints])})"
        for name, one in zip(name_findings(diagnosis.findings), diagnosis.findings, strict=True)
    ]
    p_value = format_p_value(diagnosis.p_value, relation=True)
    return typeset_text(f"Found: {join_words(found)}; p {p_value} for the whole search.")


def number_residuals(diagnosis: Diagnosis) -> ResidualComparison:
    """Residuals without outliers, each row by its number among the log's usable traverses."""
    comparison = compare_residuals(diagnosis.selection, diagnosis.seed)
    outliers = [
        row
        for finding in diagnosis.findings
        if finding.traverses is not None
        for row in finding.traverses.index
    ]
    numbers = np.delete(np.arange(len(comparison.rows) + len(outliers)), np.array(outliers, dtype=int))
    return replace(comparison, rows=comparison.rows.set_axis(numbers))
