"""The page of a table's diagnosis: the answer, the law, the evidence, and what could not be tested."""

from __future__ import annotations

from dataclasses import replace

from stickslip_fit._summary import Section, Summary
from stickslip_fit.diagnosis import Diagnosis, TableInfo
from stickslip_fit.diagnosis.extended_table import make_table_fit
from stickslip_fit.estimation._table_summary import describe_fit, parameters_table
from stickslip_fit.plotting._svg import Picture
from stickslip_fit.plotting.diagnosis import confusion_picture, gain_picture, ranking_picture
from stickslip_fit.plotting.table import columns_picture, finding_pictures, measured_picture


def make_table_section(diagnosis: Diagnosis, table: TableInfo, command: str = "") -> Summary:
    """A table's diagnosis with its figures, and the law with what was found in it."""
    selection, summary = diagnosis.selection, diagnosis.summary()
    fit = make_table_fit(selection.problem, selection.fit, table, command=command)
    findings, alternatives, untestable = summary.sections
    named = [finding.cause for finding in diagnosis.findings if finding.version is not None]
    flags = tuple(f"Of the law: {flag}." for flag in fit.flags)
    law = Section(
        "The law with what was found in it" if named else "The law",
        (describe_fit(fit), *flags),
        (parameters_table(fit),),
        (measured_picture(fit),),
        key="law",
    )
    by_session = diagnosis.gain is not None and len(diagnosis.gain.by_session) > 1
    evidence = [
        *finding_pictures(diagnosis, table),
        columns_picture(diagnosis, table),
        *([gain_picture(diagnosis)] if by_session and named else []),
    ]
    likely = _drawn([ranking_picture(diagnosis), confusion_picture(diagnosis)])
    sections = (
        findings,
        law,
        Section("The evidence", figures=_drawn(evidence), key="evidence"),
        replace(alternatives, figures=likely),
        untestable,
    )
    source = ("command", command or "none: made from Python")
    return replace(summary, sections=sections, provenance=(*summary.provenance, source))


def _drawn(pictures: list[Picture]) -> tuple[Picture, ...]:
    return tuple(picture for picture in pictures if picture.svg is not None)
