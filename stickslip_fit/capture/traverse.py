"""Drives one joint until its end stop is detected or for a number of steps, and records the drive.

`drive_to_stop` and `drive_steps` work on a `Rig` alone. `Driver` writes each drive to the journal:
before it begins, with each command, and when it ends. `DriveLimits` bounds steps and time in case no
stop is detected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import repeat
from math import ceil, isfinite
from typing import Any, Literal, Protocol

import pandas as pd

from stickslip_fit.capture.events import POSITION_COLUMNS
from stickslip_fit.capture.journal import Event, Journal, JournalReplay
from stickslip_fit.capture.operator import (
    CountPredictor,
    ExpectedCount,
    Operator,
    PlannedDrive,
    predict_count,
)
from stickslip_fit.capture.protocols import (
    Clock,
    ConnectionLost,
    Controller,
    ControllerError,
    Detection,
    EndStopDetector,
)

STEPS_PER_COMMAND = 20  # a pressed key takes effect after one command


@dataclass(frozen=True)
class Rig:
    """A controller, an end-stop detector, and the clock that both run by."""

    controller: Controller
    detector: EndStopDetector
    clock: Clock


@dataclass(frozen=True)
class DriveTarget:
    """Where a joint is to go, and the limits of the drive.

    Attributes
    ----------
    direction : {'+', '-'}
    check_every : int
        Steps between two checks for the stop.
    max_steps : int
        Limit that holds whatever is detected.
    max_seconds : float
        Limit of time; a command that has been given is completed.
    """

    joint: int
    direction: str
    check_every: int
    max_steps: int
    max_seconds: float


@dataclass(frozen=True)
class DriveOutcome:
    """How a drive ended.

    Attributes
    ----------
    steps : int
        Commanded, up to the check at which the stop was first detected.
    status : {'ok', 'interrupted'}
    reason : str
        Why it was interrupted.
    connection_lost : bool
        Nothing can be driven until the controller is reconnected.
    overrun : int
        Steps commanded after `steps`, until the detection was certain.
    limit_reached : bool
        No stop was detected within the limit of steps.
    """

    steps: int
    status: Literal["ok", "interrupted"]
    reason: str = ""
    connection_lost: bool = False
    overrun: int = 0
    limit_reached: bool = False


class DriveObserver(Protocol):
    """Follows a drive."""

    def before_command(self, steps: int) -> None:
        """The next command makes it so many steps in all; it is given unless this raises."""

    def detected(self, steps: int, detection: Detection) -> None:
        """The check after so many steps."""

    def stop_wanted(self) -> bool:
        """Whether the drive is to be interrupted, e.g. by a key."""


class _InterruptError(Exception):
    def __init__(self, reason: str, connection_lost: bool = False, limit_reached: bool = False) -> None:
        self.reason = reason
        self.connection_lost = connection_lost
        self.limit_reached = limit_reached
        super().__init__(reason)


def drive_to_stop(rig: Rig, drive_target: DriveTarget, observer: DriveObserver) -> DriveOutcome:
    """Drive a joint until its stop is detected: one traverse, where it began at the other stop.

    A count is a measurement only from stop to stop. A traverse that began elsewhere or ended by count
    would put the law's own prediction into the log, so each traverse of a campaign begins and ends at a
    stop, the joint's own or one that the operator has set; see `campaign.Homing`.

    Returns
    -------
    DriveOutcome
        ``interrupted`` after a fault of the detector or the controller, at a limit, or on the observer's
        request; the controller has been stopped then.

    Raises
    ------
    InputError
        From the detector or the observer; the controller has been stopped.
    """
    return _drive(rig, drive_target, observer, repeat(drive_target.check_every))


def drive_steps(rig: Rig, drive_target: DriveTarget, steps: int, observer: DriveObserver) -> DriveOutcome:
    """Drive a joint so many steps, fewer where it meets a stop before; raises as `drive_to_stop`."""
    checks, rest = divmod(steps, drive_target.check_every)
    stretches = [drive_target.check_every] * checks + [rest] * (rest > 0)
    return _drive(rig, drive_target, observer, stretches)


def _drive(
    rig: Rig, drive_target: DriveTarget, observer: DriveObserver, stretches: Iterable[int]
) -> DriveOutcome:
    """Make one stretch of steps after another, with a check after each, until a stop is detected."""
    drive = _RunningDrive(rig, drive_target, observer)
    try:
        rig.detector.begin()
        last_check = drive.began
        for stretch in stretches:
            drive.step(stretch)
            now = rig.clock.now()
            detection, last_check = rig.detector.check(now - last_check), now
            observer.detected(drive.steps, detection)
            if detection.fault:
                raise _InterruptError(detection.fault)
            if detection.at_stop:
                overrun = min(detection.late_checks * drive_target.check_every, drive.steps)
                return DriveOutcome(drive.steps - overrun, "ok", overrun=overrun)
        return DriveOutcome(drive.steps, "ok")
    except BaseException as error:
        with suppress(ControllerError):
            rig.controller.stop()
        if isinstance(error, _InterruptError):
            how = {"connection_lost": error.connection_lost, "limit_reached": error.limit_reached}
            return DriveOutcome(drive.steps, "interrupted", error.reason, **how)
        raise


class _RunningDrive:
    """The commands of a drive in progress."""

    def __init__(self, rig: Rig, drive_target: DriveTarget, observer: DriveObserver) -> None:
        self.rig = rig
        self.target = drive_target
        self.observer = observer
        self.steps = 0
        self.began = rig.clock.now()

    def step(self, steps: int) -> None:
        sign = 1 if self.target.direction == "+" else -1
        for begin in range(0, steps, STEPS_PER_COMMAND):
            command = min(STEPS_PER_COMMAND, steps - begin)
            self._check_limits(command)
            self.observer.before_command(self.steps + command)
            self.steps += command
            try:
                self.rig.controller.step(self.target.joint, sign * command)
            except ControllerError as error:
                raise _InterruptError(str(error), isinstance(error, ConnectionLost)) from None

    def _check_limits(self, command: int) -> None:
        if self.observer.stop_wanted():
            raise _InterruptError("stopped by a key")
        if self.steps + command > self.target.max_steps:
            limit = f"{self.target.max_steps:,} steps"
            raise _InterruptError(f"no stop was heard within the limit of {limit}", limit_reached=True)
        if self.rig.clock.now() - self.began > self.target.max_seconds:
            limit = f"{self.target.max_seconds:,.0f} s ({self.steps:,} steps)"
            raise _InterruptError(f"no stop was heard within the limit of {limit}")


Row = Mapping[str, Any]
# Of the counts of a joint for the same way in different configurations. The published law at the parameters
# that the thesis prints has steps of 347 to 1,348 nm.
MAX_CONFIGURATION_RATIO = 4.5
COMMIT_INTERVAL = 100  # commands between two records that survive a power cut: each takes milliseconds


@dataclass(frozen=True)
class DriveLimits:
    """Limits that protect the manipulator where no stop is detected.

    Attributes
    ----------
    max_steps : int
        Of any drive.
    max_count_ratio : float
        Steps over the predicted count, where there is one.
    max_slowdown : float
        Time over that of the plan's step period.
    spare_seconds : float
        Added to the time limit of each drive.
    """

    max_steps: int = 60_000
    max_count_ratio: float = 1.25
    max_slowdown: float = 4.0
    spare_seconds: float = 30.0

    def target(self, row: Row, predicted: ExpectedCount) -> DriveTarget:
        """A drive with its limits."""
        check_every = int(row["check_every"])
        high = predicted.high if isfinite(predicted.high) else predicted.steps
        # The stop is detected a few checks after it is met.
        steps = ceil(self.max_count_ratio * high) + 20 * check_every if predicted.known else self.max_steps
        steps = min(steps, self.max_steps)
        seconds = self.spare_seconds + self.max_slowdown * steps * float(row["step_period"])
        return DriveTarget(int(row["joint"]), str(row["direction"]), check_every, steps, seconds)


class DriveInterruptedError(Exception):
    """A drive did not end as it should; it is in the journal."""

    def __init__(self, drive: PlannedDrive, reason: str, limit_reached: bool = False) -> None:
        self.drive = drive
        self.reason = reason
        self.limit_reached = limit_reached
        super().__init__(reason)


@dataclass(frozen=True, eq=False)
class Driver:
    """Makes drives and records them in a journal, of which `replay` is the content."""

    rig: Rig
    journal: Journal
    replay: JournalReplay
    operator: Operator
    predictor: CountPredictor | None
    drive_limits: DriveLimits

    def traverse(self, row: Row, planned: int, title: str) -> tuple[PlannedDrive, int]:
        """Make a traverse of the plan, from stop to stop.

        Returns
        -------
        drive : PlannedDrive
        steps : int
            Recorded in the journal.

        Raises
        ------
        DriveInterruptedError
        ConnectionLost
        InputError
            From the detector or the journal.
        """
        drive = self.plan_drive(row, title)
        return drive, self._record(drive, planned, "", drive_to_stop)

    def to_stop(self, row: Row, purpose: str, farthest: float) -> None:
        """Drive a joint to its stop, from a start that may be as far as `farthest`; raises as `traverse`."""
        self._record(self.plan_drive(row, purpose), None, purpose, drive_to_stop, farthest)

    def steps(self, row: Row, steps: int, purpose: str) -> bool:
        """Make so many steps; whether no stop was met. Raises as `traverse`."""

        def run(rig: Rig, drive_target: DriveTarget, observer: DriveObserver) -> DriveOutcome:
            return drive_steps(rig, drive_target, steps, observer)

        return self._record(self.plan_drive(row, purpose), None, purpose, run) == steps

    def write(self, event: Event) -> None:
        """Write an event so that it survives a power cut."""
        self.journal.commit(event)
        self.replay.apply(event)

    def plan_drive(self, row: Row, title: str) -> PlannedDrive:
        """A drive with its predicted count."""
        series = pd.Series(dict(row))
        return PlannedDrive(series, title, predict_count(self.predictor, series))

    def _record(
        self,
        drive: PlannedDrive,
        planned: int | None,
        purpose: str,
        run: Callable[[Rig, DriveTarget, DriveObserver], DriveOutcome],
        farthest: float | None = None,
    ) -> int:
        """Run a drive and return its steps; it may have to begin as far away as `farthest`."""
        self.operator.begin_drive(drive)
        drive_target = self.drive_limits.target(drive.row, self._expect_at_most(drive, farthest))
        row = self._journal_row(drive.row)
        self.write({"event": "drive", "planned": planned, "purpose": purpose, "row": row})
        outcome = run(self.rig, drive_target, _JournalObserver(self, drive))
        result = {"steps": outcome.steps, "pushed": outcome.overrun, "status": outcome.status}
        self.write({"event": "ended", **result, "why": outcome.reason})
        if outcome.connection_lost:
            raise ConnectionLost(f"{outcome.reason}; see to the controller, then go on with --resume")
        if outcome.status != "ok":
            raise DriveInterruptedError(drive, outcome.reason, outcome.limit_reached)
        return outcome.steps

    def _expect_at_most(self, drive: PlannedDrive, farthest: float | None) -> ExpectedCount:
        """The predicted count or, without one, the most that the readings of the campaign admit."""
        row, predicted = drive.row, drive.expected
        if farthest is not None:
            row = pd.Series({**row, "start": farthest})
            predicted = predict_count(self.predictor, row)
        counts = [
            reading.steps / abs(reading.row["stop"] - reading.row["start"])
            for reading in self.replay.drives
            if reading.status == "ok"
            and (reading.row["joint"], reading.row["direction"]) == (row["joint"], row["direction"])
        ]
        if predicted.known or not counts:
            return predicted
        return ExpectedCount(MAX_CONFIGURATION_RATIO * max(counts) * abs(row["stop"] - row["start"]))

    def _journal_row(self, row: pd.Series) -> dict[str, Any]:
        positions = {name: None if pd.isna(row[name]) else float(row[name]) for name in POSITION_COLUMNS}
        return {
            "session": str(row["session"]),
            "time": self._now().isoformat(timespec="milliseconds"),
            "joint": int(row["joint"]),
            "direction": str(row["direction"]),
            **positions,
            "status": str(row.get("status", "ok")),
            "check_every": int(row["check_every"]),
            "step_period": float(row["step_period"]),
        }

    def _now(self) -> datetime:
        """The time, later than that of the drive before even where the computer's clock was put back."""
        today = self.rig.clock.today()
        last = self.replay.last_time
        return today if last is None else max(today, last + timedelta(milliseconds=1))


class _JournalObserver:
    """Records each command before it is given, and shows the progress."""

    def __init__(self, driver: Driver, drive: PlannedDrive) -> None:
        self.driver = driver
        self.drive = drive
        self.commands = 0

    def before_command(self, steps: int) -> None:
        event = {"event": "commanded", "steps": steps}
        self.commands += 1
        write = self.driver.journal.append if self.commands % COMMIT_INTERVAL else self.driver.journal.commit
        write(event)
        self.driver.replay.apply(event)

    def detected(self, steps: int, detection: Detection) -> None:
        self.driver.operator.progress(self.drive, steps, detection)

    def stop_wanted(self) -> bool:
        return self.driver.operator.stop_wanted()
