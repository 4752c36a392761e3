"""A law's parameters from the traverses that a calibration makes, for any number of sessions at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.identifiability import known_parameters
from stickslip_fit.fit.problem import single_problem
from stickslip_fit.fit.terms import DEFAULT_OPTIONS
from stickslip_fit.laws import StepLaw

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solved:
    """Least squares with the scatter known.

    Attributes
    ----------
    groups : Groups
        Of session and direction.
    values : array, shape (g, p)
        Parameters, SI.
    known : array of bool, shape (g, p)
        Which of them the traverses determine.
    covariance : array, shape (g, p, p)
        The inverse of the Fisher information.
    """

    groups: Groups
    values: Array
    known: npt.NDArray[np.bool_]
    covariance: Array


def solve(law: StepLaw, rows: pd.DataFrame, repeatability: float) -> Solved:
    """Fit a law to rows, each session and direction by itself.

    Traverses that are as many as the parameters leave one solution, which is that of the closed form.

    Parameters
    ----------
    law : StepLaw
    rows : DataFrame, n rows of one joint
    repeatability : float
        Standard deviation of log(steps); the counts' rounding comes on top.
    """
    problem = single_problem(law, rows, DEFAULT_OPTIONS)
    found = problem.minimise(1.0 / (repeatability**2 + problem.rounding), problem.start)
    known, _, covariance = known_parameters(found.curvature, problem.scales)
    return Solved(problem.groups, found.values, known & found.converged[:, None], covariance)


def spread(jacobian: Array, covariance: Array) -> Array:
    """Standard deviation of responses under uncertain parameters, (n, p) and (p, p) -> (n,)."""
    return np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian))
