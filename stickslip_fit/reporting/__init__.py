"""Pages for people: the report of a log. Reads results, computes none."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stickslip_fit.diagnosis import Diagnosis
    from stickslip_fit.errors import InputError
    from stickslip_fit.estimation import Result
    from stickslip_fit.logs import Log
    from stickslip_fit.strategies import Comparison

__all__ = ["report_html"]


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
    """The report of a log; see `page.report_html`."""
    from stickslip_fit.reporting.page import render_report as build

    return build(log, calibration, constant, fit, diagnosis=diagnosis, comparison=comparison, command=command)
