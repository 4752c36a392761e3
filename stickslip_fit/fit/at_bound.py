"""Parameters that a bound holds back: how far they may be from it, and what to say."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit._format import format_value
from stickslip_fit.fit.problem import JointProblem
from stickslip_fit.fit.remark import Remark

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def reach_from_bound(slope: Array, variance: Array, reach: Array) -> Array:
    """How far from its bound a parameter can be before the likelihood rules it out.

    Parameters
    ----------
    slope : array
        By how much half the sum of squares falls per unit of the parameter beyond the bound.
    variance : array
        Of the parameter, were there no bound.
    reach : array
        Standard errors of an interval, e.g. 1.96.

    Returns
    -------
    array
        The distance d with d^2 / variance + 2 |slope| d = reach^2.

    Examples
    --------
    At a bound where the sum of squares is least anyway, it is the ordinary half-width:

    >>> reach_from_bound(np.array([0.0, 2.0]), np.array([4.0, 4.0]), np.array([2.0, 2.0])).round(3)
    array([4.   , 0.944])
    """
    slope = np.abs(slope)
    return variance * (np.sqrt(slope**2 + reach**2 / variance) - slope)


def one_sided_intervals(
    values: Array, at_bound: Mask, lower: Array, uphill: Array, covariance: Array, reach: Array
) -> Array:
    """Intervals of the parameters that lie on a bound, from it to where the likelihood ends them.

    Parameters
    ----------
    values, lower, uphill : array, shape (g, p)
        `uphill` is by how much half the sum of squares would fall per unit of each parameter.
    at_bound : array of bool, shape (g, p)
    covariance : array, shape (g, p, p)
        Were there no bound.
    reach : array, shape (g,)
        Standard errors of an interval.

    Returns
    -------
    array, shape (number at a bound, 2)
    """
    variance = np.diagonal(covariance, axis1=1, axis2=2)[at_bound]
    reach = np.broadcast_to(reach[:, None], values.shape)[at_bound]
    inwards = np.where((values <= lower)[at_bound], 1.0, -1.0)
    ends = values[at_bound] + inwards * reach_from_bound(uphill[at_bound], variance, reach)
    return np.sort(np.stack([values[at_bound], ends], axis=-1), axis=-1)


def at_bound_remarks(problem: JointProblem, values: Array, at_bound: Mask) -> list[Remark]:
    """A remark for each parameter that a bound holds back, one for all sessions if they share it."""
    law, remarks = problem.law, {}
    for index, k in np.argwhere(at_bound):
        group, parameter = problem.groups.table.loc[index], law.parameters[k]
        common = problem.sharing.parameters[k]
        session = "" if common else str(group["session"])
        where = "" if common else f", session {session}"
        remarks[session, group["direction"], k] = Remark(
            "at_bound", law.joint, group["direction"], session, (parameter.name,),
            f"joint {law.joint}, direction {group['direction']}{where}: {parameter.name} is held back by its "
            f"bound at {format_value(values[index, k], parameter.unit, 4)}; the counts would have it beyond, "
            "and the other error bars take the bound for true",
        )  # fmt: skip
    return list(remarks.values())
