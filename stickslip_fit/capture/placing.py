"""Joints brought to where a traverse needs them, though nothing says where they stand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pandas as pd

from stickslip_fit.capture.driver import BrokenOffError, Driver, Row
from stickslip_fit.capture.expected import Predictor, expected
from stickslip_fit.capture.person import Answer, Setting, Work, position_text
from stickslip_fit.logs.traverse import ROUNDING
from stickslip_fit.machine import JOINTS, Machine

BACK_OFF = 200  # steps away from a stop that a joint may be standing at, so that the ear hears it run free


class Placing:
    """Knows where the joints stand, as far as stops were heard since.

    A stop is the only place that can be known: a joint is there once it was heard. Any other position is
    set by the person's hand, or else reached from the nearest stop by as many steps as a law says; it is
    then only as good as that law on that day: 1 % of 120 degrees are 1.2. Each drive that brings a joint
    into place is in the log as ``excluded``, with a note: it warms and wears the joint, but is no reading.

    Parameters
    ----------
    machine : Machine
    driver : Driver
    by_hand : callable
        From a joint and a position to the person's answer, once the joint is there.
    counting : Predictor, optional
        Says how many steps a position lies from a stop; what it does not know, and everything without it,
        is set by hand.
    """

    def __init__(
        self,
        machine: Machine,
        driver: Driver,
        by_hand: Callable[[int, float], Answer],
        counting: Predictor | None,
    ) -> None:
        self.counting = counting
        self.machine = machine
        self.driver = driver
        self.by_hand = by_hand
        self.known: dict[int, float] = {}

    def forget(self, joints: tuple[int, ...] = JOINTS) -> None:
        """Joints may have been moved: nothing is known of them until a stop is heard."""
        for joint in joints:
            self.known.pop(joint, None)

    def bring(self, row: Row, setting: Setting) -> None:
        """Bring the other joints to where they belong, and the moving one to its beginning.

        Raises
        ------
        BrokenOffError
            If a drive is broken off, or a joint meets a stop where there should be none.
        """
        moving = int(row["joint"])
        for joint in (*(other for other in JOINTS if other != moving), moving):
            target = float(row["start"] if joint == moving else row[f"q{joint}"])
            self._place(joint, target, row, setting)

    def _place(self, joint: int, target: float, row: Row, setting: Setting) -> None:
        if joint in self.known and self._alike(joint, self.known[joint], target):
            return
        low, high = self.stops(joint, setting)
        for stop in (low, high):
            if self._alike(joint, stop, target):
                self._home(joint, stop, row, setting)
                return
        nearest = low if target - low < high - target else high
        way = self._way(joint, nearest, target, row)
        predicted = expected(self.counting, pd.Series(way))
        if not predicted.known:
            self.by_hand(joint, target)
        else:
            self._place(joint, nearest, row, setting)
            self._count(joint, target, way, round(predicted.steps))
        self.known[joint] = target

    def stops(self, joint: int, setting: Setting) -> tuple[float, float]:
        """Where a joint is held: by its own stops, or by those that a person has set."""
        own = {each: (low, high) for each, low, high in setting.stops}
        return own.get(joint, self.machine.ranges[joint])

    def _home(self, joint: int, stop: float, row: Row, setting: Setting) -> None:
        low, high = self.stops(joint, setting)
        other = high if stop == low else low
        begin = self.known.get(joint, other)
        there = position_text(joint, stop)
        if joint not in self.known:
            away = self._way(joint, stop, other, row)
            self.driver.steps(away, BACK_OFF, f"joint {joint} moved off a stop it might stand at")
        self.forget((joint,))
        self.driver.to_stop(
            self._way(joint, begin, stop, row), f"joint {joint} brought to its stop at {there}"
        )
        self.known[joint] = stop

    def _count(self, joint: int, target: float, way: Row, steps: int) -> None:
        self.forget((joint,))
        purpose = f"joint {joint} brought to {position_text(joint, target)} by count"
        if not self.driver.steps(way, steps, purpose):
            work = Work(pd.Series(dict(way)), purpose, expected(self.counting, pd.Series(way)))
            raise BrokenOffError(work, f"joint {joint} met a stop where there should be none")

    def _way(self, joint: int, start: float, stop: float, row: Row) -> dict[str, Any]:
        """A drive of one joint while the others stand where they are, or where they are to be."""
        moving = int(row["joint"])
        there = {
            f"q{other}": self.known.get(other, row["start"] if other == moving else row[f"q{other}"])
            for other in JOINTS
        }
        direction = "+" if stop > start else "-"
        ends = {"joint": joint, "direction": direction, "start": start, "stop": stop}
        return {**row, **there, f"q{joint}": float("nan"), **ends}

    def _alike(self, joint: int, position: float, other: float) -> bool:
        return abs(position - other) <= ROUNDING * self.machine.span(joint)
