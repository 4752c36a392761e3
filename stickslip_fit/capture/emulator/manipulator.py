"""Manipulator: emulated joints with stops, history and hidden laws, driven by steps and set by hand.

A `JointMotion` is one joint moving in one direction. It knows after how many steps the joint reaches
its stop, and after how many the stop becomes audible; causes such as end-stop latency make the two
differ.
"""

from __future__ import annotations

import zlib
from collections import deque
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs.plan import Noise
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX
from stickslip_fit.machine import Machine, mean_load
from stickslip_fit.moves import position_after
from stickslip_fit.simulation import LawValues, draw_noise, expected_counts
from stickslip_fit.units import JOINTS


@dataclass(frozen=True, eq=False)
class HiddenLaws:
    """The true laws of the emulated joints.

    Attributes
    ----------
    laws : LawValues
        With or without causes.
    machine : Machine
        Its ranges end at the mechanical stops.
    noise : Noise
        Repeatability; a joint and direction that it doesn't name repeats exactly.
    seed : int
        Of day-to-day differences, noise and misfires.
    """

    laws: LawValues
    machine: Machine
    noise: Noise = field(default_factory=lambda: Noise({}))
    seed: int = 0

    def law_of(self, row: pd.DataFrame) -> tuple[StepLaw, Array, float]:
        """Law, parameters, shape (1, p), and the day's factor of the step size, for one row of a log."""
        joint, direction = int(row["joint"].iloc[0]), str(row["direction"].iloc[0])
        values, shared = self.laws.of_rows(row, joint)
        factor = self._day_factor(str(row["session"].iloc[0]), joint, direction) if shared[0] else 1.0
        return self.laws.laws[joint], values, factor

    def _day_factor(self, session: str, joint: int, direction: str) -> float:
        """The same in every capture of a session."""
        spread = self.laws.day_to_day.get((joint, direction), 0.0)
        stream = [self.seed, zlib.crc32(f"{session}/{joint}{direction}".encode())]
        return 1.0 + spread * float(np.random.default_rng(stream).standard_normal())


def count_steps(law: StepLaw, row: pd.DataFrame, values: Array, factor: float) -> float:
    """Steps from a row's start to its stop without noise, as `simulate` computes them."""
    added = float(law.steps_added_by_causes(row, values)[0]) if isinstance(law, ExtendedLaw) else 0.0
    return (float(expected_counts(law, row, values)[0]) - added) / factor + added


@dataclass(frozen=True, eq=False)
class JointMotion:
    """The true motion of a joint in one direction, however many steps of it are made.

    Attributes
    ----------
    row : DataFrame
        One row of a log, with its history; stop is the mechanical stop ahead.
    steps_to_stop : float
        Steps, not necessarily whole, after which the joint is at its stop.
    steps_to_sound : float
        Steps after which it sounds so: a cause may delay the detection, or make it premature.
    deviation : float
        Random deviation of the log steps.
    """

    truth: HiddenLaws
    joint: int
    direction: str
    row: pd.DataFrame
    steps_to_stop: float
    steps_to_sound: float
    deviation: float

    def position(self, steps: int) -> float:
        """Position after so many steps, rad or m; raises InputError where the joint has stalled."""
        if steps >= self.steps_to_stop:
            return float(self.row["stop"].iloc[0])
        law, values, factor = self.truth.law_of(self.row)
        added = 0.0
        if isinstance(law, ExtendedLaw):
            values = law.without_stop_effects(values)
            added = float(law.steps_added_by_causes(self.row, values)[0])
        effective = max(added + (steps * np.exp(-self.deviation) - added) * factor, 0.0)
        return float(position_after(law, self.row, values, effective)[0])


def begin_motion(truth: HiddenLaws, row: pd.DataFrame, deviation: float, misfire_draws: Array) -> JointMotion:
    """The motion along a row of a log; equal start and stop mean that the joint is at its stop already.

    Parameters
    ----------
    row : DataFrame
        One row.
    deviation : float
        Random deviation of the log steps.
    misfire_draws : array, shape (3,)
        Uniform; see `ExtendedLaw.misfires`.

    Raises
    ------
    InputError
        If the joint has no law, or stalls.
    """
    joint, direction = int(row["joint"].iloc[0]), str(row["direction"].iloc[0])
    if row["start"].iloc[0] == row["stop"].iloc[0]:
        return JointMotion(truth, joint, direction, row, 0.0, 0.0, deviation)
    law, values, factor = truth.law_of(row)
    moving, misfire = values, 0.0
    if isinstance(law, ExtendedLaw):
        moving, misfire = (
            law.without_stop_effects(values),
            float(law.misfire_deviations(values, misfire_draws[None])[0]),
        )
    to_stop = float(count_steps(law, row, moving, factor) * np.exp(deviation))
    to_sound = float(count_steps(law, row, values, factor) * np.exp(deviation + misfire))
    return JointMotion(truth, joint, direction, row, to_stop, to_sound, deviation)


