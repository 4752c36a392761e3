"""Step sizes at the joints' present positions, fast enough for a loop of 10 ms.

The step size of a law and its derivatives by the parameters are computed once and kept until a joint has
moved by `CELL`, or the time or the steps made have gone on by so much that a law could tell: it changes by a
few parts in 10,000 within such a cell, a tenth of the repeatability.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.causes.parameters import collect_row_values
from stickslip_fit.errors import InputError
from stickslip_fit.laws import StepLaw, state_at
from stickslip_fit.moves.arm import CalibratedArm
from stickslip_fit.simulation.truth import Group

CELL = (1e-3, 1e-3, 40e-6)  # rad, rad, m; 50 µm of the tip
CELL_SECONDS = 2.0  # a drive warms up within minutes
CELL_STEPS = 1000


@dataclass(frozen=True, eq=False)
class LocalStep:
    """A joint's step in one direction.

    Attributes
    ----------
    size : float
        rad or m, above 0.
    slopes : array, shape (p,)
        Derivatives of log(size) by the law's parameters.
    """

    size: float
    slopes: Array


@dataclass(frozen=True)
class MotionHistory:
    """What a joint's next step follows: direction and mean load of its last motion, all its steps so far."""

    direction: str = ""
    load: float = 0.0
    steps: int = 0


@dataclass(frozen=True, eq=False)
class _Cell:
    q: tuple[float, float, float]
    seconds: float
    steps: int
    step: LocalStep


class LocalSteps:
    """The steps of a calibrated arm wherever its joints are.

    Parameters
    ----------
    arm : CalibratedArm
        Its condition ``session_seconds`` holds at the time 0.
    """

    def __init__(self, arm: CalibratedArm) -> None:
        self.arm = arm
        self._laws: dict[Group, tuple[StepLaw, Array, Array, float]] = {}
        self._cells: dict[tuple[int, str, str], _Cell] = {}

    def law(self, joint: int, direction: str) -> tuple[StepLaw, Array, Array, float]:
        """See `CalibratedArm.law`, which looks it up anew each time.

        Raises
        ------
        InputError
            As there, and if the law has no error bars.
        """
        key = (joint, direction)
        if key not in self._laws:
            law, values, covariance, repeatability = self.arm.law(joint, direction)
            if not (np.isfinite(covariance).all() and np.isfinite(repeatability)):
                raise InputError(
                    f"joint {joint}, direction {direction}: the calibration has no error bars, so that "
                    "nobody could say where the tip is; fit a log with repeated traverses"
                )
            self._laws[key] = law, values, covariance, repeatability
        return self._laws[key]

    def at(
        self, joint: int, direction: str, q: list[float], seconds: float, history: MotionHistory
    ) -> LocalStep:
        """The step of a joint at `q`, shape (3,), at a time (s since the arm's ``session_seconds``).

        Raises
        ------
        InputError
            If the joint is not calibrated, or stalls there.
        """
        key = (joint, direction, history.direction)
        cell = self._cells.get(key)
        if cell is not None:
            then = cell.q
            near = (
                abs(q[0] - then[0]) < CELL[0]
                and abs(q[1] - then[1]) < CELL[1]
                and abs(q[2] - then[2]) < CELL[2]
            )
            if (
                near
                and abs(seconds - cell.seconds) < CELL_SECONDS
                and abs(history.steps - cell.steps) < CELL_STEPS
            ):
                return cell.step
        step = self._compute(joint, direction, q, seconds, history)
        self._cells[key] = _Cell((q[0], q[1], q[2]), seconds, history.steps, step)
        return step

    def steps_added(
        self, joint: int, direction: str, q: list[float], seconds: float, history: MotionHistory
    ) -> tuple[float, Array]:
        """Steps that causes add to a motion that begins, as those lost at a reversal; and their derivatives.

        Returns
        -------
        steps : float
        slopes : array, shape (p,)
        """
        law, values, _, _ = self.law(joint, direction)
        slopes = np.zeros(len(values))
        if not (isinstance(law, ExtendedLaw) and law.by_stage["count"]):
            return 0.0, slopes
        row = self._row(joint, direction, q, seconds, history)

        def added(shifted: Array) -> Array:
            return law.steps_added_by_causes(row, shifted)

        for _, columns in law.by_stage["count"]:
            for k in columns:
                slopes[k] = law.difference(added, values[None], k)[0]
        return float(added(values[None])[0]), slopes

    def _compute(
        self, joint: int, direction: str, q: list[float], seconds: float, history: MotionHistory
    ) -> LocalStep:
        law, values, _, _ = self.law(joint, direction)
        row: Any = self._row(joint, direction, q, seconds, history)
        if isinstance(law, ExtendedLaw):
            row = collect_row_values(row, law.columns)
        state = state_at(joint, row, np.array([[q[joint - 1]]]))
        size = float(law.gamma(state, values[None]).ravel()[0])
        if not size > 0:
            raise InputError(
                f"joint {joint} stalls where it is: the law gives a step size of zero or less in direction "
                f"{direction}; drive another joint first, or fit the law anew"
            )
        slopes = np.asarray(law.gamma_slopes(state, values[None])).reshape(-1, len(values))[0]
        return LocalStep(size, slopes / size)

    def _row(
        self, joint: int, direction: str, q: list[float], seconds: float, history: MotionHistory
    ) -> dict[str, Any]:
        """A traverse that begins here, in a log's columns; it need not end within the joint's range."""
        conditions = dict(self.arm.conditions)
        if "session_seconds" in conditions:
            conditions["session_seconds"] += seconds
        if "steps_before" in conditions:
            conditions["steps_before"] += history.steps
        before = {"before_direction": history.direction, "before_load": history.load}
        arm = replace(self.arm, conditions=conditions, history={joint: before})
        span = arm.machine.span(joint) * (1.0 if direction == "+" else -1.0)
        return arm.drive_columns(np.reshape(q, (1, 3)), joint, direction, q[joint - 1] + span)
