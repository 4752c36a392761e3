"""Finding, Gain and NextTraverse: what a diagnosis consists of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from stickslip_fit.causes import SizedParameter
from stickslip_fit.units import Interval


@dataclass(frozen=True)
class Gain:
    """Rms error of the step size (relative) on held-out traverses, before and after extending the law.

    Attributes
    ----------
    baseline, extended : float
    noise_floor : float
        The error of the true law: repeatability and rounding.
    low, high : float
        95 % interval of `baseline` less `extended` for a replicate of the campaign.
    by_session : DataFrame
        session, baseline, extended, traverses.
    """

    baseline: float
    extended: float
    noise_floor: float
    low: float
    high: float
    by_session: pd.DataFrame


@dataclass(frozen=True)
class Finding:
    """A named cause, or structure without a known cause.

    Attributes
    ----------
    cause : str
        ``unknown`` for structure without a known cause.
    version : object or None
        The cause as it acts in this log; None for unknown structure and outlying counts.
    equivalent : tuple of str
        Causes that this log cannot separate from it.
    p_value : float
    joints : tuple of int
    effect : Interval
        Rms over all rows of the relative change in the count, beyond what calibration absorbs.
    parameters : tuple of SizedParameter
    gain : Gain or None
        From the law with the findings before it to the law with this one too.
    closest, share : str, float
        For ``unknown``: the closest cause, and the share of the structure's square that it explains.
    carrier : str
        For ``unknown``: the variable that the structure follows.
    traverses : DataFrame or None
        For outlying counts: those rows, with `departure` (relative) from the law.
    note : str
        For ``unknown``: the causes that are not named, and why.
    """

    cause: str
    version: Any
    equivalent: tuple[str, ...]
    p_value: float
    joints: tuple[int, ...]
    effect: Interval
    parameters: tuple[SizedParameter, ...]
    gain: Gain | None = None
    closest: str = ""
    share: float = 0.0
    carrier: str = ""
    traverses: pd.DataFrame | None = None
    note: str = ""

    @property
    def cause_set(self) -> tuple[str, ...]:
        """The likeliest cause, then those that the log cannot separate from it."""
        return (self.cause, *self.equivalent)


@dataclass(frozen=True)
class NextTraverse:
    """A traverse to make next; angles rad, lengths m, NaN where the value does not matter.

    Attributes
    ----------
    session : str
        ``new``.
    joint : int
    direction : str
    q1, q2, q3, theta, psi, start, stop : float
    repeats : int
    tells_apart : tuple of str
        The causes that it separates, or the one that it makes testable.
    note : str
        When to make it, where that matters.
    """

    session: str
    joint: int
    direction: str
    q1: float
    q2: float
    q3: float
    theta: float
    psi: float
    start: float
    stop: float
    repeats: int
    tells_apart: tuple[str, ...]
    note: str = ""
