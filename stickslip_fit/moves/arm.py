"""CalibratedArm: one session of a fit in use, with the base in one orientation and its conditions.

It gives the law, parameters and history for each joint's next drive. Laws with causes may need
conditions such as temperature, spelled as the columns of a log are.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import format_value, join_words
from stickslip_fit._typing import Array
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.causes.parameters import FIRST_TRAVERSE, REQUIRED_HISTORY
from stickslip_fit.errors import InputError, InputIssue, check_type, suggest
from stickslip_fit.estimation import Result
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs.history import MOVES, TIME_OF_DAY, condition_of
from stickslip_fit.logs.schema import CONDITION_SPELLINGS, COVARIATE_PREFIX
from stickslip_fit.machine import Machine, mean_load
from stickslip_fit.machine.machine import PREDICT_DRIVES
from stickslip_fit.units import JOINTS, PRISMATIC, to_si

if TYPE_CHECKING:
    from stickslip_fit.bayes import Posterior


@dataclass(frozen=True)
class JointTravel:
    """One joint's drive to another position, by the law.

    Attributes
    ----------
    row : DataFrame
        The traverse, one row of a log.
    values : array, shape (p,)
    counts : float
        Expected steps.
    slopes : array, shape (p,)
        Derivatives of log(counts) by the parameters.
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
class CalibratedArm:
    """One session of a result, with the base in one orientation.

    Attributes
    ----------
    theta, psi : float
        Orientation of the base, rad.
    conditions : mapping of str to object
        Other columns of the log on which a law with causes depends, SI: e.g. ``session_seconds``. A missing
        one has no effect, as in a joint's first drive under mean conditions; `check_conditions` refuses what
        has no such default.
    history : mapping of int to mapping of str to object
        For joints that have been driven, the history columns of their next drive.
    """

    result: Result
    session: str
    theta: float = 0.0
    psi: float = 0.0
    conditions: Mapping[str, Any] = field(default_factory=dict)
    history: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def machine(self) -> Machine:
        """The manipulator that the result was fitted for."""
        return self.result.machine

    def drive_row(self, q: Array, joint: int, stop: float) -> pd.DataFrame:
        """The traverse of `joint` from its position in `q` to `stop`, one row of a log."""
        direction = "+" if stop > q[joint - 1] else "-"
        return self.drive_rows(np.reshape(q, (1, 3)), joint, direction, np.array([stop]))

    def drive_rows(self, q: Array, joint: int, direction: str, stop: Array) -> pd.DataFrame:
        """The traverses of `joint` from its positions in `q`, shape (n, 3), to `stop`, shape (n,)."""
        return pd.DataFrame(self.drive_columns(q, joint, direction, stop))

    def drive_columns(self, q: Array, joint: int, direction: str, stop: npt.ArrayLike) -> dict[str, Any]:
        """The columns of `drive_rows`, each an array of shape (n,)."""
        columns: dict[str, Any] = {"session": self.session, "joint": joint, "direction": direction}
        columns |= {f"q{number}": q[:, number - 1] for number in JOINTS}
        columns |= {"theta": self.theta, "psi": self.psi, "start": q[:, joint - 1], "stop": stop}
        columns |= {**self.conditions, **self.history.get(joint, {})}
        return {
            name: np.full(len(q), value, object if isinstance(value, str) else None)
            for name, value in columns.items()
        }

    def after_drive(self, row: pd.DataFrame, steps: int) -> CalibratedArm:
        """The arm after a drive, `row` as `drive_row` returns it; session_seconds stays the same."""
        joint = int(row["joint"].iloc[0])
        travel = {name: row[name].to_numpy() for name in ("start", "stop", "q1", "q2", "theta", "psi")}
        load = float(mean_load(joint, **travel)[0])
        history = {"before_direction": row["direction"].iloc[0], "before_load": load}
        if "steps_before" in row:
            history["steps_before"] = row["steps_before"].iloc[0] + steps
        return replace(self, history={**self.history, joint: history})

    def joint_travel(self, q: Array, joint: int, stop: float) -> JointTravel:
        """The drive of `joint` from its position in `q` to another one, `stop`.

        Raises
        ------
        InputError
            If the law is not calibrated, or stalls on the way.
        """
        row = self.drive_row(q, joint, stop)
        law, values, covariance, repeatability = self.law(joint, str(row["direction"].iloc[0]))
        counts, slopes = law.counts(row, values)
        if not np.isfinite(counts[0]):
            raise InputError(
                f"joint {joint} would stall on its way: the law gives a step size of zero or less there"
            )
        relative = slopes / counts[:, None]
        spread = relative_spread(relative, covariance, repeatability)
        return JointTravel(row, law, values, float(counts[0]), relative[0], float(spread[0]))

    def law(self, joint: int, direction: str) -> tuple[StepLaw, Array, Array, float]:
        """The law of a joint in motion, its parameters, their covariance, and the repeatability.

        Steps lost in detecting the stop are left out: a drive that ends before the stop loses none.

        Raises
        ------
        InputError
            If the session has no calibration, or not all parameters.
        """
        fit = self.result.joints.get(joint)
        group = fit.groups if fit else pd.DataFrame({"session": [], "direction": []})
        positions = np.flatnonzero((group["session"] == self.session) & (group["direction"] == direction))
        if fit is None or not len(positions):
            raise InputError(
                f"joint {joint} has no calibration for session {self.session!r}, direction {direction}: "
                "the log holds no such traverse; measure some or choose another session"
            )
        index = int(positions[0])
        if not fit.known[index].all():
            reasons = [
                InputIssue(flag.message)
                for flag in self.result.flags
                if (flag.joint, flag.session, flag.direction) == (joint, self.session, direction)
            ]
            raise InputError(reasons)
        values, covariance = fit.values[index], fit.covariance[index]
        if isinstance(fit.law, ExtendedLaw):
            moving = fit.law.without_stop_effects(np.stack([values, np.full_like(values, np.nan)]))
            values, varied = moving[0], np.isnan(moving[1])
            covariance = covariance * np.outer(varied, varied)
        return fit.law, values, covariance, fit.repeatability[direction].value


