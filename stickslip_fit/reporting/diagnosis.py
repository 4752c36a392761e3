"""Sections on the diagnosis, next traverses, separability of a plan, and analysis of variance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stickslip_fit._summary import Section, Summary, load_page_assets, load_template
from stickslip_fit.diagnosis import Diagnosis
from stickslip_fit.diagnosis.residuals import ResidualComparison, compare_residuals, compute_shape
from stickslip_fit.plotting.diagnosis import confusion_picture, gain_picture, ranking_picture
from stickslip_fit.plotting.residuals import finding_picture, residuals_overview_picture


def diagnosis_page(diagnosis: Diagnosis, *, command: str = "") -> str:
    """A page of its own: nothing but itself is needed to read it.

    Parameters
    ----------
    diagnosis : Diagnosis
    command : str, optional
        As typed.
    """
    return load_template("diagnosis.html.j2").render(
        diagnosed=make_diagnosis_section(diagnosis, command), trusted=load_page_assets(script=False)
    )


def make_diagnosis_section(diagnosis: Diagnosis, command: str = "") -> Summary:
    """A diagnosis with its figures."""
    comparison, linearized = number_residuals(diagnosis), diagnosis.search.problem.study()
    found = {each.cause: each for each in diagnosis.search.found}
    evidence = [
        finding_picture(
            finding, found[finding.cause], compute_shape(found[finding.cause], linearized), comparison
        )
        for finding in diagnosis.findings
        if found[finding.cause].misfit is not None
    ]
    joints = sorted(int(joint) for joint in comparison.rows["joint"].unique())
    pictures = (
        *evidence,
        *(residuals_overview_picture(joint, comparison) for joint in joints),
        gain_picture(diagnosis),
    )
    summary = diagnosis.summary()
    findings, alternatives, unseen = summary.sections
    sections = (
        findings,
        Section("The evidence", figures=pictures, key="evidence"),
        replace(alternatives, figures=(ranking_picture(diagnosis), confusion_picture(diagnosis))),
        unseen,
    )
    source = ("command", command or "none: made from Python")
    return replace(summary, sections=sections, provenance=(*summary.provenance, source))


def number_residuals(diagnosis: Diagnosis) -> ResidualComparison:
    """What is left over, each row by its number among the log's usable traverses: misfires are not shown."""
    comparison = compare_residuals(diagnosis.search, diagnosis.seed)
    outliers = [
        row for each in diagnosis.findings if each.traverses is not None for row in each.traverses.index
    ]
    numbers = np.delete(np.arange(len(comparison.rows) + len(outliers)), np.array(outliers, dtype=int))
    return replace(comparison, rows=comparison.rows.set_axis(numbers))
