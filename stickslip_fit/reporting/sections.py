"""Sections on the analysis of variance, the diagnosis and strategies: their summaries with figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stickslip_fit._format import joint_name, typeset_text
from stickslip_fit._summary import Section, Summary, load_page_assets, load_template
from stickslip_fit.anova import Anova
from stickslip_fit.anova._summary import CAUTIONS, sentences_by_joint
from stickslip_fit.diagnosis import Diagnosis
from stickslip_fit.diagnosis.residuals import ResidualComparison, compare_residuals, compute_shape
from stickslip_fit.plotting.anova import factor_pictures
from stickslip_fit.plotting.diagnosis import confusion_picture, gain_picture, ranking_picture
from stickslip_fit.plotting.residuals import finding_picture, residuals_overview_picture
from stickslip_fit.plotting.strategies import pareto_picture
from stickslip_fit.strategies import Comparison


def make_anova_section(anova: Anova) -> Summary:
    """An analysis of variance, each joint's sentences and figures beside its tables."""
    summary, sentences = anova.summary(), sentences_by_joint(anova)
    sections = [
        replace(
            section,
            paragraphs=tuple(map(typeset_text, sentences[joint])),
            figures=tuple(factor_pictures(joint, anova.factor_tests)),
        )
        for joint, section in zip(sentences, summary.sections, strict=False)
    ]
    cautions = [section for section in summary.sections if section.title == CAUTIONS]
    return replace(summary, headline=(), sections=(*sections, *cautions))


def diagnosis_page(diagnosis: Diagnosis, *, command: str = "") -> str:
    """A diagnosis as a self-contained HTML page; `command` as typed."""
    return load_template("diagnosis.html.j2").render(
        diagnosed=make_diagnosis_section(diagnosis, command), assets=load_page_assets(script=False)
    )


def make_diagnosis_section(diagnosis: Diagnosis, command: str = "") -> Summary:
    """A diagnosis with its figures."""
    comparison, linearized = number_residuals(diagnosis), diagnosis.search.problem.study()
    selected = {cause.cause: cause for cause in diagnosis.search.found}
    pictures = [
        finding_picture(finding, cause, compute_shape(cause, linearized), comparison)
        for finding in diagnosis.findings
        if (cause := selected[finding.cause]).misfit is not None
    ]
    joints = sorted(comparison.rows["joint"].unique())
    pictures += [residuals_overview_picture(int(joint), comparison) for joint in joints]
    summary = diagnosis.summary()
    findings, alternatives, untestable = summary.sections
    sections = (
        findings,
        Section("The evidence", figures=(*pictures, gain_picture(diagnosis)), key="evidence"),
        replace(alternatives, figures=(ranking_picture(diagnosis), confusion_picture(diagnosis))),
        untestable,
    )
    source = ("command", command or "none: made from Python")
    return replace(summary, sections=sections, provenance=(*summary.provenance, source))


def number_residuals(diagnosis: Diagnosis) -> ResidualComparison:
    """Residuals without outliers, each row by its number among the log's usable traverses."""
    comparison = compare_residuals(diagnosis.search, diagnosis.seed)
    outliers = [
        row
        for finding in diagnosis.findings
        if finding.traverses is not None
        for row in finding.traverses.index
    ]
    numbers = np.delete(np.arange(len(comparison.rows) + len(outliers)), np.array(outliers, dtype=int))
    return replace(comparison, rows=comparison.rows.set_axis(numbers))


def make_comparison_section(comparison: Comparison, sessions_in_log: int = 0) -> Summary:
    """A comparison of strategies with its figures; says where it is over fewer than the log's sessions."""
    summary, sections = comparison.summary(), []
    for section in summary.sections:
        joint = next(
            (joint for joint in comparison.joints if section.title.lower() == joint_name(joint)), None
        )
        figures = (pareto_picture(comparison, joint),) if joint else section.figures
        sections.append(replace(section, figures=figures))
    n_compared = len({*comparison.costs["session"], *comparison.left_out["session"]} - {""})
    headline = summary.headline
    if n_compared < sessions_in_log:
        latest = f"Compared on the latest {n_compared} of {sessions_in_log:,} sessions"
        headline = (*headline, f"{latest}; stickslip-fit compare takes all.")
    return replace(summary, headline=headline, sections=tuple(sections))
