"""Least squares on a number of traverses, however they are chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.strategies.calibrated import by_least_squares
from stickslip_fit.strategies.designs import Design
from stickslip_fit.strategies.task import Predictor, Task

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class LeastSquares:
    """Fit the law to as many traverses as it has parameters, and some more.

    Attributes
    ----------
    design : Design
        Which traverses.
    more : int
        How many beyond the number of parameters.
    """

    design: Design
    more: int = 0

    @property
    def name(self) -> str:
        """See `Strategy.name`."""
        return f"least squares, {self.design.name}{f' +{self.more}' if self.more else ''}"

    def choose(self, task: Task) -> Indices:
        """See `Strategy.choose`."""
        return self.design.pick(task, len(task.law.parameters) + self.more)

    def calibrate(self, task: Task, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        return by_least_squares(task, task.law, made)
