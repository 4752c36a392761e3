"""A manipulator whose laws are known for one session: what every move is worked out from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.fit import Result
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import Machine
from stickslip_fit.machine.load import mean_load

Array = npt.NDArray[np.float64]
CERTAIN = 1.96  # standard deviations on either side of 95 %


@dataclass(frozen=True)
class Traverse:
    """What the law says of one joint's way to another position.

    Attributes
    ----------
    row : DataFrame
        The traverse, one row of a log.
    law : StepLaw
    values : array, shape (p,)
    counts : float
        Steps it takes.
    slopes : array, shape (p,)
        Relative change of the counts with each parameter.
    spread : float
        Relative standard deviation of the counts, from the parameters and the repeatability.
    """

    row: pd.DataFrame
    law: StepLaw
    values: Array
    counts: float
    slopes: Array
    spread: float


@dataclass(frozen=True)
class Calibrated:
    """One session of a result, with the base standing one way.

    Attributes
    ----------
    result : Result
    session : str
    theta, psi : float
        Orientation of the base, rad.
    conditions : mapping of str to object
        What a law with causes in it needs to know of a drive besides, by the log's columns, SI: e.g.
        ``session_seconds``, how long the drive has been running. What is not given has no effect, as for a
        joint's first drive under mean conditions; what has no such value is asked for.
    before : mapping of int to mapping of str to object
        For joints that have been driven since, what their next drive follows, by the log's columns.
    """

    result: Result
    session: str
    theta: float = 0.0
    psi: float = 0.0
    conditions: Mapping[str, Any] = field(default_factory=dict)
    before: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def machine(self) -> Machine:
        """The manipulator that the result was fitted for."""
        return self.result.machine

    def drive(self, q: Array, joint: int, stop: float) -> pd.DataFrame:
        """The traverse that takes `joint` from where it stands in `q` to `stop`; one row of a log."""
        direction = "+" if stop > q[joint - 1] else "-"
        return pd.DataFrame(
            {
                "session": [self.session], "joint": [joint], "direction": [direction],
                "q1": [q[0]], "q2": [q[1]], "q3": [q[2]], "theta": [self.theta], "psi": [self.psi],
                "start": [q[joint - 1]], "stop": [stop],
            }
        ).assign(**{**self.conditions, **self.before.get(joint, {})})  # fmt: skip

    def driven(self, row: pd.DataFrame, steps: int) -> Calibrated:
        """The same after a drive, `row` as `drive` gives it; how long that takes is not counted."""
        joint, counted = int(row["joint"].iloc[0]), row.get("steps_before")
        way = {name: row[name].to_numpy() for name in ("start", "stop", "q1", "q2", "theta", "psi")}
        follows: dict[str, Any] = {
            "before_direction": row["direction"].iloc[0],
            "before_load": float(mean_load(joint, **way)[0]),
        }
        if counted is not None:
            follows["steps_before"] = counted.iloc[0] + steps
        return replace(self, before={**self.before, joint: follows})

    def traverse(self, q: Array, joint: int, stop: float) -> Traverse:
        """What the law says of `joint` going from where it stands in `q` to `stop`, which lies elsewhere.

        Raises
        ------
        InputError
            If the law is not known, or stalls on the way.
        """
        row = self.drive(q, joint, stop)
        law, values, covariance, repeatability = self.law(joint, str(row["direction"].iloc[0]))
        counts, slopes = law.counts(row, values)
        if not np.isfinite(counts[0]):
            raise InputError(
                f"joint {joint} would stall on its way: the law gives a step size of zero or less there"
            )
        relative = slopes[0] / counts[0]
        spread = float(np.hypot(np.sqrt(relative @ covariance @ relative), repeatability))
        return Traverse(row, law, values, float(counts[0]), relative, spread)

    def law(self, joint: int, direction: str) -> tuple[StepLaw, Array, Array, float]:
        """The law of a joint in motion, its parameters, their covariance, and the repeatability.

        Steps that are lost in hearing the stop are left out: a drive that ends before it hears none.

        Raises
        ------
        InputError
            If this session's log did not make them known.
        """
        fit = self.result.joints.get(joint)
        group = fit.groups if fit else pd.DataFrame({"session": [], "direction": []})
        found = np.flatnonzero((group["session"] == self.session) & (group["direction"] == direction))
        if fit is None or not len(found):
            raise InputError(
                f"joint {joint} has no calibration for session {self.session!r}, direction {direction}: "
                "the log holds no such traverse; measure some or choose another session"
            )
        index = int(found[0])
        if not fit.known[index].all():
            reasons = [
                Problem(remark.message)
                for remark in self.result.remarks
                if (remark.joint, remark.session, remark.direction) == (joint, self.session, direction)
            ]
            raise InputError(reasons)
        values, covariance = fit.values[index], fit.covariance[index]
        if isinstance(fit.law, ExtendedLaw):
            moving = fit.law.in_motion(np.stack([values, np.full_like(values, np.nan)]))
            values, counts = moving[0], np.isnan(moving[1])
            covariance = covariance * np.outer(counts, counts)
        return fit.law, values, covariance, fit.repeatability[direction].value


def calibrated(
    result: Result,
    session: str | None = None,
    theta: float = 0.0,
    psi: float = 0.0,
    conditions: Mapping[str, Any] | None = None,
) -> Calibrated:
    """The calibration of a session, the latest unless named; see `Calibrated` for the others.

    Raises
    ------
    InputError
        If the result has no such session.
    """
    sessions = list(dict.fromkeys(name for fit in result.joints.values() for name in fit.groups["session"]))
    latest = {fit.groups["session"].iloc[-1] for fit in result.joints.values()}
    if session is None:
        session = next(name for name in reversed(sessions) if name in latest)
    if session not in sessions:
        raise InputError(f"session {session!r} is not in this result; it has {', '.join(map(str, sessions))}")
    return Calibrated(result, session, theta, psi, conditions or {})
