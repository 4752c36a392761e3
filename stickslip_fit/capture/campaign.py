"""Campaign: goes through a plan at a rig, from session to session. Start reading here.

For each traverse the operator sets the base, `Homing` brings the joints into place and `traverse`
drives and records it. A joint's position is known only after it has reached a stop; other positions are
set by hand or by count. The log is written from the journal, so that an interrupted campaign can be
resumed.
"""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from stickslip_fit import __version__
from stickslip_fit._io import write_atomically
from stickslip_fit.capture.events import ImpossibleEventError
from stickslip_fit.capture.journal import (
    Event,
    Journal,
    JournalReplay,
    continue_journal,
    create_journal,
    read_journal,
)
from stickslip_fit.capture.operator import (
    DEFAULT_TOLERANCE,
    CountPredictor,
    ExpectedCount,
    Operator,
    OperatorChoice,
    OperatorReply,
    PlannedDrive,
    RigSetting,
    TraverseReading,
    format_position,
    predict_count,
)
from stickslip_fit.capture.traverse import DriveInterruptedError, DriveLimits, Driver, Rig, Row
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.log import format_csv
from stickslip_fit.logs.plan import RANGE_TOL, Plan
from stickslip_fit.machine import Machine
from stickslip_fit.units import JOINTS

BACK_OFF_STEPS = 200  # away from a stop that a joint may be standing at, so that the detector hears it move
HAND_UNCERTAINTY = 0.05  # of the range, of a position that was set by hand
COUNT_UNCERTAINTY = DEFAULT_TOLERANCE  # of the way, of a position that was reached by count


@dataclass(frozen=True)
class _Place:
    """Where a joint stands, rad or m, and how far it may stand from there."""

    position: float
    uncertainty: float = 0.0


