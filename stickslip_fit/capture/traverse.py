"""Drives one joint until its end stop is detected or for a number of steps, and records the drive.

`drive_to_stop` and `drive_steps` work on a `Rig` alone. `Driver` writes each drive to the journal:
before it begins, with each command, and when it ends. `DriveLimits` bounds steps and time in case no
stop is detected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import repeat
from math import ceil, isfinite
from typing import Any, Literal, Protocol

import pandas as pd

from stickslip_fit.capture.journal import POSITION_COLUMNS, Event, Journal, JournalReplay
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

STEPS_PER_COMMAND = 20  # steps in one command; whoever presses a key waits no longer than these take


@dataclass(frozen=True)
class Rig:
    """What drives, what listens, and the time they go by."""

    controller: Controller
    detector: EndStopDetector
    clock: Clock


@dataclass(frozen=True)
class DriveTarget:
    """Where a joint is to go, and what it may not exceed.

    Attributes
    ----------
    joint : int
    direction : {'+', '-'}
    check_every : int
        The stop is listened for after so many steps.
    max_steps : int
        No more steps than that, whatever is heard.
    max_seconds : float
        No longer than that; a command that has been given is waited for.
    """

    joint: int
    direction: str
    check_every: int
    max_steps: int
    max_seconds: float


@dataclass(frozen=True)
class DriveOutcome:
    """What came of a drive.

    Attributes
    ----------
    steps : int
        Commanded, up to the check at which the stop was first heard.
    status : {'ok', 'interrupted'}
    why : str
        Why it was broken off.
    unplugged : bool
        Nothing can be driven until somebody sees to the controller.
    pushed : int
        Steps commanded after that, until the ear was sure: the joint was at its stop already.
    """

    steps: int
    status: Literal["ok", "interrupted"]
    why: str = ""
    unplugged: bool = False
    pushed: int = 0


class DriveObserver(Protocol):
    """Whoever follows a drive."""

    def commanding(self, steps: int) -> None:
        """So many steps will have been commanded in all; they are when this returns, and not if it raises."""

    def heard(self, steps: int, heard: Detection) -> None:
        """What was heard after so many steps."""

    def stop_wanted(self) -> bool:
        """Whether somebody asks for the drive to be broken off, as with a key."""


class _InterruptError(Exception):
    def __init__(self, why: str, unplugged: bool = False) -> None:
        self.why = why
        self.unplugged = unplugged
        super().__init__(why)


def drive_to_stop(rig: Rig, drive_target: DriveTarget, watch: DriveObserver) -> DriveOutcome:
    """Drive a joint until its stop is heard: one traverse, where it began at the other stop.

    What is counted is honest only from stop to stop. A traverse that began elsewhere or ended by count
    would put the law's own prediction into the log as if it were a reading, so the campaign begins each
    at a stop, the joint's own or one that a person has set, and ends it at one; see `placing`.

    Parameters
    ----------
    rig : Rig
    drive_target : Way
    watch : Watch

    Returns
    -------
    Outcome
        ``interrupted`` where the ear is at fault, the controller refuses, a limit is met or `watch` asks
        for it; the controller has been told to stop then.

    Raises
    ------
    InputError
        From the ear or from `watch`; the controller has been told to stop.
    """
    return _drive(rig, drive_target, watch, repeat(drive_target.check_every))


def drive_steps(rig: Rig, drive_target: DriveTarget, steps: int, watch: DriveObserver) -> DriveOutcome:
    """Drive a joint so many steps, to bring it near a position; fewer where it meets a stop before.

    Parameters
    ----------
    rig : Rig
    drive_target : Way
    steps : int
    watch : Watch

    Raises
    ------
    InputError
        As `drive_to_stop`.
    """
    whole, rest = divmod(steps, drive_target.check_every)
    stretches = [drive_target.check_every] * whole + [rest] * (rest > 0)
    return _drive(rig, drive_target, watch, stretches)


def _drive(
    rig: Rig, drive_target: DriveTarget, watch: DriveObserver, stretches: Iterable[int]
) -> DriveOutcome:
    """Make one stretch of steps after another until a stop is heard."""
    run = _RunningDrive(rig, drive_target, watch)
    try:
        for heard in run.checks(stretches):
            if heard.fault:
                raise _InterruptError(heard.fault)
            if heard.at_stop:
                pushed = min(heard.late_checks * drive_target.check_every, run.steps)
                return DriveOutcome(run.steps - pushed, "ok", pushed=pushed)
        return DriveOutcome(run.steps, "ok")
    except _InterruptError as broken:
        _stop(rig)
        return DriveOutcome(run.steps, "interrupted", broken.why, broken.unplugged)
    except BaseException:
        _stop(rig)
        raise


def _stop(rig: Rig) -> None:
    with suppress(ControllerError):
        rig.controller.stop()


class _RunningDrive:
    """A drive under way."""

    def __init__(self, rig: Rig, drive_target: DriveTarget, watch: DriveObserver) -> None:
        self.rig = rig
        self.way = drive_target
        self.watch = watch
        self.steps = 0
        self.began = rig.clock.now()

    def checks(self, stretches: Iterable[int]) -> Iterator[Detection]:
        """Make one stretch of steps after another, and listen after each."""
        self.rig.detector.begin()
        heard_until = self.began
        for stretch in stretches:
            self._make(stretch)
            now = self.rig.clock.now()
            heard = self.rig.detector.check(now - heard_until)
            heard_until = now
            self.watch.heard(self.steps, heard)
            yield heard

    def _make(self, steps: int) -> None:
        for begin in range(0, steps, STEPS_PER_COMMAND):
            command = min(STEPS_PER_COMMAND, steps - begin)
            self._refuse(command)
            self.watch.commanding(self.steps + command)
            self.steps += command
            try:
                self.rig.controller.step(self.way.joint, command if self.way.direction == "+" else -command)
            except ControllerError as error:
                raise _InterruptError(str(error), isinstance(error, ConnectionLost)) from None

    def _refuse(self, command: int) -> None:
        if self.watch.stop_wanted():
            raise _InterruptError("stopped by a key")
        if self.steps + command > self.way.max_steps:
            raise _InterruptError(f"no stop was heard within the limit of {self.way.max_steps:,} steps")
        if self.rig.clock.now() - self.began > self.way.max_seconds:
            raise _InterruptError(
                f"no stop was heard within the limit of {self.way.max_seconds:,.0f} s ({self.steps:,} steps)"
            )


Row = Mapping[str, Any]
# Commands between two that are written to outlive a power cut: those take milliseconds, too long for each.
COMMIT_INTERVAL = 100


@dataclass(frozen=True)
class DriveLimits:
    """What protects the manipulator from an ear that hears nothing.

    Attributes
    ----------
    max_steps : int
        For any drive.
    max_count_ratio : float
        Where a count was predicted, no more than that times it.
    max_slowdown : float
        A step takes no longer than that times what the plan says.
    spare_seconds : float
        On top of that, for each drive.
    """

    max_steps: int = 60_000
    max_count_ratio: float = 1.25
    max_slowdown: float = 4.0
    spare_seconds: float = 30.0

    def way(self, row: Row, predicted: ExpectedCount) -> DriveTarget:
        """A drive with its limits."""
        every = int(row["check_every"])
        high = predicted.high if isfinite(predicted.high) else predicted.steps
        # The stop is heard a few checks after it is met.
        steps = ceil(self.max_count_ratio * high) + 20 * every if predicted.known else self.max_steps
        steps = min(steps, self.max_steps)
        seconds = self.spare_seconds + self.max_slowdown * steps * float(row["step_period"])
        return DriveTarget(int(row["joint"]), str(row["direction"]), every, steps, seconds)


class DriveInterruptedError(Exception):
    """A drive that did not end as it should; it is in the journal."""

    def __init__(self, work: PlannedDrive, why: str) -> None:
        self.work = work
        self.why = why
        super().__init__(why)


class Driver:
    """Makes drives and writes them down.

    Parameters
    ----------
    rig : Rig
    journal : Journal
    ledger : Ledger
        Of that journal.
    person : Person
    predictor : Predictor or None
    drive_limits : Safety
    """

    def __init__(
        self,
        rig: Rig,
        journal: Journal,
        replay: JournalReplay,
        operator: Operator,
        predictor: CountPredictor | None,
        drive_limits: DriveLimits,
    ) -> None:
        self.rig = rig
        self.journal = journal
        self.ledger = replay
        self.operator = operator
        self.predictor = predictor
        self.drive_limits = drive_limits

    def traverse(self, row: Row, planned: int, title: str) -> tuple[PlannedDrive, int]:
        """Make a traverse of the plan, from stop to stop.

        Returns
        -------
        work : Work
        steps : int
            Written down for good.

        Raises
        ------
        BrokenOffError
        Unplugged
            If the connection to the controller is lost.
        InputError
            From the ear or the journal.
        """
        work = self._work(row, title)
        return work, self._drive(
            work, planned, "", lambda drive_target, watch: drive_to_stop(self.rig, drive_target, watch)
        )

    def to_stop(self, row: Row, purpose: str) -> None:
        """Run a joint into its stop; raises as `traverse`."""
        self._drive(
            self._work(row, purpose),
            None,
            purpose,
            lambda drive_target, watch: drive_to_stop(self.rig, drive_target, watch),
        )

    def steps(self, row: Row, steps: int, purpose: str) -> bool:
        """Make so many steps; whether no stop was met on the way. Raises as `traverse`."""
        work = self._work(row, purpose)
        made = self._drive(
            work, None, purpose, lambda drive_target, watch: drive_steps(self.rig, drive_target, steps, watch)
        )
        return made == steps

    def write(self, event: Event) -> None:
        """Write an event so that it outlives a power cut."""
        self.journal.commit(event)
        self.ledger.take(event)

    def _work(self, row: Row, title: str) -> PlannedDrive:
        series = pd.Series(dict(row))
        return PlannedDrive(series, title, predict_count(self.predictor, series))

    def _drive(
        self,
        work: PlannedDrive,
        planned: int | None,
        purpose: str,
        drive: Callable[[DriveTarget, _JournalObserver], DriveOutcome],
    ) -> int:
        self.operator.begins(work)
        drive_target = self.drive_limits.way(work.row, work.expected)
        self.write({"event": "drive", "planned": planned, "purpose": purpose, "row": self._written(work.row)})
        outcome = drive(drive_target, _JournalObserver(self, work))
        self.write(
            {
                "event": "ended", "steps": outcome.steps, "pushed": outcome.pushed,
                "status": outcome.status, "why": outcome.why,
            }
        )  # fmt: skip
        if outcome.unplugged:
            raise ConnectionLost(f"{outcome.why}; see to the controller, then go on with --resume")
        if outcome.status != "ok":
            raise DriveInterruptedError(work, outcome.why)
        return outcome.steps

    def _written(self, row: pd.Series) -> dict[str, Any]:
        places = {name: None if pd.isna(row[name]) else float(row[name]) for name in POSITION_COLUMNS}
        return {
            "session": str(row["session"]),
            "time": self._now().isoformat(timespec="milliseconds"),
            "joint": int(row["joint"]),
            "direction": str(row["direction"]),
            **places,
            "check_every": int(row["check_every"]),
            "step_period": float(row["step_period"]),
        }

    def _now(self) -> datetime:
        """The time, later than that of the drive before even where the computer's clock was put back."""
        today = self.rig.clock.today()
        last = self.ledger.last_time
        return today if last is None else max(today, last + timedelta(milliseconds=1))


class _JournalObserver:
    """Writes a drive's commands down before they are given, and shows how it goes."""

    def __init__(self, driver: Driver, work: PlannedDrive) -> None:
        self.driver = driver
        self.work = work
        self.commands = 0

    def commanding(self, steps: int) -> None:
        event = {"event": "commanded", "steps": steps}
        self.commands += 1
        if self.commands % COMMIT_INTERVAL:
            self.driver.journal.append(event)
        else:
            self.driver.journal.commit(event)
        self.driver.ledger.take(event)

    def heard(self, steps: int, heard: Detection) -> None:
        self.driver.operator.progress(self.work, steps, heard)

    def stop_wanted(self) -> bool:
        return self.driver.operator.stop_wanted()
