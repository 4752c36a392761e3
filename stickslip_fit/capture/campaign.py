"""Campaign: goes through a plan at a rig, from session to session. Start reading here.

For each traverse the operator sets the base, `Homing` brings the joints into place and `traverse`
drives and records it. A joint's position is known only after it has reached a stop; other positions are
set by hand or by count. The log is written from the journal, so that an interrupted campaign can be
resumed.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd

from stickslip_fit import __version__
from stickslip_fit._io import write_atomically
from stickslip_fit.capture.journal import (
    Journal,
    JournalReplay,
    continue_journal,
    create_journal,
    read_journal,
)
from stickslip_fit.capture.operator import (
    CountPredictor,
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

BACK_OFF_STEPS = (
    200  # steps away from a stop that a joint may be standing at, so that the ear hears it run free
)


class Homing:
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
        by_hand: Callable[[int, float], OperatorReply],
        counting: CountPredictor | None,
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

    def bring(self, row: Row, setting: RigSetting) -> None:
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

    def _place(self, joint: int, target: float, row: Row, setting: RigSetting) -> None:
        if joint in self.known and self._alike(joint, self.known[joint], target):
            return
        low, high = self.stops(joint, setting)
        for stop in (low, high):
            if self._alike(joint, stop, target):
                self._home(joint, stop, row, setting)
                return
        nearest = low if target - low < high - target else high
        drive_target = self._way(joint, nearest, target, row)
        predicted = predict_count(self.counting, pd.Series(drive_target))
        if not predicted.known:
            self.by_hand(joint, target)
        else:
            self._place(joint, nearest, row, setting)
            self._count(joint, target, drive_target, round(predicted.steps))
        self.known[joint] = target

    def stops(self, joint: int, setting: RigSetting) -> tuple[float, float]:
        """Where a joint is held: by its own stops, or by those that a person has set."""
        own = {each: (low, high) for each, low, high in setting.stops}
        return own.get(joint, self.machine.ranges[joint])

    def _home(self, joint: int, stop: float, row: Row, setting: RigSetting) -> None:
        low, high = self.stops(joint, setting)
        other = high if stop == low else low
        begin = self.known.get(joint, other)
        there = format_position(joint, stop)
        if joint not in self.known:
            away = self._way(joint, stop, other, row)
            self.driver.steps(away, BACK_OFF_STEPS, f"joint {joint} moved off a stop it might stand at")
        self.forget((joint,))
        self.driver.to_stop(
            self._way(joint, begin, stop, row), f"joint {joint} brought to its stop at {there}"
        )
        self.known[joint] = stop

    def _count(self, joint: int, target: float, drive_target: Row, steps: int) -> None:
        self.forget((joint,))
        purpose = f"joint {joint} brought to {format_position(joint, target)} by count"
        if not self.driver.steps(drive_target, steps, purpose):
            work = PlannedDrive(
                pd.Series(dict(drive_target)), purpose, predict_count(self.counting, pd.Series(drive_target))
            )
            raise DriveInterruptedError(work, f"joint {joint} met a stop where there should be none")

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
        return abs(position - other) <= RANGE_TOL * self.machine.span(joint)


class _SkippedError(Exception):
    """The person leaves this traverse out."""


class _QuitError(Exception):
    """The person has had enough for now."""


def journal_path(log: str | Path) -> Path:
    """Where the journal of a log is kept: beside it.

    Examples
    --------
    >>> journal_path("data/monday.csv").name
    'monday.csv.journal'
    """
    return Path(f"{log}.journal")


def begin_journal(log: str | Path) -> tuple[Journal, JournalReplay]:
    """Begin the journal of a log to be captured; it holds nothing yet.

    Raises
    ------
    InputError
        If there is such a log or journal already.
    """
    path, replay = journal_path(log), JournalReplay()
    # One that holds nothing was left by a capture that failed before it began.
    empty = path.exists() and not read_journal(path, replay.take).count
    if Path(log).exists() and (empty or not path.exists()):
        raise InputError(InputIssue("exists and would be written over; name another log", str(log)))
    return (continue_journal(path, replay.take) if empty else create_journal(path)), replay


def resume_journal(log: str | Path) -> tuple[Journal, JournalReplay]:
    """Go on with the journal of a log, wherever it ended; and what it holds.

    Raises
    ------
    InputError
        If there is none, or it is in use or damaged.
    """
    replay = JournalReplay()
    return continue_journal(journal_path(log), replay.take), replay


class Campaign:
    """A plan, the rig that it is made with, and how far it has got.

    Parameters
    ----------
    plan : Plan
    machine : Machine
        The one that the plan was made for.
    log : str or Path
        Rewritten, whole, after every traverse.
    journal : Journal
    ledger : Ledger
        Both from `begin` or `resume`.
    rig : Rig
    person : Person
    predictor : Predictor, optional
        Says what counts should be; without it, no reading is doubted.
    counting : Predictor, optional
        By which joints are brought to positions where there is no stop; see `Placing`.
    safety : Safety
    conditions : dict of str to float, optional
        At the beginning of every session, by the columns of a log, SI; what the person says of one session
        does not hold in the next.
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
        counting: CountPredictor | None = None,
        safety: DriveLimits | None = None,
        conditions: Mapping[str, float] | None = None,
    ) -> None:
        self.plan = plan
        self.machine = machine
        self.log = log
        self.ledger = replay
        self.operator = operator
        self.driver = Driver(rig, journal, replay, operator, predictor, safety or DriveLimits())
        self.placing = Homing(machine, self.driver, self._bring_by_hand, counting)
        self.conditions = conditions or {}
        self.setting: RigSetting | None = None

    def run(self) -> bool:
        """Make every traverse of the plan that is not made yet.

        Returns
        -------
        bool
            Whether all are made or left out; False where the person wanted to stop before.

        Raises
        ------
        InputError
            If the journal belongs to another plan or cannot be written, or the controller or the ear fails;
            what was acknowledged is in the log all the same.
        """
        self._open()
        try:
            self._go_through()
            complete = True
        except _QuitError:
            complete = False
        except BaseException:
            # Why the capture ended says more than why the log cannot be written, too.
            with suppress(InputError):
                self._save()
            raise
        self._save()
        return complete

    def _open(self) -> None:
        """Write down what is captured; of a journal that is gone on with, check that it is the same."""
        if lost := self.driver.journal.recorded.lost:
            self.operator.tell(f"the journal ended within a record; its {lost} bytes said nothing yet")
        same = {"plan": hash_plan(self.plan), "machine": self.machine.sha256}
        if self.ledger.begun is None:
            code_version = {"version": __version__, "controller": self.driver.rig.controller.version()}
            self.driver.write({"event": "begun", "name": self.plan.name, **code_version, **same})
        for key, found in same.items():
            if self.ledger.begun is not None and self.ledger.begun[key] != found:
                raise InputError(
                    InputIssue(
                        f"was begun with another {key}; go on with the same one, or name another log",
                        str(self.driver.journal.path),
                    )
                )
        self._keep_edited()

    def _go_through(self) -> None:
        rows, session, total = self.plan.rows(), "", self.plan.traverses_per_session * len(self.plan.sessions)
        for number, row in enumerate(rows.to_dict("records")):
            if number in self.ledger.finished:
                continue
            try:
                if row["session"] != session:
                    session = str(row["session"])
                    self.placing.forget()
                    self._note_conditions(self.conditions)
                    self._heed(self.operator.begin_session(session))
                self._make(row, number, f"{number + 1} of {total:,}: {row['sweep']}")
            except _SkippedError:
                self.driver.write({"event": "skipped", "planned": number})

    def _make(self, row: Row, number: int, title: str) -> None:
        """Make one traverse until there is a reading that the person keeps."""
        again = True
        while again:
            try:
                setting = self._set_up(row)
                self.placing.bring(row, setting)
                again = self._measure(row, number, title)
            except DriveInterruptedError as broken:
                self._save()
                self._heed(self.operator.trouble(broken.work, broken.why))

    def _measure(self, row: Row, number: int, title: str) -> bool:
        """Make one traverse; whether the person wants it once more."""
        joint = int(row["joint"])
        self.placing.forget((joint,))
        work, steps = self.driver.traverse(row, number, title)
        self.placing.known[joint] = float(row["stop"])
        self._save()
        counted = steps - row["check_every"] / 2 if row["check_every"] > 1 else steps
        size = abs(row["stop"] - row["start"]) / counted
        answer = self.operator.reading(TraverseReading(work, steps, size, work.expected.departure(counted)))
        again = answer.choice is OperatorChoice.REPEAT
        if again or answer.choice is OperatorChoice.SKIP:
            why = "doubted, and made again" if again else "doubted"
            drive = len(self.ledger.drives) - 1
            self.driver.write({"event": "excluded", "drive": drive, "why": why})
        self._heed(answer)
        return again

    def _set_up(self, row: Row) -> RigSetting:
        wanted = self._wanted(row)
        if wanted != self.setting:
            self._heed(self.operator.set_up(wanted, self.setting))
            before = self.setting.stops if self.setting else ()
            self.placing.forget(tuple(joint for joint, _, _ in set(before) ^ set(wanted.stops)))
            self.setting = wanted
        return wanted

    def _wanted(self, row: Row) -> RigSetting:
        joint = int(row["joint"])
        low, high = sorted((float(row["start"]), float(row["stop"])))
        least, most = self.machine.ranges[joint]
        slack = RANGE_TOL * self.machine.span(joint)
        whole = abs(low - least) <= slack and abs(high - most) <= slack
        return RigSetting(float(row["theta"]), float(row["psi"]), () if whole else ((joint, low, high),))

    def _bring_by_hand(self, joint: int, position: float) -> OperatorReply:
        answer = self.operator.bring(joint, position)
        self._heed(answer)
        return answer

    def _heed(self, answer: OperatorReply) -> None:
        """Keep the person's note with the latest drive, and do what they want."""
        if answer.note:
            drive = len(self.ledger.drives) - 1
            self.driver.write({"event": "noted", "drive": drive, "text": answer.note})
        self._note_conditions({**self.ledger.conditions, **answer.conditions})
        if answer.choice is OperatorChoice.QUIT:
            raise _QuitError
        if answer.choice is OperatorChoice.SKIP:
            raise _SkippedError

    def _note_conditions(self, values: Mapping[str, float]) -> None:
        if dict(values) != dict(self.ledger.conditions):
            self.driver.write({"event": "conditions", "values": dict(values)})

    def _save(self) -> None:
        rows = self.ledger.rows()
        if len(rows):
            content = format_csv(rows)
            sha256 = hashlib.sha256(content).hexdigest()
            # Announced first, so that a log which a crash left behind is known for the capture's own.
            if sha256 not in self.ledger.written[-1:]:
                self.driver.write({"event": "writing", "sha256": sha256})
            write_atomically(self.log, content)

    def _keep_edited(self) -> None:
        """Put a log aside that somebody has changed since it was written here."""
        log = Path(self.log)
        if log.exists() and hashlib.sha256(log.read_bytes()).hexdigest() not in self.ledger.written:
            names = (Path(f"{log}.edited-{number}") for number in itertools.count(1))
            aside = next(name for name in names if not name.exists())
            log.rename(aside)
            self.operator.tell(f"{log} was changed since it was written; what was changed is kept as {aside}")


def hash_plan(plan: Plan) -> str:
    """A hash over the traverses of a plan, in their order; how it is named or simulated is left out."""
    rows: Any = plan.rows().drop(columns=["sweep", "visit"])
    return hashlib.sha256(pd.DataFrame(rows).to_csv(index=False).encode("utf-8")).hexdigest()
