"""One strategy calibrates one joint and direction in all sessions of many campaigns.

Strategies that fit a law to the traverses made, which are most, are calibrated all at once: least squares
takes campaigns and sessions for its groups. Any other is asked task by task.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.laws import StepLaw, constant_law
from stickslip_fit.strategies.closed_form import ClosedForm, ConstantStep
from stickslip_fit.strategies.least_squares import LeastSquares
from stickslip_fit.strategies.solve import solve
from stickslip_fit.strategies.study.campaigns import Campaigns
from stickslip_fit.strategies.study.design import Cell, task_of
from stickslip_fit.strategies.study.plan import StudyPlan
from stickslip_fit.strategies.task import Predictor, Strategy, Unsuited

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

TRAVERSE = ("direction", "start", "stop", "steps", "check_every")
FITTED: dict[type, Callable[[StepLaw], StepLaw]] = {
    ConstantStep: constant_law,
    ClosedForm: lambda law: law,
    LeastSquares: lambda law: law,
}
"""Strategies that fit a law by least squares, and which, given the published one."""


class Calibrated(Protocol):
    """What the calibrations of c sessions say, those of all campaigns numbered one after the other."""

    def predict(self, rows: pd.DataFrame, number: Indices) -> tuple[Array, Array]:
        """Mean and standard deviation of log(steps), each shape (n,), by each row's session.

        NaN where that session could not be calibrated.
        """
        ...


@dataclass(frozen=True, eq=False)
class Fitted:
    """A law with parameters for each session.

    Attributes
    ----------
    law : StepLaw
    values : array, shape (c, p)
        NaN in sessions that could not be calibrated.
    covariance : array, shape (c, p, p)
    """

    law: StepLaw
    values: Array
    covariance: Array

    def predict(self, rows: pd.DataFrame, number: Indices) -> tuple[Array, Array]:
        """See `Calibrated.predict`."""
        mean, slopes = self.law.model(rows)(self.values[number])
        return mean, np.sqrt(np.einsum("ni,nij,nj->n", slopes, self.covariance[number], slopes))


@dataclass(frozen=True, eq=False)
class Asked:
    """A predictor for each session.

    Attributes
    ----------
    predictors : sequence of Predictor or None
        None in sessions that could not be calibrated.
    """

    predictors: Sequence[Predictor | None]

    def predict(self, rows: pd.DataFrame, number: Indices) -> tuple[Array, Array]:
        """See `Calibrated.predict`."""
        found = np.full((2, len(rows)), np.nan)
        for each in np.unique(number):
            mine, predictor = np.flatnonzero(number == each), self.predictors[each]
            if predictor is not None:
                with suppress(InputError):
                    found[:, mine] = predictor(rows.iloc[mine])
        return found[0], found[1]


def calibrate(
    study: StudyPlan, strategy: Strategy, cells: Sequence[Cell], campaigns: Campaigns
) -> Calibrated:
    """Calibrate every session of every campaign.

    Parameters
    ----------
    study : StudyPlan
    strategy : Strategy
    cells : sequence of Cell
        Of one joint and direction, one for each session, all of which suit the strategy.
    campaigns : Campaigns
    """
    fitted = FITTED.get(type(strategy))
    if fitted is None:
        return task_by_task(study, strategy, cells, campaigns)
    return all_at_once(fitted(cells[0].law), strategy.name, cells, campaigns)


def all_at_once(law: StepLaw, name: str, cells: Sequence[Cell], campaigns: Campaigns) -> Fitted:
    """All sessions of all campaigns in one minimisation."""
    made = [cell.made[name] for cell in cells]
    session = np.repeat(np.arange(len(cells)), [len(each) for each in made])
    number = np.arange(campaigns.count)[:, None] * len(cells) + session
    looked_at = list(dict.fromkeys([*law.columns, *TRAVERSE]))
    rows = campaigns.rows[looked_at].iloc[campaigns.places(np.concatenate(made)).ravel()]
    # The number of the session is what tells groups apart.
    found = solve(law, rows.assign(session=number.ravel()), cells[0].repeatability)
    of_group = found.groups.table["session"].to_numpy(np.intp)
    p = found.values.shape[1]
    values = np.full((campaigns.count * len(cells), p), np.nan)
    covariance = np.full((*values.shape, p), np.nan)
    known = found.known.all(axis=1)
    values[of_group[known]], covariance[of_group[known]] = found.values[known], found.covariance[known]
    return Fitted(law, values, covariance)


def task_by_task(study: StudyPlan, strategy: Strategy, cells: Sequence[Cell], campaigns: Campaigns) -> Asked:
    """Each session of each campaign by itself, as on a measured log."""
    predictors: list[Predictor | None] = []
    for k in range(campaigns.count):
        rows = campaigns.one(k)
        predictors += [_predictor(study, strategy, cell, rows) for cell in cells]
    return Asked(predictors)


def _predictor(study: StudyPlan, strategy: Strategy, cell: Cell, rows: pd.DataFrame) -> Predictor | None:
    try:
        return strategy.calibrate(task_of(study, cell, rows), rows.iloc[cell.made[strategy.name]])
    except (Unsuited, InputError):
        return None