RANGE_TOL = 1e-9  # of a joint's range, for rounding in unit conversions
MAX_PAUSE_SECONDS = 2.0  # a longer pause begins another traverse
MAX_STEP_RECORDS = 1000
NOISE_STREAM = 1  # a stream of random numbers beside those of the days


@dataclass(frozen=True)
class StepRecord:
    """Consecutive steps of a joint: from `began` (s), one each `period` (s).

    The first `moving` of them sound like a joint that moves, the rest like one at its stop.
    """

    began: float
    period: float
    steps: int
    moving: int

    @property
    def ended(self) -> float:
        """End of the last step, s."""
        return self.began + self.steps * self.period


@dataclass(frozen=True)
class JointHistory:
    """Direction and mean load of a joint's last motion, and all its steps so far."""

    direction: str = ""
    load: float = 0.0
    steps: int = 0


class Manipulator:
    """Joints that move by hidden laws, and their positions.

    Attributes
    ----------
    step_records : deque of StepRecord
        The latest steps, enough to compute their sound.
    """

    def __init__(self, truth: HiddenLaws, session: str = "") -> None:
        self.truth = truth
        self._session = session
        self._session_began: float | None = None
        self._positions = {"q1": 0.0, "q2": -np.pi / 2, "q3": 0.0, "theta": 0.0, "psi": 0.0}
        self._conditions = dict.fromkeys(CONDITIONS, np.nan)
        self._stops = dict(truth.machine.ranges)
        self._history = dict.fromkeys(JOINTS, JointHistory())
        self._motion: JointMotion | None = None
        self._steps = 0  # of the motion in progress
        self._random = np.random.default_rng([truth.seed, NOISE_STREAM])
        self._drive: dict[tuple[int, str], float] | None = None  # deviations of the drive by hand under way
        self.step_records = deque([StepRecord(-np.inf, 0.0, 0, 0)], maxlen=MAX_STEP_RECORDS)

    def step(self, joint: int, steps: int, began: float, period: float) -> None:
        """Make steps, more than 0 in `+`, less in `-`, the first at `began`, s; raises as `begin_motion`."""
        direction = "+" if steps > 0 else "-"
        motion = self._continue(joint, direction, began) or self._begin(joint, direction, began, period)
        moving = int(np.clip(np.ceil(motion.steps_to_sound) - 1 - self._steps, 0, abs(steps)))
        self._steps += abs(steps)
        self.step_records.append(StepRecord(began, period, abs(steps), moving))

    def set(self, **quantities: float) -> None:
        """Set q1, q2, q3, theta, psi or a condition (SI); raises InputError for others, or beyond a stop."""
        self._end_motion()
        for name, value in quantities.items():
            if name in self._positions:
                self._positions[name] = self._within_stops(name, value)
            elif name in self._conditions or name.startswith(COVARIATE_PREFIX):
                self._conditions[name] = value
            else:
                known = ", ".join([*self._positions, *CONDITIONS])
                raise InputError(f"{name!r} cannot be set; choose among {known}, covariate:COLUMN")

    def set_stops(self, joint: int, low: float, high: float) -> None:
        """Set a joint's stops, rad or m, within its range; a joint beyond one is pushed back to it."""
        self._end_motion()
        lowest, highest = self.truth.machine.ranges[joint]
        if not lowest <= low < high <= highest:
            raise InputError(f"joint {joint} can't have stops at {low:g} and {high:g}; keep to its range")
        self._stops[joint] = (low, high)
        self._positions[f"q{joint}"] = min(max(self._positions[f"q{joint}"], low), high)

    def begin_session(self, label: str, began: float | None = None) -> None:
        """Begin a session, unless it is the current one; its clock starts at `began` or its first step, s."""
        self._end_motion()
        if label == self._session and self._session_began is not None:
            return
        self._session, self._session_began = label, began
        self._history = {joint: JointHistory(steps=last.steps) for joint, last in self._history.items()}

    def begin_drive(self) -> None:
        """From now on all motions of a joint are bursts of one drive, until the joint meets a stop.

        The deviation of a joint and direction is drawn once and held. Without this, each motion has its own:
        cut into bursts, a drive's noise would average away.
        """
        self._end_motion()
        self._drive = {}

    def remember(self, rows: pd.DataFrame, today: datetime, now: float) -> None:
        """Take over the wear and the session time of drives that were made before.

        Parameters
        ----------
        rows : DataFrame
            A log's rows in order of time; where they left the joints is not known.
        now : float
            The same moment by the clock of `step`, s.
        """
        self._random = np.random.default_rng([self.truth.seed, NOISE_STREAM, len(rows)])
        if rows.empty:
            return
        for joint, subset in rows.groupby("joint"):
            last = subset.iloc[[-1]]
            position = (last[name].to_numpy() for name in ("start", "stop", "q1", "q2", "theta", "psi"))
            load = float(mean_load(int(joint), *position)[0])
            direction, total = str(last["direction"].iloc[0]), int(subset["steps"].sum())
            self._history[int(joint)] = JointHistory(direction, load, total)
        self._session = str(rows["session"].iloc[-1])
        began = rows["time"][rows["session"] == self._session].iloc[0]
        self._session_began = now - (today - began).total_seconds()

    def position(self, joint: int) -> float:
        """True position of a joint, rad or m."""
        self._settle()
        return self._positions[f"q{joint}"]

    def total_steps(self, joint: int) -> int:
        """Steps that a joint has ever made, those against its stop included."""
        in_progress = self._steps if self._motion is not None and self._motion.joint == joint else 0
        return self._history[joint].steps + in_progress

    def _continue(self, joint: int, direction: str, began: float) -> JointMotion | None:
        """The motion that steps beginning now continue, if any."""
        motion = self._motion
        if motion is None or (motion.joint, motion.direction) != (joint, direction):
            return None
        return motion if began - self.step_records[-1].ended <= MAX_PAUSE_SECONDS else None

    def _begin(self, joint: int, direction: str, began: float, period: float) -> JointMotion:
        self._end_motion()
        self._session_began = began if self._session_began is None else self._session_began
        last = self._history[joint]
        row = pd.DataFrame(
            {
                "session": [self._session],
                "joint": [joint],
                "direction": [direction],
                **{name: [value] for name, value in self._positions.items()},
                "start": [self._positions[f"q{joint}"]],
                "stop": [self._stops[joint][direction == "+"]],
                **{name: [value] for name, value in self._conditions.items()},
                "step_period": [period],
                "session_seconds": [began - self._session_began],
                "before_direction": [last.direction],
                "before_load": [last.load],
                "steps_before": [last.steps],
            }
        )
        deviation = self._draw_deviation(joint, direction)
        self._motion = begin_motion(self.truth, row, deviation, self._random.random(3))
        return self._motion

    def _draw_deviation(self, joint: int, direction: str) -> float:
        if self._drive is not None and (joint, direction) in self._drive:
            return self._drive[joint, direction]
        noise = self.truth.noise
        deviation = float(draw_noise(noise.kind, 1, self._random)[0])
        deviation *= noise.repeatability.get((joint, direction), 0.0)
        if self._drive is not None:
            self._drive[joint, direction] = deviation
        return deviation

    def _end_motion(self) -> None:
        """Update the joint's position and history."""
        self._settle()
        motion, self._motion = self._motion, None
        if motion is None:
            return
        position = {name: motion.row[name].to_numpy() for name in ("start", "q1", "q2", "theta", "psi")}
        load = float(mean_load(motion.joint, stop=self._positions[f"q{motion.joint}"], **position)[0])
        total = self._history[motion.joint].steps + self._steps
        self._history[motion.joint] = JointHistory(motion.direction, load, total)
        self._steps = 0

    def _settle(self) -> None:
        """Update the position of the moving joint."""
        motion = self._motion
        if motion is None:
            return
        self._positions[f"q{motion.joint}"] = motion.position(self._steps)
        if self._drive is not None and self._steps >= motion.steps_to_stop:
            # At a stop the joint's next drive begins.
            self._drive = {group: of for group, of in self._drive.items() if group[0] != motion.joint}

    def _within_stops(self, name: str, value: float) -> float:
        if not name.startswith("q"):
            return value
        joint = int(name[1])
        low, high = self._stops[joint]
        if not low - RANGE_TOL * (high - low) <= value <= high + RANGE_TOL * (high - low):
            raise InputError(f"{name} = {value:g} lies beyond joint {joint}'s stops, {low:g} to {high:g}")
        return min(max(value, low), high)
