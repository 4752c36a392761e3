"""The step size along a joint's travel, as a finding that follows the joint's own position has it.

The profile is relative to its mean along the travel that the traverses cover, since that mean is a session's
own step size. Its errors are those of the function's coefficients, by the delta method.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import floor, log10
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import format_number, format_uncertain, position_unit
from stickslip_fit._typing import Array, JointKinds
from stickslip_fit.causes.kinds import FactorCause
from stickslip_fit.diagnosis.finding import TravelProfile
from stickslip_fit.estimation.profile import N_PLACES, follows_travel
from stickslip_fit.laws import state_at
from stickslip_fit.units import from_si

PLACES_PER_TRAVEL = 50  # to which a place is told, at least
DIFFERENCE = 1e-3  # of a parameter's scale, for derivatives
EQUAL = 1e-9  # relative step sizes, within which two directions have one profile


def find_travel_profiles(
    version: Any, values: Array, covariance: Array, joints: Sequence[int], rows: pd.DataFrame
) -> tuple[TravelProfile, ...]:
    """The profiles of a cause, or of what is proposed for unknown structure.

    Parameters
    ----------
    version : object
        As it acts in the log.
    values, covariance : array, shapes (q,) and (q, q)
        Of its parameters.
    joints : sequence of int
        On which it acts.
    rows : DataFrame
        Traverses of the log, whose stretches tell the travel.

    Returns
    -------
    tuple of TravelProfile
        By joint, by session where each has a function of its own, and by direction where these differ. None
        where `version` follows anything besides the position.
    """
    if not follows_travel(version):
        return ()
    found: list[TravelProfile] = []
    for joint in joints:
        own = rows[rows["joint"] == joint]
        for session in getattr(version, "sessions", ()) or ("",):
            driven = own[own["session"].astype(object) == session] if session else own
            ends = driven[["start", "stop"]].to_numpy(float)
            if not len(ends):
                continue
            places = np.linspace(ends.min(), ends.max(), N_PLACES)
            ways = [way for way in "+-" if (driven["direction"] == way).any()]
            found += _by_direction(
                [_compute(version, values, covariance, joint, way, session, places) for way in ways]
            )
    return tuple(found)


def format_extremes(profile: TravelProfile, machine: JointKinds) -> tuple[str, str]:
    """Where the step size is smallest and where it is largest, with its change there.

    Examples
    --------
    >>> import numpy as np
    >>> from stickslip_fit.machine import load_machine
    >>> place = np.linspace(0.0, 0.012, 5)
    >>> profile = TravelProfile(3, "", "", place, np.array([0.01, 0.02, 0.0, -0.03, 0.0]), np.full(5, 0.004))
    >>> format_extremes(profile, load_machine())
    ('9.0 mm (−3.0 ± 0.4 %)', '3.0 mm (+2.0 ± 0.4 %)')
    """
    unit = position_unit(profile.joint, machine)
    position = np.asarray(from_si(profile.position, unit))
    decimals = max(0, -floor(log10(np.ptp(position) / PLACES_PER_TRAVEL)))
    beside = "°" if unit == "deg" else f" {unit}"
    least, most = (
        f"{format_number(float(profile.position[k]), unit, decimals)}{beside} "
        f"({'+' if profile.change[k] > 0 else ''}"
        f"{format_uncertain(float(profile.change[k]), float(profile.error[k]), '%')})"
        for k in (int(np.argmin(profile.change)), int(np.argmax(profile.change)))
    )
    return least, most


def _by_direction(profiles: Sequence[TravelProfile]) -> Iterator[TravelProfile]:
    """Those in which anything varies; one for both directions where they are the same."""
    varying = [one for one in profiles if np.ptp(one.change) > EQUAL]
    same = len(varying) == 2 and np.allclose(varying[0].change, varying[1].change, rtol=0.0, atol=EQUAL)
    yield from [replace(varying[0], direction="")] if same else varying


def _compute(
    version: FactorCause,
    values: Array,
    covariance: Array,
    joint: int,
    direction: str,
    session: str,
    places: Array,
) -> TravelProfile:
    way = 1.0 if direction == "+" else -1.0
    row = {"start": [0.0], "stop": [way], "session": np.array([session], dtype=object)}
    state = state_at(joint, row, places[None])
    factor = version.factor_of(state, values[None])[0]
    slopes = version.factor_slopes(state, list(values[None].T[:, :, None]))
    jacobian = _differentiate(version, state, values) if slopes is None else slopes[0]
    mean = factor.mean()
    change = factor / mean - 1.0
    relative = (jacobian - (1.0 + change)[:, None] * jacobian.mean(axis=0)) / mean
    acting = np.flatnonzero(relative.any(axis=0))  # of functions of many sessions those of one
    relative, own = relative[:, acting], covariance[np.ix_(acting, acting)]
    error = np.sqrt(np.maximum(np.vecdot(relative @ own, relative), 0.0))
    return TravelProfile(joint, direction, session, places, change, error)


def _differentiate(version: FactorCause, state: Any, values: Array) -> Array:
    """Derivatives of the factor, shape (k, q), by central differences."""
    steps = DIFFERENCE * np.array(version.scale)
    slopes = []
    for step, one in zip(steps, np.diag(steps), strict=True):
        up, down = (version.factor_of(state, (values + sign * one)[None])[0] for sign in (1.0, -1.0))
        slopes.append((up - down) / (2.0 * step))
    return np.stack(slopes, axis=1)
