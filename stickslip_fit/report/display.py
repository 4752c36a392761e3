"""Logs and results as a notebook shows them: one small piece of HTML that needs nothing but itself."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from stickslip_fit._format import (
    MINUS,
    typeset,
)
from stickslip_fit._summary import template
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.text import heading, left_out_text
from stickslip_fit.strategies.verdict import answer

if TYPE_CHECKING:
    from stickslip_fit.capture.tuning import Tuning

MOST_REMARKS = 8
OF_COMPARISON = (0, 1, 2, 6, 7, 8, 10)  # columns for which a notebook has the width


def comparison_html(found: Comparison) -> str:
    """Strategies compared: for each joint what they cost and reach, and what the thesis claims beside it."""
    from stickslip_fit.report.claimed import claimed_table
    from stickslip_fit.report.compared import comparison_table
    from stickslip_fit.report.implied import implied_table

    unsuited = left_out_text(found)
    tables = []
    for joint in found.joints:
        whole = comparison_table(found, joint)
        said = typeset(answer(found, joint)).replace("(-)", f"({MINUS})")
        short = replace(
            whole,
            columns=tuple(whole.columns[k] for k in OF_COMPARISON),
            rows=tuple(tuple(row[k] for k in OF_COMPARISON) for row in whole.rows),
            note=f"{said} {whole.note}",
        )
        tables += [short, implied_table(found, joint), claimed_table(found, joint)]
    return template("display.html.j2").render(
        title="Calibration strategies compared",
        said=[typeset(heading(found))],
        remarks=[],
        tables=tables,
        folded=[("Left out", unsuited)] if unsuited else [],
        provenance=found.provenance.lines(),
    )


def tuning_html(tuning: Tuning) -> str:
    """What to listen for, in words."""
    return template("display.html.j2").render(
        title="Tuning of the ear", said=[tuning.summary()], remarks=[], tables=[], folded=[], provenance=[]
    )
