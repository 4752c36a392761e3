"""Sections on calibration strategies: comparison, worst configurations, simulated study."""

from __future__ import annotations

from dataclasses import replace

from stickslip_fit._format import joint_name
from stickslip_fit._summary import Summary
from stickslip_fit.plotting.strategies import pareto_picture
from stickslip_fit.strategies import Comparison


def make_comparison_section(found: Comparison, sessions_in_log: int = 0) -> Summary:
    """A comparison with its figures drawn.

    Parameters
    ----------
    found : Comparison
    sessions_in_log : int, optional
        Said where the comparison is over fewer.
    """
    summary, sections = found.summary(), []
    for section in summary.sections:
        joint = next((each for each in found.joints if section.title.lower() == joint_name(each)), None)
        sections.append(replace(section, figures=(pareto_picture(found, joint),)) if joint else section)
    seen = {*found.costs["session"], *found.left_out["session"]} - {""}
    headline = summary.headline
    if len(seen) < sessions_in_log:
        told = f"Compared on the latest {len(seen)} of {sessions_in_log:,} sessions"
        headline = (*headline, f"{told}; stickslip-fit compare takes all.")
    return replace(summary, headline=headline, sections=tuple(sections))
