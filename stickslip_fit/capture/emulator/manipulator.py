"""The emulated manipulator: joints with stops and a past, stepped blindly and turned by hand."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from datetime import datetime

import numpy as np
import pandas as pd

from stickslip_fit.capture.emulator.leg import Leg, leg_of
from stickslip_fit.capture.emulator.truth import Truth
from stickslip_fit.errors import InputError
from stickslip_fit.logs.columns import CONDITIONS, COVARIATE
from stickslip_fit.machine import JOINTS
from stickslip_fit.machine.load import mean_load
from stickslip_fit.simulate import draw_noise

ROUNDING = 1e-9  # of a joint's range, for what converting units rounds off
REST = 2.0  # s; who pauses longer begins another traverse
MEMORY = 1000
CHANCE = 1  # a stream of random numbers beside those of the days


@dataclass(frozen=True)
class Made:
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
class Past:
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

    def __init__(self, truth: Truth, session: str = "") -> None:
        self.truth = truth
        self._session = session
        self._began: float | None = None
        self._stands = {"q1": 0.0, "q2": -np.pi / 2, "q3": 0.0, "theta": 0.0, "psi": 0.0}
        self._given = dict.fromkeys(CONDITIONS, np.nan)
        self._stops = dict(truth.machine.ranges)
        self._past = dict.fromkeys(JOINTS, Past())
        self._leg: Leg | None = None
        self._steps = 0  # of the leg under way
        self._random = np.random.default_rng([truth.seed, CHANCE])
        self.made = deque([Made(-np.inf, 0.0, 0, 0)], maxlen=MEMORY)

    def step(self, joint: int, steps: int, began: float, period: float) -> None:
        """Make steps, more than 0 in `+`, less in `-`, the first at `began`, s.

        Raises
        ------
        InputError
            If the joint has no law, or comes to a halt.
        """
        direction = "+" if steps > 0 else "-"
        leg = self._under_way(joint, direction, began) or self._begin(joint, direction, began, period)
        moving = int(np.clip(np.ceil(leg.heard) - 1 - self._steps, 0, abs(steps)))
        self._steps += abs(steps)
        self.made.append(Made(began, period, abs(steps), moving))

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
            elif name in self._given or name.startswith(COVARIATE):
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
        self._past = {joint: Past(steps=past.steps) for joint, past in self._past.items()}

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
        self._random = np.random.default_rng([self.truth.seed, CHANCE, len(rows)])
        if rows.empty:
            return
        for joint, mine in rows.groupby("joint"):
            last = mine.iloc[[-1]]
            ways = (last[name].to_numpy() for name in ("start", "stop", "q1", "q2", "theta", "psi"))
            load = float(mean_load(int(joint), *ways)[0])
            self._past[int(joint)] = Past(str(last["direction"].iloc[0]), load, int(mine["steps"].sum()))
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

    def _under_way(self, joint: int, direction: str, began: float) -> Leg | None:
        """The leg that steps beginning now go on with."""
        leg = self._leg
        if leg is None or (leg.joint, leg.direction) != (joint, direction):
            return None
        return leg if began - self.made[-1].ended <= REST else None

    def _begin(self, joint: int, direction: str, began: float, period: float) -> Leg:
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
        self._leg = leg_of(self.truth, row, departure, self._random.random(3))
        return self._leg

    def _end_leg(self) -> None:
        """Where the joint stands, and what it remembers of the way there."""
        self._settle()
        leg, self._leg = self._leg, None
        if leg is None:
            return
        way = {name: leg.row[name].to_numpy() for name in ("start", "q1", "q2", "theta", "psi")}
        load = float(mean_load(leg.joint, stop=self._stands[f"q{leg.joint}"], **way)[0])
        self._past[leg.joint] = Past(leg.direction, load, self._past[leg.joint].steps + self._steps)
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
        if not low - ROUNDING * (high - low) <= value <= high + ROUNDING * (high - low):
            raise InputError(f"{name} = {value:g} lies beyond joint {joint}'s stops, {low:g} to {high:g}")
        return min(max(value, low), high)
