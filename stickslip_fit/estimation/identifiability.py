"""Which parameters the data determine (rank of the Jacobian), and which traverses would fix the rest.

A parameter is identifiable if no direction in the null space of J' W J contains it. For the others, the
smallest subset of the law's calibration configurations that restores full rank is named.
"""

from __future__ import annotations

from itertools import combinations
from math import degrees, isnan
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._typing import Array
from stickslip_fit.estimation._optimize import RANK_TOL
from stickslip_fit.estimation.noise import Flag
from stickslip_fit.laws import Configuration, StepLaw
from stickslip_fit.machine import Machine
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.estimation._problem import JointProblem


def identifiable_parameters(
    curvature: Array, scales: Array
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.intp], Array]:
    """Which parameters stand alone, and the covariance of all that is known.

    Parameters
    ----------
    curvature : array, shape (g, p, p)
        J' W J with W the inverse variance of each response, SI.
    scales : array, shape (g, p)
        A change of each parameter that matters.

    Returns
    -------
    known : array of bool, shape (g, p)
    rank : array of int, shape (g,)
        How many combinations of parameters are known.
    covariance : array, shape (g, p, p)
        Pseudo-inverse of the curvature, SI: right for every combination that the log knows.
    """
    scaled = curvature * scales[:, :, None] * scales[:, None, :]
    eigenvalue, vector = np.linalg.eigh(scaled)
    top = np.max(eigenvalue, axis=1, keepdims=True, initial=np.finfo(float).tiny)
    seen = eigenvalue > RANK_TOL**2 * top
    unseen_share = np.sum(np.where(seen[:, None, :], 0.0, vector**2), axis=2)
    inverse = np.where(seen, 1.0 / np.where(seen, eigenvalue, 1.0), 0.0)
    covariance = np.einsum("gik,gk,gjk->gij", vector, inverse, vector)
    return unseen_share < 1e-6, seen.sum(axis=1), covariance * scales[:, :, None] * scales[:, None, :]


def flag_unidentified(
    problem: JointProblem,
    machine: Machine,
    known: npt.NDArray[np.bool_],
    curvature: Array,
    information: Array,
    values: Array,
) -> list[Flag]:
    """For each group with unknown parameters, a remark naming them and the traverses to make.

    Parameters
    ----------
    problem : JointProblem
    machine : Machine
    known : array of bool, shape (g, p)
    curvature : array, shape (g, p, p)
        What the log says of each group's parameters.
    information : array, shape (n,)
        What one row like these says of its response.
    values : array, shape (g, p)
    """
    law, groups, flags = problem.law, problem.groups, []
    names = np.array([parameter.name for parameter in law.parameters])
    for group in np.flatnonzero(~known.all(axis=1)):
        session, direction = groups.table.loc[group, ["session", "direction"]]
        seen = _jacobian_root(curvature[group], problem.scales[group]) / np.sqrt(np.mean(information))
        wanted = _smallest_calibration(law, machine, direction, seen, values[group], problem.scales[group])
        told = "; ".join(describe_configuration(configuration) for configuration in wanted)
        count = int(groups.sizes[group])
        for where, when, subset in (
            (f", session {session}", str(session), ~problem.sharing.parameters),
            ("", "", problem.sharing.parameters),
        ):
            unknown = tuple(names[~known[group] & subset])
            together = " one by one" if len(unknown) > 1 else ""
            counted = f"{count} usable traverse{'s' if count != 1 else ''}"
            flag = Flag(
                "not_identified", law.joint, direction, when, unknown,
                f"joint {law.joint}, direction {direction}{where}: {join_words(unknown)} cannot be known"
                f"{together} from {counted if when else 'the whole campaign'}; missing: {told}",
            )  # fmt: skip
            if unknown and flag not in flags:
                flags.append(flag)
    return flags


def _jacobian_root(curvature: Array, scales: Array) -> Array:
    """Slopes that have this curvature, in units of the scales; (p, p) -> (p, p)."""
    eigenvalue, vector = np.linalg.eigh(curvature * scales[:, None] * scales)
    return np.sqrt(np.maximum(eigenvalue, 0.0))[:, None] * vector.T


def configuration_rows(
    configurations: tuple[Configuration, ...], joint: int, direction: str, machine: Machine
) -> pd.DataFrame:
    """Full traverses of a joint at the given configurations, first thing in a session, in a log's columns."""
    low, high = machine.ranges[joint]
    start, stop = (low, high) if direction == "+" else (high, low)
    return pd.DataFrame(
        {
            "joint": joint,
            "direction": direction,
            **{
                name: [getattr(c, name) for c in configurations]
                for name in ("q1", "q2", "q3", "theta", "psi")
            },
            "start": start,
            "stop": stop,
            "session": "",
            "session_seconds": 0.0,
            "steps_before": 0,
        }
    )


def describe_configuration(configuration: Configuration) -> str:
    """A configuration in words and people's units.

    Examples
    --------
    >>> describe_configuration(Configuration("arm upright", q2=0.0))
    'a full traverse at q2 = 0°, theta = 0°, psi = 0° (arm upright)'
    """
    parts = []
    if not isnan(configuration.q2):
        parts.append(f"q2 = {degrees(configuration.q2):.4g}°")
    if not isnan(configuration.q3):
        parts.append(f"q3 = {from_si(configuration.q3, 'mm'):.4g} mm")
    parts += [f"theta = {degrees(configuration.theta):.4g}°", f"psi = {degrees(configuration.psi):.4g}°"]
    return f"a full traverse at {', '.join(parts)} ({configuration.label})"


def _smallest_calibration(
    law: StepLaw, machine: Machine, direction: str, slopes: Array, values: Array, scales: Array
) -> tuple[Configuration, ...]:
    """The smallest choice of the law's calibration that makes every parameter known."""
    candidates = law.calibration()
    rows = configuration_rows(candidates, law.joint, direction, machine)
    # Where the fit left a law that stalls in a candidate, any law of ordinary effect serves to find the rank.
    gained = law.jacobian(rows, values) * scales
    if not np.all(np.isfinite(gained)):
        ordinary = law.start_values(np.array([np.max(np.abs(scales))]))[0]
        gained = law.jacobian(rows, ordinary) * scales
    for size in range(1, len(candidates)):
        for choice in combinations(range(len(candidates)), size):
            singular = np.linalg.svd(np.vstack([slopes, gained[list(choice)]]), compute_uv=False)
            if len(singular) == len(scales) and singular[-1] > 100 * RANK_TOL * singular[0]:
                return tuple(candidates[index] for index in choice)
    return candidates
