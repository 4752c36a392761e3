"""Whether residuals scatter more than replicates do: the cheap sign that a law misses something."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.special import fdtrc

from stickslip_fit._format import format_direction, format_percent
from stickslip_fit.estimation.noise import NoiseLevel, configuration_columns
from stickslip_fit.estimation.result import JointFit, Result
from stickslip_fit.logs import Log

LEVEL, MIN_RATIO = 1e-3, 1.4  # of the F test over all directions; of the standard deviations
MIN_DF = 4
NORMAL_MEDIAN = 0.4549364  # of the square of a standard normal number
MEDIAN_EFFICIENCY = 0.37  # of a variance from the median of squares


def describe_excess_scatter(log: Log, result: Result) -> str:
    """A sentence on the joint and direction with the largest excess; empty where there is none.

    Residuals and replicates are compared by an F test, for each joint and direction that has both.

    Parameters
    ----------
    log : Log
        That was fitted.
    result : Result
        By least squares.
    """
    found, usable = [], log.usable
    for joint, fit in result.joints.items():
        rows = usable[usable["joint"] == joint]
        for direction, residual in fit.repeatability.items():
            replicate = _replicate_scatter(fit, rows[rows["direction"] == direction])
            if (
                residual.source != "residuals"
                or min(residual.df, replicate.df) < MIN_DF
                or replicate.value <= 0
            ):
                continue
            ratio = residual.value / replicate.value
            chance = fdtrc(residual.df, replicate.df, ratio**2) * 2 * len(result.joints)
            if ratio > MIN_RATIO and chance < LEVEL:
                found.append((ratio, joint, direction, residual.value, replicate.value))
    if not found:
        return ""
    _, joint, direction, residual_scatter, replicate_scatter = max(found)
    return (
        f"The residual scatter is {format_percent(residual_scatter)}, while most replicates scatter by "
        f"{format_percent(replicate_scatter)} (joint {joint}, direction {format_direction(direction)}): the "
        "law misses something; run stickslip-fit diagnose."
    )


def _replicate_scatter(fit: JointFit, rows: pd.DataFrame) -> NoiseLevel:
    """Standard deviation of log steps, from the median squared difference of replicates in order of time.

    A median, because some replicates lie hours apart and differ by what the law misses.
    """
    y, _ = fit.law.response(rows)
    columns = configuration_columns(rows)
    keys = rows[columns].round(9)
    groups = keys.groupby(columns, dropna=False, sort=False, observed=True).ngroup().to_numpy()
    difference = pd.Series(y).groupby(groups).diff().dropna().to_numpy()
    if not len(difference):
        return NoiseLevel(np.nan, 0, "replicates")
    variance = float(np.median(difference**2)) / NORMAL_MEDIAN / 2
    return NoiseLevel(float(np.sqrt(variance)), int(MEDIAN_EFFICIENCY * len(difference)), "replicates")
