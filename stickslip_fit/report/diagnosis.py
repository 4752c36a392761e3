"""What the simulation gets wrong: as a page, as a section of a report, as a notebook has it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stickslip_fit._format import join_words, typeset
from stickslip_fit._summary import Table, template, trusted
from stickslip_fit.diagnose import Diagnosis
from stickslip_fit.diagnose.experiments.next_experiment import out_of_reach
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.diagnose.telling.answer import answer
from stickslip_fit.diagnose.telling.show import Shown, shape_of, shown
from stickslip_fit.diagnose.telling.text import unseen, untestable_text
from stickslip_fit.errors import InputError
from stickslip_fit.report import diagnosis_tables as tables
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.evidence import draw_finding, everything_picture, finding_picture
from stickslip_fit.report.figures.gains import gain_picture
from stickslip_fit.report.figures.likeness import likeness_picture
from stickslip_fit.report.figures.picture import Picture
from stickslip_fit.report.figures.ranking import ranking_picture


@dataclass(frozen=True)
class Diagnosed:
    """The parts of a diagnosis that pages are made of.

    Attributes
    ----------
    said : list of str
        The answer.
    tables : list of Table
        Of what was found, and what that gains.
    evidence, alternatives : list of Picture
        Residuals; the ranking of causes, and what could be told apart.
    further : list of Table
        The ranking, and the traverses that would tell.
    unseen : list of (str, str)
        What the log could not have shown, and why.
    remarks : list of str
    """

    said: list[str]
    tables: list[Table]
    evidence: list[Picture]
    alternatives: list[Picture]
    further: list[Table]
    unseen: list[tuple[str, str]]
    remarks: list[str]


def diagnosis_page(diagnosis: Diagnosis, *, command: str = "") -> str:
    """A page of its own: nothing but itself is needed to read it.

    Parameters
    ----------
    diagnosis : Diagnosis
    command : str, optional
        As typed.
    """
    return template("diagnosis.html.j2").render(
        title=_title(diagnosis),
        diagnosed=diagnosed(diagnosis),
        provenance=_provenance(diagnosis, command),
        trusted=trusted(script=False),
    )


def diagnosis_html(diagnosis: Diagnosis) -> str:
    """A piece of HTML for a notebook: the answer and its tables."""
    parts = [*tables.findings_tables(diagnosis), *tables.gain_tables(diagnosis), *tables.further(diagnosis)]
    untestable = untestable_text(diagnosis)
    return template("display.html.j2").render(
        title=f"Diagnosis of {_title(diagnosis)}",
        said=[typeset(each) for each in answer(diagnosis)],
        remarks=_remarks(diagnosis),
        tables=parts,
        folded=[("What this log could not have shown", untestable)] if untestable else [],
        provenance=_provenance(diagnosis, ""),
    )


def diagnosed(diagnosis: Diagnosis) -> Diagnosed:
    """All parts of a diagnosis, pictures drawn."""
    left, study = numbered(diagnosis), diagnosis.search.bench.study()
    found = {each.cause: each for each in diagnosis.search.found}
    evidence = [
        finding_picture(finding, found[finding.cause], shape_of(found[finding.cause], study), left)
        for finding in diagnosis.findings
        if found[finding.cause].misfit is not None
    ]
    joints = sorted(int(joint) for joint in left.rows["joint"].unique())
    return Diagnosed(
        [typeset(each) for each in answer(diagnosis)],
        [*tables.findings_tables(diagnosis), *tables.gain_tables(diagnosis)],
        [*evidence, *(everything_picture(joint, left) for joint in joints), gain_picture(diagnosis)],
        [ranking_picture(diagnosis), likeness_picture(diagnosis)],
        tables.further(diagnosis),
        _unseen(diagnosis),
        _remarks(diagnosis),
    )


def numbered(diagnosis: Diagnosis) -> Shown:
    """What is left over, each row by its number among the log's usable traverses: misfires are not shown."""
    left = shown(diagnosis.search, diagnosis.seed)
    misfired = [
        row for each in diagnosis.findings if each.traverses is not None for row in each.traverses.index
    ]
    numbers = np.delete(np.arange(len(left.rows) + len(misfired)), np.array(misfired, dtype=int))
    return replace(left, rows=left.rows.set_axis(numbers))


def plot_residuals(diagnosis: Diagnosis, finding: int) -> Figure:
    """One finding's residuals before and after.

    Raises
    ------
    InputError
        If there is no such finding, or it has no shape.
    """
    found = {each.cause: each for each in diagnosis.search.found}
    if not 0 <= finding < len(diagnosis.findings):
        raise InputError(f"there is no finding {finding}: this diagnosis has {len(diagnosis.findings)}")
    chosen = diagnosis.findings[finding]
    if found[chosen.cause].misfit is None:
        raise InputError("misfires have no shape to draw; the finding's `traverses` are those counts")
    shape = shape_of(found[chosen.cause], diagnosis.search.bench.study())
    left = shown(diagnosis.search, diagnosis.seed)
    return on_white(draw_finding(chosen, found[chosen.cause], shape, left)[1])


def _unseen(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    return [(join_words(causes), typeset(why)) for why, causes in unseen(diagnosis).items()]


def _remarks(diagnosis: Diagnosis) -> list[str]:
    told = [
        f"Whatever {first} would do in this log, {second} could have done too."
        for first, second in diagnosis.alike
    ]
    beyond = out_of_reach(diagnosis.findings, diagnosis.next_experiment)
    told += [f"No traverse within reach tells {one} from {other}." for one, other in beyond]
    if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
        told.append("Structure without a name is not put into the law, so that it gains nothing.")
    return told


def _title(diagnosis: Diagnosis) -> str:
    return Path(diagnosis.log_file).name or "a log that was never in a file"


def _provenance(diagnosis: Diagnosis, command: str) -> list[tuple[str, str]]:
    return [
        (_title(diagnosis), f"sha256 {diagnosis.log_sha256}"),
        ("command", command or "none: made from Python"),
        ("false-alarm rate, seed", f"{diagnosis.alpha:g}, {diagnosis.seed}"),
    ]
