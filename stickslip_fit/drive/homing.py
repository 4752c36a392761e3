"""Going home: a joint driven to its stop by sound, which ends its uncertainty and is a reading for a log.

The count is a measurement where the joint has come all the way from its other stop, in one direction and with
the other joints at rest, whether by hand or not: then the row of the log counts. Else its start is an
estimate by the very law that the log is to calibrate, and the row is ``excluded``, with a note that says
how far the start may be off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from math import ceil, nan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import format_value, pluralize
from stickslip_fit._io import write_atomically
from stickslip_fit.capture.journal import LOG_COLUMNS
from stickslip_fit.capture.protocols import ConnectionLost, Detection
from stickslip_fit.capture.traverse import DriveTarget, Rig, drive_to_stop
from stickslip_fit.drive.diffusion import Burst
from stickslip_fit.drive.record import BurstRecord, Departure
from stickslip_fit.errors import InputError
from stickslip_fit.logs.log import format_csv
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.machine import Machine
from stickslip_fit.moves import DriveReckoning
from stickslip_fit.units import JOINTS, PRISMATIC, Z_95

CHECK_EVERY = 5
MAX_COUNT_RATIO = 1.25  # of the steps that the law expects
SPARE_CHECKS = 20  # before the stop is certain
MAX_SLOWDOWN, SPARE_SECONDS = 4.0, 30.0


@dataclass
class HomingLog:
    """The rows that goings home have made, written to a log after each; none is kept without a path."""

    path: Path | None
    machine: Machine
    rows: list[dict[str, Any]] = field(default_factory=list)

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row, and write the log; raises InputError where it cannot be written."""
        if self.path is None:
            return
        self.rows.append(dict(row))
        table = pd.DataFrame(self.rows, columns=[*LOG_COLUMNS])
        table["time"] = pd.to_datetime(table["time"], utc=True)
        numbers = [name for name in (*CONDITIONS, "q1", "q2", "q3", "theta", "psi", "start", "stop")]
        table = table.astype(dict.fromkeys(numbers, float) | {"joint": "int64", "steps": "int64"})
        write_atomically(self.path, format_csv(table, self.machine))


