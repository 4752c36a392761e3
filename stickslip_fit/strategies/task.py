"""What a calibration strategy is given: a joint and direction of a session, before any of it is driven."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.groups import mean_steps
from stickslip_fit.fit.repeatability import CONFIGURATION
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import Machine
from stickslip_fit.strategies.solve import solve

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Predictor = Callable[[pd.DataFrame], tuple[Array, Array]]
"""Rows of a log to the mean of log(steps) and its standard deviation, the repeatability left out; (n,)."""


class Unsuited(Exception):
    """A strategy cannot calibrate this session; the message says why, and what it would need."""


@dataclass(frozen=True, eq=False)
class Task:
    """One joint and direction of a session that is to be calibrated.

    Attributes
    ----------
    session : str
    direction : {"+", "-"}
    law : StepLaw
        The published one of the joint, or what stands in its place.
    machine : Machine
    offered : DataFrame
        The first traverse of each of the session's configurations, in order of time and without the counts:
        a strategy chooses among them before it knows any.
    others : DataFrame
        All usable traverses, counts included, of the sessions that it may look back on.
    repeatability : float
        What the lab knows of the scatter of log(steps).
    """

    session: str
    direction: str
    law: StepLaw
    machine: Machine
    offered: pd.DataFrame
    others: pd.DataFrame
    repeatability: float

    @cached_property
    def nominal(self) -> tuple[Array, Array]:
        """Parameters near which to plan, and changes of them that matter, each shape (p,).

        The mean of the other sessions where they know all parameters; else those of a law without effects,
        with steps of length one: how much a traverse tells does not depend on the length of a step.
        """
        if len(self.others):
            found = solve(self.law, self.others, self.repeatability)
            if found.known.all(axis=1).any():
                values = found.values[found.known.all(axis=1)].mean(axis=0)
                y, _ = self.law.response(self.others)
                step = mean_steps(found.groups, self.others, y).mean(keepdims=True)
                return values, self.law.scales(step)[0]
        one = np.ones(1)
        return self.law.start_values(one)[0], self.law.scales(one)[0]


class Strategy(Protocol):
    """A way to calibrate. Anything that has these three is one.

    Examples
    --------
    The mean step of whatever was driven first:

    >>> class FirstOfAll:
    ...     name = "first traverse"
    ...     def choose(self, task):
    ...         return np.array([0])
    ...     def calibrate(self, task, made):
    ...         step = abs(made["stop"] - made["start"]).sum() / made["steps"].sum()
    ...         return lambda rows: (np.log(abs(rows["stop"] - rows["start"]) / step), np.zeros(len(rows)))
    """

    @property
    def name(self) -> str:
        """As tables and pictures call it; no two compared strategies have the same."""
        ...

    def choose(self, task: Task) -> Indices:
        """Which of the offered traverses to make, as positions among them.

        Raises
        ------
        Unsuited
            If the session does not offer what the strategy needs.
        """
        ...

    def calibrate(self, task: Task, made: pd.DataFrame) -> Predictor:
        """What the traverses made, with their counts now, say of any other of the session.

        Raises
        ------
        Unsuited
            If they do not determine what the strategy needs to know.
        """
        ...


def first_of_each(rows: pd.DataFrame) -> pd.DataFrame:
    """The earliest traverse of each configuration."""
    return rows[~rows[CONFIGURATION].round(9).duplicated()]
