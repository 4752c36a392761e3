"""What the simulation gets wrong: as a page, as a section of a report, as a notebook has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stickslip_fit._summary import Section, Summary, template, trusted
from stickslip_fit.diagnose import Diagnosis
from stickslip_fit.diagnose.telling.show import Shown, shape_of, shown
from stickslip_fit.report.figures.evidence import everything_picture, finding_picture
from stickslip_fit.report.figures.gains import gain_picture
from stickslip_fit.report.figures.likeness import likeness_picture
from stickslip_fit.report.figures.ranking import ranking_picture


def diagnosis_page(diagnosis: Diagnosis, *, command: str = "") -> str:
    """A page of its own: nothing but itself is needed to read it.

    Parameters
    ----------
    diagnosis : Diagnosis
    command : str, optional
        As typed.
    """
    return template("diagnosis.html.j2").render(
        diagnosed=diagnosed(diagnosis, command), trusted=trusted(script=False)
    )


def diagnosed(diagnosis: Diagnosis, command: str = "") -> Summary:
    """A diagnosis with its figures."""
    left, study = numbered(diagnosis), diagnosis.search.bench.study()
    found = {each.cause: each for each in diagnosis.search.found}
    evidence = [
        finding_picture(finding, found[finding.cause], shape_of(found[finding.cause], study), left)
        for finding in diagnosis.findings
        if found[finding.cause].misfit is not None
    ]
    joints = sorted(int(joint) for joint in left.rows["joint"].unique())
    pictures = (*evidence, *(everything_picture(joint, left) for joint in joints), gain_picture(diagnosis))
    summary = diagnosis.summary()
    findings, alternatives, unseen = summary.sections
    sections = (
        findings,
        Section("The evidence", figures=pictures, key="evidence"),
        replace(alternatives, figures=(ranking_picture(diagnosis), likeness_picture(diagnosis))),
        unseen,
    )
    source = ("command", command or "none: made from Python")
    return replace(summary, sections=sections, provenance=(*summary.provenance, source))


def numbered(diagnosis: Diagnosis) -> Shown:
    """What is left over, each row by its number among the log's usable traverses: misfires are not shown."""
    left = shown(diagnosis.search, diagnosis.seed)
    misfired = [
        row for each in diagnosis.findings if each.traverses is not None for row in each.traverses.index
    ]
    numbers = np.delete(np.arange(len(left.rows) + len(misfired)), np.array(misfired, dtype=int))
    return replace(left, rows=left.rows.set_axis(numbers))
