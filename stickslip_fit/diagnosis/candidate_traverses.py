"""Candidate traverses for the next experiment: configurations, ranges, times and conditions.

Arm and base take the angles that can be set by hand; ranges are whole or cut into equal stretches. Each
candidate has the history that it would have: after or before the calibration, after waiting or driving,
after other traverses, or under other conditions. A `Forecast` predicts their effects beyond what the new
session's calibration absorbs: e - g (J'J)^-1 J' e_cal, with J and g the Jacobians of the calibration and
of the traverse.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.estimation.identifiability import configuration_rows
from stickslip_fit.laws import rounding_variance
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX
from stickslip_fit.machine import Machine, mean_load
from stickslip_fit.units import from_si

MIN_CALIBRATION_WEIGHT = 1e-3  # below, a traverse does without that calibration reading
NEW_SESSION = ""  # a name that no session of a log has
SETUP_SECONDS = 120.0  # s, to set the next configuration
DEFAULT_STEP_PERIOD = 0.010  # s, where the log has none
LATE_CALIBRATION_SECONDS = 3600.0  # s, of a session that begins with another traverse
MIN_RELATIVE_STEP = 0.3  # of the step size without load; candidates nearer to a stall are left out
WAITING_HOURS = (1.0, 2.0, 4.0, 7.0)
SECONDS_PER_HOUR = 3600.0
TURN_ANGLES = np.radians([-90.0, -60.0, -30.0, 30.0, 60.0, 90.0])
# (theta, psi): the base lies flat, or is turned about one of its axes.
BASE_ORIENTATIONS = [(0.0, 0.0), *((t, 0.0) for t in TURN_ANGLES), *((0.0, t) for t in TURN_ANGLES)]
SIDE_ORIENTATIONS = [(0.0, 0.0), (-np.pi / 2, 0.0)]
Q1_ANGLES = np.radians([0.0, 90.0])  # for joints 2 and 3
ARM_ANGLES = np.radians(np.arange(-180.0, 181.0, 30.0))
RANGE_FRACTIONS = np.linspace(0.0, 1.0, 5)  # of joint 3's range
STRETCH_COUNTS = {1: (4,), 2: (4,), 3: (2, 3, 12)}  # by joint: equal stretches of its range


@dataclass(frozen=True, eq=False)
class Forecast:
    """Candidate traverses under one law in a future session, after its calibration.

    Attributes
    ----------
    law : object
        The baseline law, with `model` and `predict` as of a `StepLaw`.
    values : array, shape (p,)
        Its expected parameters.
    calibration : DataFrame
        k rows that determine all p parameters.
    traverses : DataFrame
        m candidates.
    calibration_weights : array, shape (m, k)
        Weight of each calibration reading in the prediction of each traverse.
    variance : array, shape (m,)
        Of one reading of each traverse about its prediction by one calibration.
    wait : array, shape (m,)
        Seconds of the session until the first reading and the calibration are done.
    seconds : array, shape (m,)
        Duration of each further reading, with one of each calibration traverse that has weight in it.
    """

    law: Any
    values: Array
    calibration: pd.DataFrame
    traverses: pd.DataFrame
    calibration_weights: Array
    variance: Array
    wait: Array
    seconds: Array

    def predict_effect(self, law: Any, sizes: Array) -> Array:
        """Effect beyond the calibration of causes with these sizes in `law`, on each traverse, shape (m,)."""
        both = np.concatenate([self.values, sizes])
        ahead, calibration = (
            law.predict(rows, both) - self.law.predict(rows, self.values)
            for rows in (self.traverses, self.calibration)
        )
        return np.asarray(ahead - self.calibration_weights @ calibration)

    def effect_variance(self, law: Any, sizes: Array, covariance: Array) -> Array:
        """Variance of `predict_effect` by the covariance of the sizes, shape (m,)."""
        both, own = np.concatenate([self.values, sizes]), len(self.values)
        ahead, calibration = (
            law.model(rows)(np.broadcast_to(both, (len(rows), len(both))))[1][:, own:]
            for rows in (self.traverses, self.calibration)
        )
        slopes = ahead - self.calibration_weights @ calibration
        return np.asarray(np.einsum("mi,ij,mj->m", slopes, covariance, slopes))


def forecast_session(
    law: Any,
    values: Array,
    calibration: pd.DataFrame,
    traverses: pd.DataFrame,
    repeatability: float,
    rounding: Array,
) -> Forecast:
    """Forecast a session of k calibration rows and m candidates.

    Both have ``session_seconds`` (begin) and ``seconds`` (duration). `repeatability` is the standard
    deviation of a response, `rounding`, shape (m,), the variance that rounding adds to each candidate; in
    the long calibration traverses it is negligible.
    """
    weights = law.model(traverses)(values)[1] @ np.linalg.pinv(law.model(calibration)(values)[1])
    variance = repeatability**2 * (1.0 + np.sum(weights**2, axis=1)) + rounding
    needed = np.abs(weights) > MIN_CALIBRATION_WEIGHT
    seconds = traverses["seconds"].to_numpy(float) + needed @ calibration["seconds"].to_numpy(float)
    wait = np.maximum(traverses["session_seconds"], calibration["session_seconds"].max()).to_numpy(float)
    return Forecast(law, values, calibration, traverses, weights, variance, wait, seconds)


def forecast_candidates(problem: DiagnosisProblem, machine: Machine) -> list[Forecast]:
    """Candidate traverses of each joint of a log, in each direction.

    Returns
    -------
    list of Forecast
        The traverses have columns ``note`` (when to make them) and ``seconds`` (duration). None for a law
        that names no calibration: how its next session would begin is not known.
    """
    forecasts = []
    for part in problem.parts:
        if not part.law.calibration():
            continue
        rows = problem.rows.iloc[part.rows]
        conditions = _typical_conditions(problem.rows, part.law.joint)
        for direction in sorted(rows["direction"].astype(str).unique()):
            last = np.flatnonzero((rows["direction"] == direction).to_numpy())[-1]
            repeatability = float(problem.repeatability[problem.noise_group[part.rows[last]]])
            session = _FutureSession(part.law, part.values[last], conditions, machine)
            forecasts += session.forecasts(direction, problem.rows, repeatability)
    return forecasts


@dataclass(frozen=True, eq=False)
class _FutureSession:
    """A future session of one joint.

    Attributes
    ----------
    values : array, shape (p,)
        Expected parameters.
    conditions : dict
        Conditions, steps of the joint so far, and ``check_every``.
    """

    law: Any
    values: Array
    conditions: dict[str, Any]
    machine: Machine

    def forecasts(self, direction: str, log: pd.DataFrame, repeatability: float) -> list[Forecast]:
        """Candidates after the session's calibration, and before it."""
        places = self.complete_rows(list_configurations(self.law, direction, self.machine))
        calibration = self.calibration(0.0)
        after = self.after(calibration, places)
        known = self.complete_rows(
            configuration_rows(self.law.calibration(), self.law.joint, direction, self.machine)
        )
        # Lost or added steps are a larger share of a short traverse.
        short = places.loc[[np.abs(places["stop"] - places["start"]).idxmin()]]
        few = self.after(calibration, pd.concat([known, short], ignore_index=True))
        varied = (*_after_waiting(few), *_after_traverses(few, places), *_vary_conditions(few, log))
        note = "as the session's first traverse, calibrating an hour later"
        first = known.assign(session_seconds=0.0, before_direction="", before_load=0.0, note=note)
        sessions = (
            (calibration, pd.concat([after, *varied], ignore_index=True)),
            (self.calibration(LATE_CALIBRATION_SECONDS), first),
        )
        forecasts = []
        for own, rows in sessions:
            own = own[own["direction"] == direction].reset_index(drop=True)
            rounding = rounding_variance(rows["steps"], rows["check_every"])
            forecasts.append(forecast_session(self.law, self.values, own, rows, repeatability, rounding))
        return forecasts

    def complete_rows(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows with every column of a log but the history; those near a stall are left out."""
        rows = rows.assign(session=NEW_SESSION, **self.conditions)
        with np.errstate(invalid="ignore"):
            steps = np.exp(self.law.predict(rows, self.values))
        pace = np.abs(rows["stop"] - rows["start"]).to_numpy(float) / steps
        moves = np.isfinite(pace) & (pace > MIN_RELATIVE_STEP * np.abs(self.values[0]))
        load = mean_load(
            self.law.joint,
            *(rows[name].to_numpy(float) for name in ("start", "stop", "q1", "q2", "theta", "psi")),
        )
        period = rows["step_period"].fillna(DEFAULT_STEP_PERIOD)
        rows = rows.assign(steps=steps, load=load, seconds=steps * period + SETUP_SECONDS)
        return rows[moves].reset_index(drop=True)

    def calibration(self, begin: float) -> pd.DataFrame:
        """The law's calibration, each configuration in both directions, from `begin` (s) on."""
        directions = [
            configuration_rows(self.law.calibration(), self.law.joint, direction, self.machine)
            for direction in "+-"
        ]
        rows = self.complete_rows(pd.concat(directions).sort_index(kind="stable"))
        driven, passed = rows["steps"].cumsum() - rows["steps"], rows["seconds"].cumsum() - rows["seconds"]
        return rows.assign(
            session_seconds=begin + passed,
            steps_before=rows["steps_before"] + driven,
            before_direction=rows["direction"].shift(fill_value=""),
            before_load=rows["load"].shift(fill_value=0.0),
        )

    def after(self, calibration: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows right after the calibration, each after a traverse in the other direction."""
        return rows.assign(
            session_seconds=calibration["session_seconds"].iloc[-1] + calibration["seconds"].iloc[-1],
            steps_before=calibration["steps_before"].iloc[-1] + calibration["steps"].iloc[-1],
            before_direction=np.where(rows["direction"] == "+", "-", "+"),
            before_load=rows["load"],
            note="once the session is calibrated",
        )


def _typical_conditions(log: pd.DataFrame, joint: int) -> dict[str, Any]:
    """Medians of the log's conditions, and the steps that a joint has made by its end."""
    own = log[log["joint"] == joint]
    columns = [*CONDITIONS, *(name for name in log.columns if name.startswith(COVARIATE_PREFIX))]
    medians = {name: float(log[name].median()) if log[name].notna().any() else np.nan for name in columns}
    driven = float((own["steps_before"] + own["steps"]).max())
    return {**medians, "steps_before": driven, "check_every": int(own["check_every"].median())}


def _after_waiting(rows: pd.DataFrame) -> Iterator[pd.DataFrame]:
    """Some hours later, the joint at rest or driven meanwhile."""
    for hours in WAITING_HOURS:
        later = rows.assign(session_seconds=rows["session_seconds"] + hours * SECONDS_PER_HOUR)
        yield later.assign(note=f"{hours:g} h after the calibration, the joint at rest")
        driven = hours * SECONDS_PER_HOUR / (rows["seconds"] / rows["steps"])
        yield later.assign(
            steps_before=rows["steps_before"] + driven,
            note=f"{hours:g} h after the calibration, the joint driven to and fro all the while",
        )


def _after_traverses(rows: pd.DataFrame, places: pd.DataFrame) -> Iterator[pd.DataFrame]:
    """Right after a traverse in the same direction, or under the lowest or highest load."""
    yield rows.assign(before_direction=rows["direction"], note="right after a traverse in the same direction")
    for extreme in (places.loc[places["load"].idxmin()], places.loc[places["load"].idxmax()]):
        place = ", ".join(
            f"{name} {from_si(extreme[name], 'deg'):.0f}°"
            for name in ("q1", "q2", "theta", "psi")
            if np.isfinite(extreme[name]) and (name != "q1" or extreme[name] != 0.0)
        )
        yield rows.assign(
            before_load=extreme["load"],
            note=f"right after a traverse under load {extreme['load']:+.2f} ({place})".replace("-", "−"),
        )


def _vary_conditions(rows: pd.DataFrame, log: pd.DataFrame) -> Iterator[pd.DataFrame]:
    """At the lowest and highest value of each condition in the log, or a little beyond a constant one."""
    for name in (name for name in log.columns if name in CONDITIONS or name.startswith(COVARIATE_PREFIX)):
        label, unit, beyond = name.removeprefix(COVARIATE_PREFIX), "1", 0.0
        if condition := CONDITIONS.get(name):
            label, unit, beyond = condition.label, condition.unit, condition.beyond
        low, high = float(log[name].min()), float(log[name].max())
        if low == high:
            low, high = max(low - beyond, low / 2), high + beyond
        for value in (low, high):
            if np.isfinite(value) and low < high:
                text = f"{from_si(value, unit):.4g} {unit if unit != '1' else ''}".strip()
                yield rows.assign(**{name: value}, note=f"once the session is calibrated, at {label} {text}")


def list_configurations(law: Any, direction: str, machine: Machine) -> pd.DataFrame:
    """Whole traverses in every configuration of a law's joint, and stretches of its range in a few.

    Columns: joint, direction, q1 to psi (NaN for the moving joint's own), start, stop.
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
    """Positions of the other two joints, as (q1, q2, q3); first with the arm level or half extended."""
    unset = np.nan
    if law.joint == 1:
        # A log with one reach does not determine the law at any other.
        return list(dict.fromkeys((unset, place.q2, place.q3) for place in law.calibration()))
    turns = [angle for angle in Q1_ANGLES if _is_within_range(machine, 1, angle)]
    if law.joint == 2:
        near, far = machine.ranges[3]
        extensions = near + (far - near) * RANGE_FRACTIONS[[2, 0, 1, 3, 4]]
        return [(turn, unset, float(extension)) for turn, extension in product(turns, extensions)]
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
