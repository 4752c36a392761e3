"""Predictions from a law whose parameters a few traverses have settled."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.laws import StepLaw
from stickslip_fit.strategies.solve import solve, spread
from stickslip_fit.strategies.task import Predictor, Task, Unsuited

Array = npt.NDArray[np.float64]


def by_least_squares(task: Task, law: StepLaw, made: pd.DataFrame) -> Predictor:
    """Predict by the law that fits the traverses made best.

    Raises
    ------
    Unsuited
        If they leave a parameter open.
    """
    found = solve(law, made, task.repeatability)
    if not found.known.all():
        names = [parameter.name for parameter in law.parameters]
        open_ones = ", ".join(name for name, known in zip(names, found.known[0], strict=True) if not known)
        raise Unsuited(f"its {len(made)} traverses leave {open_ones} open")
    return from_parameters(law, found.values[0], found.covariance[0])


def from_parameters(law: StepLaw, values: Array, covariance: Array) -> Predictor:
    """Predict by parameters, shape (p,), that are uncertain by a covariance, shape (p, p)."""

    def predict(rows: pd.DataFrame) -> tuple[Array, Array]:
        response, jacobian = law.model(rows)(np.broadcast_to(values, (len(rows), len(values))))
        return response, spread(jacobian, covariance)

    return predict
