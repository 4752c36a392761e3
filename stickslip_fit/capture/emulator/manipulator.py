"""Manipulator: emulated joints with stops, history and hidden laws, driven by steps and set by hand.

A `JointMotion` is one joint moving in one direction. It knows after how many steps the joint reaches
its stop, and after how many the stop becomes audible; causes such as end-stop latency make the two
differ.
"""

from __future__ import annotations

import zlib
from collections import deque
from dataclasses import dataclass
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

NO_NOISE = Noise({})


@dataclass(frozen=True, eq=False)
class HiddenLaws:
    """How the emulated joints truly step.

    Attributes
    ----------
    laws : LawValues
        Laws may have causes in them.
    machine : Machine
        Its ranges end at the mechanical stops.
    noise : Noise
        How well traverses repeat; a joint and direction that it doesn't name repeat exactly.
    seed : int
        Settles how days differ, and all that is left to chance.
    """

    laws: LawValues
    machine: Machine
    noise: Noise = NO_NOISE
    seed: int = 0

    def law_of(self, row: pd.DataFrame) -> tuple[StepLaw, Array, float]:
        """Law, parameters, shape (1, p), and the day's factor of the step size, for one row of a log.

        Raises
        ------
        InputError
            If there is no law for the joint and direction.
        """
        joint, direction = int(row["joint"].iloc[0]), str(row["direction"].iloc[0])
        values, shared = self.laws.of_rows(row, joint)
        factor = self._day(str(row["session"].iloc[0]), joint, direction) if shared[0] else 1.0
        return self.laws.laws[joint], values, factor

    def _day(self, session: str, joint: int, direction: str) -> float:
        """The same whenever a session is taken up again."""
        spread = self.laws.day_to_day.get((joint, direction), 0.0)
        stream = [self.seed, zlib.crc32(f"{session}/{joint}{direction}".encode())]
        return 1.0 + spread * float(np.random.default_rng(stream).standard_normal())


def count_steps(law: StepLaw, row: pd.DataFrame, values: Array, factor: float) -> float:
    """Steps from a row's start to its stop without noise, as `simulate` has them.

    Raises
    ------
    InputError
        If the joint comes to a halt on its way.
    """
    added = float(law.added(row, values)[0]) if isinstance(law, ExtendedLaw) else 0.0
    return (float(expected_counts(law, row, values)[0]) - added) / factor + added


@dataclass(frozen=True, eq=False)
class JointMotion:
    """A traverse as it truly goes, however many steps of it are made.

    Attributes
    ----------
    row : DataFrame
        One row of a log, with its history; stop is the mechanical stop ahead.
    steps_to_stop : float
        Steps, not necessarily whole, after which the joint is at its stop.
    heard : float
        Steps after which it sounds so: a cause may have the stop heard late, or imagined.
    departure : float
        Log steps by which this traverse takes more than usual.
    """

    truth: HiddenLaws
    joint: int
    direction: str
    row: pd.DataFrame
    steps_to_stop: float
    heard: float
    departure: float

    def position(self, steps: int) -> float:
        """Where the joint stands after so many steps, rad or m.

        Raises
        ------
        InputError
            If it has come to a halt.
        """
        if steps >= self.steps_to_stop:
            return float(self.row["stop"].iloc[0])
        law, values, factor = self.truth.law_of(self.row)
        lost = 0.0
        if isinstance(law, ExtendedLaw):
            values = law.in_motion(values)
            lost = float(law.added(self.row, values)[0])
        usual = steps * np.exp(-self.departure)
        moved = max(lost + (usual - lost) * factor, 0.0)
        return float(position_after(law, self.row, values, moved)[0])