@dataclass(frozen=True, eq=False)
class Homing:
    """Brings the joints into place, and knows where they stand.

    A joint's position is known once its stop was detected. Any other position is set by hand, or reached
    from the nearest stop by as many steps as a law says; it is then only as accurate as that law on that
    day: 1 % of 120 degrees are 1.2. Each drive that brings a joint into place is in the log as
    ``excluded``, with a note: it warms and wears the joint, but is no reading.

    A joint is driven to a stop over the way from the farthest place at which it may stand, and no further
    than `DriveLimits` allow for that; a stop that is not detected by then is not tried again.

    Attributes
    ----------
    by_hand : callable
        From a joint and a position to the operator's reply, once the joint is there.
    count_predictor : CountPredictor, optional
        Predicts the steps from a stop to a position; a joint that it has no prediction for is set by hand.
    """

    machine: Machine
    driver: Driver
    by_hand: Callable[[int, float], OperatorReply]
    count_predictor: CountPredictor | None
    known: dict[int, _Place] = field(default_factory=dict, init=False)

    def reached(self, joint: int, stop: float) -> None:
        """A joint stands at this stop, which was detected."""
        self.known[joint] = _Place(stop)

    def forget(self, joints: tuple[int, ...] = JOINTS) -> None:
        """Joints may have been moved: their positions are unknown until a stop is detected."""
        for joint in joints:
            self.known.pop(joint, None)

    def bring(self, row: Row, setting: RigSetting) -> None:
        """Bring the other joints to their positions, and the moving one to its start.

        Raises
        ------
        DriveInterruptedError
            If a drive is interrupted, or a joint meets a stop where there should be none.
        InputError
            If a stop is not detected where it has to be.
        """
        moving = int(row["joint"])
        for joint in (*(other for other in JOINTS if other != moving), moving):
            target = float(row["start"] if joint == moving else row[f"q{joint}"])
            self._place(joint, target, row, setting)

    def _place(self, joint: int, target: float, row: Row, setting: RigSetting) -> None:
        if joint in self.known and self._equal(joint, self.known[joint].position, target):
            return
        stops_set = {number: (low, high) for number, low, high in setting.stops}
        low, high = stops_set.get(joint, self.machine.ranges[joint])
        for stop in (low, high):
            if self._equal(joint, stop, target):
                self._home(joint, stop, high if stop == low else low, row)
                return
        nearest = low if target - low < high - target else high
        drive_row = self._drive_row(joint, nearest, target, row)
        predicted = predict_count(self.count_predictor, pd.Series(drive_row))
        if not predicted.known:
            self.by_hand(joint, target)
            uncertainty = HAND_UNCERTAINTY * (high - low)
        else:
            self._place(joint, nearest, row, setting)
            self._count(joint, target, drive_row, predicted)
            uncertainty = COUNT_UNCERTAINTY * abs(target - nearest)
        self.known[joint] = _Place(target, uncertainty)

    def _home(self, joint: int, stop: float, other_stop: float, row: Row) -> None:
        place = self.known.get(joint, _Place(other_stop))
        outwards = place.uncertainty if other_stop > stop else -place.uncertainty
        farthest = place.position + outwards
        if abs(farthest - stop) > abs(other_stop - stop):
            farthest = other_stop
        if joint not in self.known:
            back_off = self._drive_row(joint, stop, other_stop, row)
            self.driver.steps(back_off, BACK_OFF_STEPS, f"joint {joint} moved off a stop it might stand at")
        self.forget((joint,))
        purpose = f"joint {joint} brought to its stop at {format_position(joint, stop)}"
        try:
            self.driver.to_stop(self._drive_row(joint, place.position, stop, row), purpose, farthest)
        except DriveInterruptedError as interrupted:
            if not interrupted.limit_reached:
                raise
            raise InputError(
                f"{purpose}: {interrupted.reason}, which is as far away as it can be. See that the joint "
                "moves and that the law is its own, tune the end-stop detector again (`capture tune`), then "
                "go on with --resume"
            ) from None
        self.reached(joint, stop)

    def _count(self, joint: int, target: float, drive_row: Row, predicted: ExpectedCount) -> None:
        self.forget((joint,))
        purpose = f"joint {joint} brought to {format_position(joint, target)} by count"
        if not self.driver.steps(drive_row, round(predicted.steps), purpose):
            drive = PlannedDrive(pd.Series(dict(drive_row)), purpose, predicted)
            raise DriveInterruptedError(drive, f"joint {joint} met a stop where there should be none")

    def _drive_row(self, joint: int, start: float, stop: float, row: Row) -> dict[str, Any]:
        """A drive of one joint while the others stand at their known or planned positions."""
        moving = int(row["joint"])
        planned = {f"q{other}": row["start" if other == moving else f"q{other}"] for other in JOINTS}
        known = {f"q{other}": place.position for other, place in self.known.items()}
        direction = "+" if stop > start else "-"
        ends = {"joint": joint, "direction": direction, "start": start, "stop": stop}
        return {**row, **planned, **known, f"q{joint}": float("nan"), **ends}

    def _equal(self, joint: int, position: float, other: float) -> bool:
        return abs(position - other) <= RANGE_TOL * self.machine.span(joint)


class _SkippedError(Exception):
    """The operator leaves this traverse out."""


class _QuitError(Exception):
    """The operator ends the capture for now."""


def journal_path(log: str | Path) -> Path:
    """The journal of a log: the file LOG.journal beside it."""
    return Path(f"{log}.journal")


def begin_journal(log: str | Path) -> tuple[Journal, JournalReplay]:
    """Begin the journal of a log; raises InputError if there is such a log or journal already."""
    path, replay = journal_path(log), JournalReplay()
    # An empty one was left by a capture that failed before it began.
    empty = path.exists() and not read_journal(path, replay.apply).count
    if Path(log).exists() and (empty or not path.exists()):
        raise InputError(InputIssue("exists and would be written over; name another log", str(log)))
    return (continue_journal(path, replay.apply) if empty else create_journal(path)), replay


def resume_journal(log: str | Path) -> tuple[Journal, JournalReplay]:
    """Continue the journal of a log; raises InputError if there is none, or it is in use or damaged."""
    replay = JournalReplay()
    return continue_journal(journal_path(log), replay.apply), replay


