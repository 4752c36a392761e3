"""As many traverses as parameters, the lab's daily calibration (thesis Eqs. 6.2 to 6.4); a constant step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.closed_form import pick_calibration
from stickslip_fit.fit.groups import group_rows
from stickslip_fit.fit.identifiability import describe
from stickslip_fit.laws import StepLaw, constant_law
from stickslip_fit.strategies.calibrated import by_least_squares
from stickslip_fit.strategies.task import Predictor, Task, Unsuited

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class ClosedForm:
    """The thesis's configurations: three traverses of joint 3 each way, four of a rotary joint.

    So many traverses leave one solution, the one that the closed form writes down.
    """

    name: ClassVar[str] = "closed form"

    def choose(self, task: Task) -> Indices:
        """See `Strategy.choose`."""
        return calibration_traverses(task, task.law)

    def calibrate(self, task: Task, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        return by_least_squares(task, task.law, made)


@dataclass(frozen=True)
class ConstantStep:
    """One step size everywhere (thesis Ch. 7), from a traverse in the law's first configuration."""

    name: ClassVar[str] = "constant step"

    def choose(self, task: Task) -> Indices:
        """See `Strategy.choose`."""
        return calibration_traverses(task, constant_law(task.law))

    def calibrate(self, task: Task, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        return by_least_squares(task, constant_law(task.law), made)


def calibration_traverses(task: Task, law: StepLaw) -> Indices:
    """Positions among the offered traverses of a law's own calibration, one for each parameter.

    The law's calibration is asked of the joint's published features, so that a constant step is measured
    in a configuration of the law that it stands beside.

    Raises
    ------
    Unsuited
        If the session lacks one, naming it.
    """
    wanted = task.law.calibration()[: len(law.parameters)]
    picked = pick_calibration(task.law, task.offered, group_rows(task.offered), task.machine)[0]
    picked = picked[: len(wanted)]
    lacking = [describe(configuration) for configuration, k in zip(wanted, picked, strict=True) if k < 0]
    if lacking:
        raise Unsuited(f"the session lacks {'; '.join(lacking)}")
    return picked