def begin_motion(truth: HiddenLaws, row: pd.DataFrame, departure: float, misfire_draws: Array) -> JointMotion:
    """A leg along a row of a log.

    Parameters
    ----------
    truth : Truth
    row : DataFrame
        One row; equal start and stop are a joint that stands at its stop already.
    departure : float
        Log steps by which it takes more than usual.
    luck : array, shape (3,)
        See `simulate.chance.Chance`.

    Raises
    ------
    InputError
        If the joint has no law, or comes to a halt on its way.
    """
    joint, direction = int(row["joint"].iloc[0]), str(row["direction"].iloc[0])
    if row["start"].iloc[0] == row["stop"].iloc[0]:
        return JointMotion(truth, joint, direction, row, 0.0, 0.0, departure)
    law, values, factor = truth.law_of(row)
    moving, misfire = values, 0.0
    if isinstance(law, ExtendedLaw):
        moving, misfire = law.in_motion(values), float(law.misfires(values, misfire_draws[None])[0])
    reached = count_steps(law, row, moving, factor) * np.exp(departure)
    heard = count_steps(law, row, values, factor) * np.exp(departure + misfire)
    return JointMotion(truth, joint, direction, row, float(reached), float(heard), departure)


RANGE_TOL = 1e-9  # of a joint's range, for what converting units rounds off
MAX_PAUSE_SECONDS = 2.0  # s; who pauses longer begins another traverse
MAX_STEP_RECORDS = 1000
NOISE_STREAM = 1  # a stream of random numbers beside those of the days


@dataclass(frozen=True)
class StepRecord:
    """Steps that a joint has made one after the other.

    Attributes
    ----------
    began : float
        When the first began, s.
    period : float
        From one to the next, s.
    steps : int
    moving : int
        As many of them sound like a joint that moves, and the rest like one at its stop.
    """

    began: float
    period: float
    steps: int
    moving: int

    @property
    def ended(self) -> float:
        """When the last was over, s."""
        return self.began + self.steps * self.period


@dataclass(frozen=True)
class JointHistory:
    """What a joint remembers: direction and load of its leg before, and how many steps it has made."""

    direction: str = ""
    load: float = 0.0
    steps: int = 0


