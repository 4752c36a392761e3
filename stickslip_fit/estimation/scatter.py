"""Whether residuals scatter more than replicates do: the cheap sign that a law misses something."""

from __future__ import annotations

from scipy.special import fdtrc

from stickslip_fit._format import format_direction, format_percent
from stickslip_fit.estimation.closed_form import solve_calibration
from stickslip_fit.estimation.result import Result
from stickslip_fit.estimation.with_causes import law_without_causes
from stickslip_fit.logs import Log

LEVEL, MIN_RATIO = 1e-3, 1.4  # of the F test over all directions; of the standard deviations
MIN_DF = 4


def describe_excess_scatter(log: Log, result: Result) -> str:
    """A sentence on the joint and direction with the largest excess; empty where there is none.

    Residual scatter and the replicate scatter of the calibration in closed form are compared by an F test,
    for each joint and direction that has both.

    Parameters
    ----------
    log : Log
        That was fitted.
    result : Result
        By least squares.
    """
    laws = {joint: law_without_causes(fit.law) for joint, fit in result.joints.items()}
    calibration, found = solve_calibration(log, laws, "closed-form"), []
    for joint, fit in result.joints.items():
        for direction, residual in fit.repeatability.items():
            replicate = calibration.joints[joint].repeatability[direction]
            sources = (residual.source, replicate.source)
            if sources != ("residuals", "replicates") or min(residual.df, replicate.df) < MIN_DF:
                continue
            ratio = residual.value / replicate.value if replicate.value > 0 else 0.0
            chance = fdtrc(residual.df, replicate.df, ratio**2) * 2 * len(result.joints)
            if ratio > MIN_RATIO and chance < LEVEL:
                found.append((ratio, joint, direction, residual.value, replicate.value))
    if not found:
        return ""
    _, joint, direction, residual_scatter, replicate_scatter = max(found)
    return (
        f"The residual scatter is {format_percent(residual_scatter)}, the replicate scatter "
        f"{format_percent(replicate_scatter)} (joint {joint}, direction {format_direction(direction)}): the "
        "law misses something; run stickslip-fit diagnose."
    )