class Campaign:
    """A plan, the rig it is made with, and its progress.

    Parameters
    ----------
    machine : Machine
        The one that the plan was made for.
    log : str or Path
        Rewritten after every traverse.
    replay : JournalReplay
        Both from `begin_journal` or `resume_journal`.
    predictor : CountPredictor, optional
        Predicts the counts; without it, no reading is doubtful.
    count_predictor : CountPredictor, optional
        By which joints are brought to positions where there is no stop; see `Homing`.
    conditions : dict of str to float, optional
        At the beginning of every session, by the columns of a log, SI; what the operator enters holds until
        the session ends.
    """

    def __init__(
        self,
        plan: Plan,
        machine: Machine,
        log: str | Path,
        journal: Journal,
        replay: JournalReplay,
        rig: Rig,
        operator: Operator,
        predictor: CountPredictor | None = None,
        count_predictor: CountPredictor | None = None,
        drive_limits: DriveLimits | None = None,
        conditions: Mapping[str, float] | None = None,
    ) -> None:
        self.plan = plan
        self.machine = machine
        self.log = log
        self.replay = replay
        self.operator = operator
        self.driver = Driver(rig, journal, replay, operator, predictor, drive_limits or DriveLimits())
        self.homing = Homing(machine, self.driver, self._bring_by_hand, count_predictor)
        self.conditions = conditions or {}
        self.setting: RigSetting | None = None
        self._rows: list[dict[str, Any]] = [
            {str(name): value for name, value in row.items()} for row in plan.rows().to_dict("records")
        ]

    def run(self) -> bool:
        """Make every traverse of the plan that is not made yet; whether all are made or left out.

        Raises
        ------
        InputError
            If the journal belongs to another plan or cannot be written, or the controller or the detector
            fails; what was acknowledged is in the log all the same.
        """
        self._open()
        try:
            self._make_traverses()
            complete = True
        except _QuitError:
            complete = False
        except BaseException:
            # The reason why the capture ended matters more than a failure to write the log.
            with suppress(InputError):
                self._save()
            raise
        self._save()
        return complete

    def _open(self) -> None:
        """Record the plan and the machine, or check them in a journal that is continued."""
        if incomplete := self.driver.journal.recorded.incomplete:
            self.operator.show(f"the journal ended within a record; its {incomplete} bytes are left out")
        hashes = {"plan": hash_plan(self.plan), "machine": self.machine.sha256}
        if self.replay.begin_event is None:
            code_version = {"version": __version__, "controller": self.driver.rig.controller.version()}
            self.driver.write({"event": "begun", "name": self.plan.name, **code_version, **hashes})
        for key, sha256 in hashes.items():
            if self.replay.begin_event is not None and self.replay.begin_event[key] != sha256:
                message = f"was begun with another {key}; go on with the same one, or name another log"
                raise InputError(InputIssue(message, str(self.driver.journal.path)))
        if self.replay.drives or self.replay.skipped:
            read_journal(self.driver.journal.path, self._check_event)

    def _check_event(self, event: Event) -> None:
        """Raise ImpossibleEventError for an event that does not fit the plan or the machine."""
        number, total = event.get("planned"), len(self._rows)
        if number is not None and number >= total:
            raise ImpossibleEventError(f"the plan has only {total} traverses, numbered from 0")
        if event["event"] != "drive":
            return
        row = event["row"]
        for joint in JOINTS:
            names = ("start", "stop") if joint == row["joint"] else (f"q{joint}",)
            (low, high), slack = self.machine.ranges[joint], RANGE_TOL * self.machine.span(joint)
            for name in names:
                if not low - slack <= row[name] <= high + slack:
                    raise ImpossibleEventError(f"{name} of drive is outside of the range of joint {joint}")
        if row["session"] not in (session.label for session in self.plan.sessions):
            raise ImpossibleEventError(f"the plan has no session {row['session']}")
        planned = None if number is None else self._rows[number]
        for name in ("session", "joint", "direction", "start", "stop"):
            if planned is not None and planned[name] != row[name]:
                raise ImpossibleEventError(f"{name} of traverse {number} is {planned[name]} in the plan")

    def _make_traverses(self) -> None:
        session = ""
        for number, row in enumerate(self._rows):
            if number in self.replay.finished:
                continue
            try:
                if row["session"] != session:
                    session = str(row["session"])
                    self.homing.forget()
                    self._note_conditions(self.conditions)
                    self._handle_reply(self.operator.begin_session(session))
                self._make(row, number, f"{number + 1} of {len(self._rows):,}: {row['sweep']}")
            except _SkippedError:
                self.driver.write({"event": "skipped", "planned": number})

    def _make(self, row: Row, number: int, title: str) -> None:
        """Repeat one traverse until the operator keeps the reading."""
        repeat = True
        while repeat:
            try:
                self.homing.bring(row, self._set_up(row))
                repeat = self._measure(row, number, title)
            except DriveInterruptedError as interrupted:
                self._save()
                self._handle_reply(self.operator.handle_failure(interrupted.drive, interrupted.reason))

    def _measure(self, row: Row, number: int, title: str) -> bool:
        """Make one traverse; whether the operator wants it repeated."""
        joint = int(row["joint"])
        self.homing.forget((joint,))
        drive, steps = self.driver.traverse(row, number, title)
        self.homing.reached(joint, float(row["stop"]))
        self._save()
        count = steps - row["check_every"] / 2 if row["check_every"] > 1 else steps
        step_size = abs(row["stop"] - row["start"]) / count
        reply = self.operator.review(
            TraverseReading(drive, steps, step_size, drive.expected.deviation(count))
        )
        repeat = reply.choice is OperatorChoice.REPEAT
        if repeat or reply.choice is OperatorChoice.SKIP:
            why = "doubted, and made again" if repeat else "doubted"
            self.driver.write({"event": "excluded", "drive": len(self.replay.drives) - 1, "why": why})
        self._handle_reply(reply)
        return repeat

    def _set_up(self, row: Row) -> RigSetting:
        wanted = self._required_setting(row)
        if wanted != self.setting:
            self._handle_reply(self.operator.set_up(wanted, self.setting))
            before = self.setting.stops if self.setting else ()
            self.homing.forget(tuple(joint for joint, _, _ in set(before) ^ set(wanted.stops)))
            self.setting = wanted
        return wanted

    def _required_setting(self, row: Row) -> RigSetting:
        joint = int(row["joint"])
        low, high = sorted((float(row["start"]), float(row["stop"])))
        lowest, highest = self.machine.ranges[joint]
        slack = RANGE_TOL * self.machine.span(joint)
        whole = abs(low - lowest) <= slack and abs(high - highest) <= slack
        return RigSetting(float(row["theta"]), float(row["psi"]), () if whole else ((joint, low, high),))

    def _bring_by_hand(self, joint: int, position: float) -> OperatorReply:
        reply = self.operator.bring_joint(joint, position)
        self._handle_reply(reply)
        return reply

    def _handle_reply(self, reply: OperatorReply) -> None:
        """Record the operator's note with the last drive, and follow their decision."""
        drive = len(self.replay.drives) - 1
        if reply.note and drive < 0:
            self.operator.show("the note is not kept: there is no drive yet that it could stand with")
        elif reply.note:
            self.driver.write({"event": "noted", "drive": drive, "text": reply.note})
        self._note_conditions({**self.replay.conditions, **reply.conditions})
        if reply.choice is OperatorChoice.QUIT:
            raise _QuitError
        if reply.choice is OperatorChoice.SKIP:
            raise _SkippedError

    def _note_conditions(self, values: Mapping[str, float]) -> None:
        if dict(values) != dict(self.replay.conditions):
            self.driver.write({"event": "conditions", "values": dict(values)})

    def _save(self) -> None:
        rows = self.replay.rows()
        if len(rows):
            content = format_csv(rows, self.machine)
            sha256 = hashlib.sha256(content).hexdigest()
            # Recorded first, so that the log is recognized as the capture's own after a crash.
            edited = self._keep_edited()
            if sha256 not in self.replay.log_hashes[-1:]:
                self.driver.write({"event": "writing", "sha256": sha256})
            write_atomically(self.log, content)
            if edited:
                self.operator.show(f"{self.log} was changed by others; their file is kept as {edited}")

    def _keep_edited(self) -> Path | None:
        """Rename a log that this capture did not write; its new name, or None where there is none."""
        log = Path(os.path.realpath(self.log))  # a link stays where it is
        if not log.exists() or hashlib.sha256(log.read_bytes()).hexdigest() in self.replay.log_hashes:
            return None
        copies = (Path(f"{log}.edited-{number}") for number in itertools.count(1))
        edited = next(copy for copy in copies if not copy.exists())
        log.rename(edited)
        return edited


def hash_plan(plan: Plan) -> str:
    """A hash of the traverses of a plan in their order, without its name and simulation settings."""
    rows: Any = plan.rows().drop(columns=["sweep", "visit"])
    return hashlib.sha256(pd.DataFrame(rows).to_csv(index=False).encode("utf-8")).hexdigest()