class Manipulator:
    """Joints that move by hidden laws, and where they stand.

    Parameters
    ----------
    truth : Truth
    session : str
        Under way when it is switched on.

    Attributes
    ----------
    made : deque of Made
        The latest steps, and enough of those before them to hear them.
    """

    def __init__(self, truth: HiddenLaws, session: str = "") -> None:
        self.truth = truth
        self._session = session
        self._began: float | None = None
        self._stands = {"q1": 0.0, "q2": -np.pi / 2, "q3": 0.0, "theta": 0.0, "psi": 0.0}
        self._given = dict.fromkeys(CONDITIONS, np.nan)
        self._stops = dict(truth.machine.ranges)
        self._past = dict.fromkeys(JOINTS, JointHistory())
        self._leg: JointMotion | None = None
        self._steps = 0  # of the leg under way
        self._random = np.random.default_rng([truth.seed, NOISE_STREAM])
        self.made = deque([StepRecord(-np.inf, 0.0, 0, 0)], maxlen=MAX_STEP_RECORDS)

    def step(self, joint: int, steps: int, began: float, period: float) -> None:
        """Make steps, more than 0 in `+`, less in `-`, the first at `began`, s.

        Raises
        ------
        InputError
            If the joint has no law, or comes to a halt.
        """
        direction = "+" if steps > 0 else "-"
        motion = self._under_way(joint, direction, began) or self._begin(joint, direction, began, period)
        moving = int(np.clip(np.ceil(motion.heard) - 1 - self._steps, 0, abs(steps)))
        self._steps += abs(steps)
        self.made.append(StepRecord(began, period, abs(steps), moving))

    def set(self, **quantities: float) -> None:
        """Set by hand: q1, q2, q3, theta, psi; or what is to be read: temperature, ..., all SI.

        Raises
        ------
        InputError
            For any other quantity, or a joint beyond its stops.
        """
        self._end_leg()
        for name, value in quantities.items():
            if name in self._stands:
                self._stands[name] = self._within_stops(name, value)
            elif name in self._given or name.startswith(COVARIATE_PREFIX):
                self._given[name] = value
            else:
                known = ", ".join([*self._stands, *CONDITIONS])
                raise InputError(f"{name!r} cannot be set; choose among {known}, covariate:COLUMN")

    def set_stops(self, joint: int, low: float, high: float) -> None:
        """Put a joint's stops by hand, rad or m; a joint that stands beyond one is pushed back to it.

        Raises
        ------
        InputError
            If they lie outside the joint's range.
        """
        self._end_leg()
        lowest, highest = self.truth.machine.ranges[joint]
        if not lowest <= low < high <= highest:
            raise InputError(f"joint {joint} can't have stops at {low:g} and {high:g}; keep to its range")
        self._stops[joint] = (low, high)
        self._stands[f"q{joint}"] = min(max(self._stands[f"q{joint}"], low), high)

    def begin_session(self, label: str) -> None:
        """Begin a session, if it is not the one under way; its clock starts with its first step."""
        self._end_leg()
        if label == self._session and self._began is not None:
            return
        self._session, self._began = label, None
        self._past = {joint: JointHistory(steps=past.steps) for joint, past in self._past.items()}

    def remember(self, rows: pd.DataFrame, today: datetime, now: float) -> None:
        """Be worn and warmed by drives that were made before it was switched on again.

        Parameters
        ----------
        rows : DataFrame
            A log's rows in order of time; where they left the joints is not known.
        today : datetime
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
            self._past[int(joint)] = JointHistory(
                str(last["direction"].iloc[0]), load, int(subset["steps"].sum())
            )
        self._session = str(rows["session"].iloc[-1])
        began = rows["time"][rows["session"] == self._session].iloc[0]
        self._began = now - (today - began).total_seconds()

    def position(self, joint: int) -> float:
        """Where a joint truly stands, rad or m."""
        self._settle()
        return self._stands[f"q{joint}"]

    def driven(self, joint: int) -> int:
        """Steps that a joint has made since it was new, those against its stop among them."""
        past = self._past[joint].steps
        return past + self._steps if self._leg is not None and self._leg.joint == joint else past

    def _under_way(self, joint: int, direction: str, began: float) -> JointMotion | None:
        """The leg that steps beginning now go on with."""
        motion = self._leg
        if motion is None or (motion.joint, motion.direction) != (joint, direction):
            return None
        return motion if began - self.made[-1].ended <= MAX_PAUSE_SECONDS else None

    def _begin(self, joint: int, direction: str, began: float, period: float) -> JointMotion:
        self._end_leg()
        self._began = began if self._began is None else self._began
        past = self._past[joint]
        row = pd.DataFrame(
            {
                "session": [self._session],
                "joint": [joint],
                "direction": [direction],
                **{name: [value] for name, value in self._stands.items()},
                "start": [self._stands[f"q{joint}"]],
                "stop": [self._stops[joint][direction == "+"]],
                **{name: [value] for name, value in self._given.items()},
                "step_period": [period],
                "session_seconds": [began - self._began],
                "before_direction": [past.direction],
                "before_load": [past.load],
                "steps_before": [past.steps],
            }
        )
        noise = self.truth.noise
        departure = float(draw_noise(noise.kind, 1, self._random)[0])
        departure *= noise.repeatability.get((joint, direction), 0.0)
        self._leg = begin_motion(self.truth, row, departure, self._random.random(3))
        return self._leg

    def _end_leg(self) -> None:
        """Where the joint stands, and what it remembers of the way there."""
        self._settle()
        motion, self._leg = self._leg, None
        if motion is None:
            return
        position = {name: motion.row[name].to_numpy() for name in ("start", "q1", "q2", "theta", "psi")}
        load = float(mean_load(motion.joint, stop=self._stands[f"q{motion.joint}"], **position)[0])
        self._past[motion.joint] = JointHistory(
            motion.direction, load, self._past[motion.joint].steps + self._steps
        )
        self._steps = 0

    def _settle(self) -> None:
        """Work out where the steps of the leg under way have brought its joint."""
        if self._leg is not None:
            self._stands[f"q{self._leg.joint}"] = self._leg.position(self._steps)

    def _within_stops(self, name: str, value: float) -> float:
        if not name.startswith("q"):
            return value
        joint = int(name[1])
        low, high = self._stops[joint]
        if not low - RANGE_TOL * (high - low) <= value <= high + RANGE_TOL * (high - low):
            raise InputError(f"{name} = {value:g} lies beyond joint {joint}'s stops, {low:g} to {high:g}")
        return min(max(value, low), high)
