"""The report's section on calibration strategies: a comparison with its figures."""

from __future__ import annotations

from dataclasses import replace

from stickslip_fit._summary import Summary
from stickslip_fit.report.figures.pareto import pareto_picture
from stickslip_fit.strategies import Comparison


def compared(found: Comparison, sessions: int = 0) -> Summary:
    """A comparison with its figures drawn.

    Parameters
    ----------
    found : Comparison
    sessions : int, optional
        Of the log; said where the comparison is over fewer.
    """
    summary = found.summary()
    if not found.joints:
        return summary
    how, *parts = summary.sections
    seen = {*found.spent["session"], *found.left_out["session"]} - {""}
    if len(seen) < sessions:
        fewer = (
            f"Compared on the latest {len(seen)} of {sessions:,} sessions; stickslip-fit compare takes all."
        )
        how = replace(how, paragraphs=(*how.paragraphs, fewer))
    for place, joint in enumerate(found.joints):
        parts[place] = replace(parts[place], figures=(pareto_picture(found, joint),))
    return replace(summary, sections=(how, *parts))
