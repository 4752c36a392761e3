"""Candidate traverses for the next experiment: configurations, ranges, times and conditions.

Arm and base take the angles that can be set by hand; ranges are whole or cut into equal stretches. Each
candidate has the history that it would have: after or before the calibration, after waiting or driving,
after other traverses, or under other conditions.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.experiments import Forecast, forecast_session
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.estimation.identifiability import configuration_rows
from stickslip_fit.laws import rounding_variance
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX
from stickslip_fit.machine import Machine, mean_load
from stickslip_fit.units import from_si

WAITING_HOURS = (1.0, 2.0, 4.0, 7.0)
SECONDS_PER_HOUR = 3600.0


def vary_moments(rows: pd.DataFrame, places: pd.DataFrame, log: pd.DataFrame) -> pd.DataFrame:
    """Traverses again at every moment that could matter.

    Parameters
    ----------
    rows : DataFrame
        As they are right after the calibration.
    places : DataFrame
        Traverses that may be made just before, with their ``load``.
    log : DataFrame
        Rows of the log, for the conditions it saw.
    """
    return pd.concat(
        [*_after_waiting(rows), *_after_traverses(rows, places), *_vary_conditions(rows, log)],
        ignore_index=True,
    )


def put_before_calibration(rows: pd.DataFrame) -> pd.DataFrame:
    """Traverses as the first of a session that is calibrated an hour later."""
    note = "as the session's first traverse, calibrating an hour later"
    return rows.assign(session_seconds=0.0, before_direction="", before_load=0.0, note=note)


def _after_waiting(rows: pd.DataFrame) -> Iterator[pd.DataFrame]:
    for hours in WAITING_HOURS:
        then = rows.assign(session_seconds=rows["session_seconds"] + hours * SECONDS_PER_HOUR)
        yield then.assign(note=f"{hours:g} h after the calibration, the joint at rest")
        driven = hours * SECONDS_PER_HOUR / (rows["seconds"] / rows["steps"])
        yield then.assign(
            steps_before=rows["steps_before"] + driven,
            note=f"{hours:g} h after the calibration, the joint driven to and fro all the while",
        )


def _after_traverses(rows: pd.DataFrame, places: pd.DataFrame) -> Iterator[pd.DataFrame]:
    yield rows.assign(before_direction=rows["direction"], note="right after a traverse in the same direction")
    for extreme in (places.loc[places["load"].idxmin()], places.loc[places["load"].idxmax()]):
        where = ", ".join(
            f"{name} {from_si(extreme[name], 'deg'):.0f}°"
            for name in ("q1", "q2", "theta", "psi")
            if np.isfinite(extreme[name]) and (name != "q1" or extreme[name] != 0.0)
        )
        yield rows.assign(
            before_load=extreme["load"],
            note=f"right after a traverse under load {extreme['load']:+.2f} ({where})".replace("-", "−"),
        )


def _vary_conditions(rows: pd.DataFrame, log: pd.DataFrame) -> Iterator[pd.DataFrame]:
    for name in (name for name in log.columns if name in CONDITIONS or name.startswith(COVARIATE_PREFIX)):
        label, unit, beyond = name.removeprefix(COVARIATE_PREFIX), "1", 0.0
        if condition := CONDITIONS.get(name):
            label, unit, beyond = condition.label, condition.unit, condition.beyond
        low, high = float(log[name].min()), float(log[name].max())
        if low == high:
            low, high = max(low - beyond, low / 2), high + beyond
        for value in (low, high):
            if np.isfinite(value) and low < high:
                shown = f"{from_si(value, unit):.4g} {unit if unit != '1' else ''}".strip()
                yield rows.assign(**{name: value}, note=f"once the session is calibrated, at {label} {shown}")


TURN_ANGLES = np.radians([-90.0, -60.0, -30.0, 30.0, 60.0, 90.0])
# The base lies flat, or is turned about one of its axes.
BASE_ORIENTATIONS = [
    (0.0, 0.0),
    *((angle, 0.0) for angle in TURN_ANGLES),
    *((0.0, angle) for angle in TURN_ANGLES),
]
SIDE_ORIENTATIONS = [(0.0, 0.0), (-np.pi / 2, 0.0)]
THETA_ANGLES = np.radians([0.0, 90.0])  # of joint 1 under joints 2 and 3
ARM_ANGLES = np.radians(np.arange(-180.0, 181.0, 30.0))
RANGE_FRACTIONS = np.linspace(0.0, 1.0, 5)  # of joint 3's range
STRETCH_COUNTS = {1: (4,), 2: (4,), 3: (2, 3, 12)}  # into how many a range may be cut


def list_configurations(law: Any, direction: str, machine: Machine) -> pd.DataFrame:
    """Whole traverses in every configuration, and stretches of the range in a few.

    Parameters
    ----------
    law : StepLaw
    direction : {'+', '-'}
    machine : Machine

    Returns
    -------
    DataFrame
        joint, direction, q1 to psi (NaN for the moving joint's own), start, stop.
    """
    joint = law.joint
    low, high = machine.ranges[joint]
    whole = [(*place, low, high) for place in product(_arm_positions(law, machine), BASE_ORIENTATIONS)]
    cuts = [np.linspace(low, high, number + 1) for number in STRETCH_COUNTS[joint]]
    pieces = [
        (arm, base, first, last)
        for arm, base, ends in product(_arm_positions(law, machine)[:1], SIDE_ORIENTATIONS, cuts)
        for first, last in pairwise(ends)
    ]
    rows = pd.DataFrame(
        [(*arm, *base, first, last) for arm, base, first, last in [*whole, *pieces]],
        columns=["q1", "q2", "q3", "theta", "psi", "start", "stop"],
    )
    if direction == "-":
        rows[["start", "stop"]] = rows[["stop", "start"]].to_numpy()
    return rows.assign(joint=joint, direction=direction)


def _arm_positions(law: Any, machine: Machine) -> list[tuple[float, float, float]]:
    """Where the other two joints may stand, as (q1, q2, q3); first where the arm is level or half out."""
    unset = np.nan
    if law.joint == 1:
        # Elsewhere the law of a log with one reach says nothing.
        return list(dict.fromkeys((unset, each.q2, each.q3) for each in law.calibration()))
    turns = [angle for angle in THETA_ANGLES if _is_within_range(machine, 1, angle)]
    if law.joint == 2:
        near, far = machine.ranges[3]
        outs = near + (far - near) * RANGE_FRACTIONS[[2, 0, 1, 3, 4]]
        return [(turn, unset, float(out)) for turn, out in product(turns, outs)]
    level = -np.pi / 2
    angles = [level, *(angle for angle in ARM_ANGLES if angle != level)]
    return [
        (turn, float(angle), unset)
        for turn, angle in product(turns, angles)
        if _is_within_range(machine, 2, angle)
    ]


def _is_within_range(machine: Machine, joint: int, position: float) -> bool:
    low, high = machine.ranges[joint]
    return bool(low - 1e-9 <= position <= high + 1e-9)


NEW_SESSION = ""  # no session of a log has this name
SETUP_SECONDS = 120.0  # s, to set the next configuration
DEFAULT_STEP_PERIOD = 0.010  # s a step, where the log does not say
LATE_CALIBRATION_SECONDS = 3600.0  # s, when a session is calibrated that begins with something else
MIN_RELATIVE_STEP = 0.3  # of the usual step size; what is nearer to a stall is left out


def forecast_candidates(problem: DiagnosisProblem, machine: Machine) -> list[Forecast]:
    """What could be made next by each joint of a log, in each direction.

    Parameters
    ----------
    bench : Bench
    machine : Machine

    Returns
    -------
    list of Forecast
        The traverses carry ``note`` (when to make them) and ``seconds`` (what one takes).
    """
    found = []
    for part in problem.parts:
        rows = problem.rows.iloc[part.rows]
        for direction in sorted(rows["direction"].astype(str).unique()):
            subset = np.flatnonzero((rows["direction"] == direction).to_numpy())
            values = part.values[subset[-1]]
            repeatability = float(problem.repeatability[problem.drive[part.rows[subset[-1]]]])
            session = _FutureSession(
                part.law, values, _typical_conditions(problem.rows, part.law.joint), machine
            )
            found += session.forecasts(direction, problem.rows, repeatability)
    return found


class _FutureSession:
    """A session to come in which one joint is looked at.

    Parameters
    ----------
    law : StepLaw
    values : array, shape (p,)
        About what its parameters will be.
    conditions : dict
        Conditions, steps of the joint so far, and how often the stop is looked for.
    machine : Machine
    """

    def __init__(self, law: Any, values: Array, usual: dict[str, Any], machine: Machine) -> None:
        self.law = law
        self.values = values
        self.conditions = usual
        self.machine = machine

    def forecasts(self, direction: str, log: pd.DataFrame, repeatability: float) -> list[Forecast]:
        """Traverses after the session's calibration, and those before it."""
        places = self.complete_rows(list_configurations(self.law, direction, self.machine))
        calibration = self.calibration(0.0)
        after = self.after(calibration, places)
        known = self.complete_rows(
            configuration_rows(self.law.calibration(), self.law.joint, direction, self.machine)
        )
        # Steps that are lost or added, however many, are a larger share of a short stretch.
        short = places.loc[[np.abs(places["stop"] - places["start"]).idxmin()]]
        few = self.after(calibration, pd.concat([known, short], ignore_index=True))
        late = self.calibration(LATE_CALIBRATION_SECONDS)
        pairs = (
            (calibration, pd.concat([after, vary_moments(few, places, log)], ignore_index=True)),
            (late, put_before_calibration(known)),
        )
        return [
            forecast_session(
                self.law, self.values, begun[begun["direction"] == direction].reset_index(drop=True),
                traverses, repeatability, rounding_variance(traverses["steps"], traverses["check_every"]),
            )
            for begun, traverses in pairs
        ]  # fmt: skip

    def complete_rows(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows with all that a log has of a traverse but history; those near a stall are left out."""
        rows = rows.assign(session=NEW_SESSION, **self.conditions)
        with np.errstate(invalid="ignore"):
            steps = np.exp(self.law.predict(rows, self.values))
        pace = np.abs(rows["stop"] - rows["start"]).to_numpy(float) / steps
        usual = np.abs(self.values[0])
        moves = np.isfinite(pace) & (pace > MIN_RELATIVE_STEP * usual)
        load = mean_load(
            self.law.joint,
            *(rows[name].to_numpy(float) for name in ("start", "stop", "q1", "q2", "theta", "psi")),
        )
        period = rows["step_period"].fillna(DEFAULT_STEP_PERIOD)
        rows = rows.assign(steps=steps, load=load, seconds=steps * period + SETUP_SECONDS)
        return rows[moves].reset_index(drop=True)

    def calibration(self, begins: float) -> pd.DataFrame:
        """The law's calibration, each configuration both ways, from a moment of the session on."""
        directions = [
            configuration_rows(self.law.calibration(), self.law.joint, direction, self.machine)
            for direction in "+-"
        ]
        rows = self.complete_rows(pd.concat(directions).sort_index(kind="stable"))
        driven, passed = rows["steps"].cumsum() - rows["steps"], rows["seconds"].cumsum() - rows["seconds"]
        return rows.assign(
            session_seconds=begins + passed,
            steps_before=rows["steps_before"] + driven,
            before_direction=rows["direction"].shift(fill_value=""),
            before_load=rows["load"].shift(fill_value=0.0),
        )

    def after(self, calibration: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows as they are right after the calibration, each configuration being driven both ways."""
        return rows.assign(
            session_seconds=calibration["session_seconds"].iloc[-1] + calibration["seconds"].iloc[-1],
            steps_before=calibration["steps_before"].iloc[-1] + calibration["steps"].iloc[-1],
            before_direction=np.where(rows["direction"] == "+", "-", "+"),
            before_load=rows["load"],
            note="once the session is calibrated",
        )


def _typical_conditions(log: pd.DataFrame, joint: int) -> dict[str, Any]:
    """Conditions as in the log's middle, and the steps that a joint has made by its end."""
    subset = log[log["joint"] == joint]
    columns = [*CONDITIONS, *(name for name in log.columns if name.startswith(COVARIATE_PREFIX))]
    middle = {
        name: float(values.median()) if (values := log[name]).notna().any() else np.nan for name in columns
    }
    driven = float((subset["steps_before"] + subset["steps"]).max())
    return {**middle, "steps_before": driven, "check_every": int(subset["check_every"].median())}