def relative_spread(slopes: Array, covariance: Array, repeatability: float) -> Array:
    """Relative standard deviation of counts, shape (n,), from the slopes of their logarithms, (n, p)."""
    return np.sqrt(np.einsum("ni,ij,nj->n", slopes, covariance, slopes) + repeatability**2)


def scale_covariance(covariance: Array) -> tuple[Array, Array]:
    """Standard deviations, 1 for what is held fixed, shape (p,), and the covariance in their units, (p, p).

    Parameters differ in unit by many powers of ten, which decompositions do not survive.
    """
    variance = np.diag(covariance)
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    return scale, covariance / np.outer(scale, scale)


def invert_covariance(covariance: Array) -> Array:
    """Inverse of the covariance of parameters, shape (p, p); 0 for those that are held fixed."""
    scale, correlation = scale_covariance(covariance)
    return np.linalg.pinv(correlation, hermitian=True) / np.outer(scale, scale)


def calibrated_arm(
    result: Result,
    session: str | None = None,
    theta: float = 0.0,
    psi: float = 0.0,
    conditions: Mapping[str, Any] | None = None,
) -> CalibratedArm:
    """The calibration of a session, by default the latest; see `CalibratedArm` for the others.

    Raises
    ------
    InputError
        If the result has no such session, its machine no published geometry, or `conditions` has another name
        than those of a log's conditions and of columns on which the law depends, or a time or steps below 0.
    """
    check_type("result", result, Result)
    result.machine.require_geometry("moves and positions of the tip", PREDICT_DRIVES)
    sessions = list(dict.fromkeys(name for fit in result.joints.values() for name in fit.groups["session"]))
    latest = {fit.groups["session"].iloc[-1] for fit in result.joints.values()}
    if session is None:
        session = next(name for name in reversed(sessions) if name in latest)
    if session not in sessions:
        raise InputError(f"session {session!r} is not in this result; it has {', '.join(map(str, sessions))}")
    check_given_conditions(conditions or {}, result)
    return CalibratedArm(result, session, theta, psi, conditions or {})


def check_given_conditions(
    conditions: Mapping[str, Any], law: Result | Posterior, others: Collection[str] = ()
) -> None:
    """Refuse conditions that no drive can have, all at once.

    Parameters
    ----------
    conditions : mapping of str to object
    law : Result or Posterior
    others : collection of str
        Further columns that may be given.

    Raises
    ------
    InputError
        Naming each that is neither a log's condition nor a column on which the law depends nor among the
        others, and each time or number of steps below 0.
    """
    known = [*(column for column, _ in CONDITION_KEYS.values()), *_result_columns(law), *others]
    known, issues = list(dict.fromkeys(known)), []
    for name, value in conditions.items():
        if name not in known:
            message = f"is no condition; give {join_words(known, 'or')}{suggest(name, known)}"
        elif not _is_within(name, value):
            message = LIMITED[name][1]
        else:
            continue
        issues.append(InputIssue(message, argument="conditions", value=f"{name}={value}"))
    if issues:
        raise InputError(issues)


def as_calibrated_arm(arm: CalibratedArm | Result) -> CalibratedArm:
    """An arm as it is; a Result as the arm of its latest session, the base at theta = psi = 0."""
    check_type("arm", arm, CalibratedArm, Result)
    return calibrated_arm(arm) if isinstance(arm, Result) else arm


