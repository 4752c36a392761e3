"""What a law is made of: parameters, and the configurations that make them known."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan


@dataclass(frozen=True)
class Parameter:
    """A parameter of a law.

    Attributes
    ----------
    name : str
    unit : str
        Symbol of the unit in which people see it; inside it is SI.
    lower, upper : float
        Bounds of what is physically possible, SI.
    meaning : str
        A phrase for tables and reports.
    """

    name: str
    unit: str
    meaning: str
    lower: float = -inf
    upper: float = inf


@dataclass(frozen=True)
class Configuration:
    """Where the joints and the base stand while one joint makes its full traverse; rad and m.

    Attributes
    ----------
    label : str
        What is special about it, in words.
    q1, q2, q3 : float
        Joint positions; NaN for the joint that moves.
    theta, psi : float
        Orientation of the base.
    """

    label: str
    q1: float = 0.0
    q2: float = nan
    q3: float = nan
    theta: float = 0.0
    psi: float = 0.0
