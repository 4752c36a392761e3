"""Which parameters the data determine (rank of the Jacobian), and which traverses would fix the rest.

A parameter is identifiable if no direction in the null space of J' W J contains it. For the others, the
smallest subset of the law's calibration configurations that restores full rank is named.
"""

from __future__ import annotations

from math import degrees, isnan, nan

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._typing import Array
from stickslip_fit.estimation._optimize import RANK_TOL
from stickslip_fit.laws import Configuration, StepLaw, traverse_length
from stickslip_fit.logs.schema import ORIENTATION
from stickslip_fit.machine import Machine
from stickslip_fit.units import from_si

ROUNDING = 1e-12  # of a share


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
        Pseudo-inverse of the curvature, SI: right for every combination that the log knows, 0 where none has
        the parameter.
    """
    scaled = curvature * scales[:, :, None] * scales[:, None, :]
    eigenvalue, vector = np.linalg.eigh(scaled)
    top = np.max(eigenvalue, axis=1, keepdims=True, initial=np.finfo(float).tiny)
    seen = eigenvalue > RANK_TOL**2 * top
    unseen_share = np.sum(np.where(seen[:, None, :], 0.0, vector**2), axis=2)
    inverse = np.where(seen, 1.0 / np.where(seen, eigenvalue, 1.0), 0.0)
    # What no row shows at all has no error bar; rounding would give it one, another in each group.
    shown = (unseen_share < 1.0 - ROUNDING)[:, :, None]
    vector = vector * shown
    covariance = (vector * inverse[:, None, :]) @ vector.mT
    return unseen_share < 1e-6, seen.sum(axis=1), covariance * scales[:, :, None] * scales[:, None, :]


def describe_combinations(law: StepLaw, curvature: Array, scales: Array) -> str:
    """The changes of a group's parameters together that no count shows, in words; of the first few.

    Parameters
    ----------
    curvature : array, shape (p, p)
        As of `identifiable_parameters`.
    scales : array, shape (p,)
    """
    eigenvalue, vector = np.linalg.eigh(curvature * scales[:, None] * scales)
    unseen = vector[:, eigenvalue <= RANK_TOL**2 * max(eigenvalue[-1], np.finfo(float).tiny)].T
    sentences = []
    for combination in _reduce(unseen)[:MAX_COMBINATIONS]:
        moved = np.flatnonzero(np.abs(combination) > NEGLIGIBLE_SHARE)
        first, *others = moved[np.argsort(-np.abs(combination[moved]), kind="stable")]
        if not others:
            sentences.append(f"no count depends on {law.parameters[first].name}")
            continue
        sign = np.sign(combination[first])
        changes = [
            f"{law.parameters[k].name} {'rises' if combination[k] * sign > 0 else 'falls'} by "
            f"{_format_amount(NUDGE * abs(combination[k]) * scales[k], law.parameters[k].unit)}"
            for k in (first, *others)
        ]
        sentences.append(f"no count changes when {join_words(changes)}")
    return "; ".join(sentences)


NUDGE = 0.01  # of a parameter's scale
NEGLIGIBLE_SHARE = 1e-4
MAX_COMBINATIONS = 3


def _reduce(vectors: Array) -> Array:
    """The same span with as many zeros as elimination with pivoting makes, shape (k, p)."""
    reduced = vectors.copy()
    for row in range(len(reduced)):
        column = int(np.argmax(np.abs(reduced[row])))
        reduced[row] /= reduced[row, column]
        others = np.arange(len(reduced)) != row
        reduced[others] -= reduced[others, column][:, None] * reduced[row]
    return reduced


def _format_amount(value: float, unit: str) -> str:
    return f"{from_si(value, unit):.3g}{'' if unit in ('1', '') else ' ' + unit}"


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
            **{name: [getattr(c, name, nan) for c in configurations] for name in _positions(machine)},
            "start": start,
            "stop": stop,
            "session": "",
            "session_seconds": 0.0,
            "steps_before": 0,
        }
    )


def _positions(machine: Machine) -> list[str]:
    return [*(f"q{joint}" for joint in machine.joints), *ORIENTATION]


def is_full(rows: pd.DataFrame, span: float, rtol: float = 1e-6) -> pd.Series[bool]:
    """Which traverses run the joint's whole range."""
    return pd.Series(np.isclose(traverse_length(rows), span, rtol=rtol, atol=0.0), index=rows.index)


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