CONDITION_KEYS = {
    "session_min": ("session_seconds", "min"),
    "session_s": ("session_seconds", "s"),
    "session_h": ("session_seconds", "h"),
    "time_of_day_h": (TIME_OF_DAY, "h"),
    "steps_before": ("steps_before", "steps"),
    **CONDITION_SPELLINGS,
}
CONDITION_MEANINGS = {
    "session_seconds": "how long the session has run",
    "steps_before": REQUIRED_HISTORY["steps_before"],
}
# What follows from the drives and the session.
OWN_COLUMNS = ("session", *(name for name in FIRST_TRAVERSE if name != TIME_OF_DAY))
# From 0 to what they may be, and what to say of others.
LIMITED = {
    "session_seconds": (
        inf,
        "a session's time is counted from its first traverse on; give a number of 0 or more",
    ),
    TIME_OF_DAY: (
        86_400.0,
        "the time of day is counted from midnight to midnight; give 0 to 24 h (86,400 s)",
    ),
    "steps_before": (inf, "steps are counted from the joint's first one on; give a number of 0 or more"),
}
REQUIRED_CONDITIONS = (*REQUIRED_HISTORY, "step_period")  # given, or the plan's


def required_columns(laws: Iterable[StepLaw]) -> tuple[str, ...]:
    """Columns of a log, beside positions and angles, on which laws depend."""
    causes = [cause for law in laws if isinstance(law, ExtendedLaw) for cause, _ in law.active_causes]
    names = (condition_of(name) for cause in causes for name in cause.columns if name not in MOVES)
    return tuple(dict.fromkeys(name for name in names if name not in OWN_COLUMNS))


def parse_conditions(texts: Iterable[str], result: Result, option: str) -> dict[str, float]:
    """Conditions such as "temperature_C=23" or "session_min=30", by a log's columns, SI.

    Parameters
    ----------
    texts : iterable of str
    result : Result
        A condition on which none of its laws depends is refused, since it would have no effect.
    option : str
        Its name in messages.

    Raises
    ------
    InputError
    """
    columns, conditions = _result_columns(result), dict[str, float]()
    known = CONDITION_KEYS | {
        name.removeprefix(COVARIATE_PREFIX): (name, "1")
        for name in columns
        if name.startswith(COVARIATE_PREFIX)
    }
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        column, unit = known.get(name, ("", "1"))
        if column not in columns:
            column_names = ", ".join(map(column_key, columns)) or "nothing beside positions and angles"
            message = f"this law depends on {column_names}; leave {name or text} out"
            raise InputError(InputIssue(message, column=option, value=text))
        try:
            number = float(value)
        except ValueError:
            number = nan
        conditions[column] = to_si(number, unit)
        if not isfinite(number) or not _is_within(column, conditions[column]):
            fault = LIMITED[column][1] if isfinite(number) else "give a number"
            raise InputError(InputIssue(f"{fault}, e.g. {name}=20", column=option, value=text))
    return conditions


def _is_within(column: str, value: object) -> bool:
    if column not in LIMITED:
        return True
    return isinstance(value, int | float | np.number) and 0 <= float(value) <= LIMITED[column][0]


def check_conditions(result: Result, conditions: Mapping[str, Any], option: str) -> None:
    """Refuse conditions without those that have no default.

    Raises
    ------
    InputError
        Naming each missing condition as `parse_conditions` reads it.
    """
    missing = [
        name for name in _result_columns(result) if name in REQUIRED_HISTORY and name not in conditions
    ]
    if missing:
        message = "the law depends on {}: give {} {}=NUMBER"
        raise InputError(
            [
                InputIssue(message.format(CONDITION_MEANINGS[name], option, column_key(name)))
                for name in missing
            ]
        )


def describe_conditions(result: Result, conditions: Mapping[str, Any], option: str) -> str:
    """Which conditions were not given and have their default; empty where there are none."""
    defaults = [
        f"{option} {column_key(name)}"
        for name in _result_columns(result)
        if name not in {*conditions, *REQUIRED_CONDITIONS}
    ]
    return f"as on average in the log, since not given: {', '.join(defaults)}" if defaults else ""


def column_key(column: str) -> str:
    """A column's key in `parse_conditions`, with its usual unit.

    Examples
    --------
    >>> [column_key(name) for name in ("temperature", "session_seconds", "covariate:pressure_hPa")]
    ['temperature_C', 'session_min', 'pressure_hPa']
    """
    keys = [typed for typed, (name, _) in CONDITION_KEYS.items() if name == column]
    return keys[0] if keys else column.removeprefix(COVARIATE_PREFIX)


def _result_columns(law: Result | Posterior) -> tuple[str, ...]:
    return required_columns(fit.law for fit in law.joints.values())


def check_positions(machine: Machine, q: Array, name: str) -> None:
    """Refuse joint positions outside the machine's ranges.

    Raises
    ------
    InputError
        Naming the first such joint, with its position and its range.
    """
    for joint, (low, high) in machine.ranges.items():
        if not low - 1e-9 <= q[joint - 1] <= high + 1e-9:
            unit = "mm" if joint == PRISMATIC else "deg"
            texts = [format_value(value, unit, 2) for value in (q[joint - 1], low, high)]
            raise InputError(f"{name} q{joint} = {texts[0]} is outside its range, {texts[1]} to {texts[2]}")