@dataclass(frozen=True)
class StopFinder:
    """Brings joints to their stops: a `loop.Homing`.

    Attributes
    ----------
    interrupted : callable
        Whether the person wants to stop.
    progress : callable
        Called after each check for the stop.
    """

    drive: DriveReckoning
    rig: Rig
    record: BurstRecord
    log: HomingLog
    seconds: Callable[[], float]
    interrupted: Callable[[], bool]
    progress: Callable[[], None]
    step_period: float

    def __call__(self, joint: int) -> str:
        """Bring a joint to its nearest stop; a sentence on what came of it.

        Raises
        ------
        InputError
            If no stop is detected where it has to be, or on request; the joint stands where it was left.
        ConnectionLost
        """
        drive, (low, high) = self.drive, self.drive.arm.machine.ranges[joint]
        start, error = drive.q[joint - 1], drive.variance(joint) ** 0.5
        stop = low if start - low <= high - start else high
        if start == stop and not error:
            return f"joint {joint} is at its stop already"
        direction = "-" if stop == low else "+"
        departure = self.record.departures.get(joint)
        if departure is not None and departure.direction == direction:
            return self._complete(joint, departure, stop)
        row = self._row(joint, direction, start, stop, self.seconds())
        steps = self._drive(joint, direction, stop, row)
        note = f"brought home from an estimated start, {_plus_minus(joint, error)} (95 %)"
        if steps:
            self.log.add(row | {"steps": steps, "status": "excluded", "note": note})
        return f"joint {joint} is at its stop after {pluralize(steps, 'step')}"

    def _complete(self, joint: int, departure: Departure, stop: float) -> str:
        """Complete a traverse that began at the other stop; its count is a reading."""
        low, high = self.drive.arm.machine.ranges[joint]
        observer = _Observer(self, joint, departure.direction)
        # The stop is looked for every so many steps of the whole count, as the row says.
        missing = -departure.steps % CHECK_EVERY
        if missing:
            observer.before_command(missing)
            with observer.doubting():
                self.rig.controller.step(joint, missing if departure.direction == "+" else -missing)
        row = self._row(joint, departure.direction, low + high - stop, stop, departure.seconds)
        steps = departure.steps + missing
        steps += self._drive(joint, departure.direction, stop, row)
        self.log.add(row | {"steps": steps, "status": "ok", "note": "driven by hand, then to the stop"})
        return f"joint {joint} is at its stop after {steps:,} steps from its other one: a reading"

    def _drive(self, joint: int, direction: str, stop: float, row: Mapping[str, Any]) -> int:
        """Drive to the stop; the steps until it was detected."""
        drive, observer = self.drive, _Observer(self, joint, direction)
        with observer.doubting():
            outcome = drive_to_stop(self.rig, self._target(joint, direction, stop), observer)
        self.record.departures.clear()
        if outcome.status != "ok":
            observer.doubt()
            if outcome.steps:
                why = {"status": "interrupted", "note": outcome.reason}
                self.log.add({**row, "steps": outcome.steps, "check_every": 1, **why})
            message = f"joint {joint} was not brought to its stop: {outcome.reason}"
            raise (ConnectionLost if outcome.connection_lost else InputError)(message)
        drive.place(joint, stop)
        self.record.rest(drive, self.seconds())
        return outcome.steps

    def _target(self, joint: int, direction: str, stop: float) -> DriveTarget:
        """The drive with its limits, from the farthest place at which the joint may stand."""
        drive = self.drive
        size, start = drive.step_size(joint, direction, self.seconds()), drive.q[joint - 1]
        counts = Z_95 * drive.variance(joint) ** 0.5 / size
        if start != stop:
            counts += drive.arm.joint_travel(np.array(drive.q), joint, stop).counts
        steps = ceil(MAX_COUNT_RATIO * counts) + SPARE_CHECKS * CHECK_EVERY
        seconds = SPARE_SECONDS + MAX_SLOWDOWN * steps * self.step_period
        return DriveTarget(joint, direction, CHECK_EVERY, steps, seconds)

    def _row(self, joint: int, direction: str, start: float, stop: float, began: float) -> dict[str, Any]:
        arm = self.drive.arm
        positions = {f"q{number}": nan if number == joint else self.drive.q[number - 1] for number in JOINTS}
        conditions = {name: arm.conditions.get(name, nan) for name in CONDITIONS}
        conditions["step_period"] = self.step_period
        time = self.rig.clock.today() - timedelta(seconds=self.seconds() - began)
        return {
            "session": arm.session,
            "time": time.isoformat(timespec="milliseconds"),
            "joint": joint,
            "direction": direction,
            **positions,
            "theta": arm.theta,
            "psi": arm.psi,
            "start": start,
            "stop": stop,
            "check_every": CHECK_EVERY,
            **conditions,
        }


class _Observer:
    """Records and follows each command of a going home."""

    def __init__(self, finder: StopFinder, joint: int, direction: str) -> None:
        self.finder = finder
        self.joint = joint
        self.direction = direction
        self.steps = 0
        self.moved = 0.0
        self.checked = True  # the last command has been carried out

    def before_command(self, steps: int) -> None:
        finder, more = self.finder, steps - self.steps
        seconds = finder.seconds()
        finder.record.burst(Burst(self.joint, self.direction, more), finder.drive, seconds)
        self.moved = finder.drive.advance(self.joint, self.direction, more, seconds)
        self.steps, self.checked = steps, False

    def detected(self, steps: int, detection: Detection) -> None:
        self.checked = True
        self.finder.progress()

    def stop_wanted(self) -> bool:
        return self.finder.interrupted()

    @contextmanager
    def doubting(self) -> Iterator[None]:
        """Doubt the last command where something ends it, a person or the program."""
        try:
            yield
        except BaseException:
            self.doubt()
            raise

    def doubt(self) -> None:
        """The last command may or may not have been carried out, if no check followed it."""
        if not self.checked:
            self.finder.drive.doubt(self.joint, self.moved)


def _plus_minus(joint: int, error: float) -> str:
    unit, decimals = ("µm", 2) if joint == PRISMATIC else ("µrad", 0)
    return f"± {format_value(Z_95 * error, unit, decimals)}"
