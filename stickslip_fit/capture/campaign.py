"""A plan gone through at the rig: every traverse made, written down, and put into the log."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd

from stickslip_fit import __version__
from stickslip_fit.capture.driver import BrokenOffError, Driver, Row, Safety
from stickslip_fit.capture.expected import Predictor
from stickslip_fit.capture.journal import Journal, continue_journal, create_journal, read_journal
from stickslip_fit.capture.ledger import Ledger
from stickslip_fit.capture.person import Answer, Choice, Person, Reading, Setting
from stickslip_fit.capture.placing import Placing
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import write_atomically
from stickslip_fit.logs.plan import Plan
from stickslip_fit.logs.traverse import ROUNDING
from stickslip_fit.logs.write import to_csv
from stickslip_fit.machine import Machine


class _SkippedError(Exception):
    """The person leaves this traverse out."""


class _QuitError(Exception):
    """The person has had enough for now."""


def journal_of(log: str | Path) -> Path:
    """Where the journal of a log is kept: beside it.

    Examples
    --------
    >>> journal_of("data/monday.csv").name
    'monday.csv.journal'
    """
    return Path(f"{log}.journal")


def begin(log: str | Path) -> tuple[Journal, Ledger]:
    """Begin the journal of a log to be captured; it holds nothing yet.

    Raises
    ------
    InputError
        If there is such a log or journal already.
    """
    path, ledger = journal_of(log), Ledger()
    # One that holds nothing was left by a capture that failed before it began.
    empty = path.exists() and not read_journal(path, ledger.take).count
    if Path(log).exists() and (empty or not path.exists()):
        raise InputError(Problem("exists and would be written over; name another log", str(log)))
    return (continue_journal(path, ledger.take) if empty else create_journal(path)), ledger


def resume(log: str | Path) -> tuple[Journal, Ledger]:
    """Go on with the journal of a log, wherever it ended; and what it holds.

    Raises
    ------
    InputError
        If there is none, or it is in use or damaged.
    """
    ledger = Ledger()
    return continue_journal(journal_of(log), ledger.take), ledger


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
        ledger: Ledger,
        rig: Rig,
        person: Person,
        predictor: Predictor | None = None,
        counting: Predictor | None = None,
        safety: Safety | None = None,
        conditions: Mapping[str, float] | None = None,
    ) -> None:
        self.plan = plan
        self.machine = machine
        self.log = log
        self.ledger = ledger
        self.person = person
        self.driver = Driver(rig, journal, ledger, person, predictor, safety or Safety())
        self.placing = Placing(machine, self.driver, self._bring_by_hand, counting)
        self.conditions = conditions or {}
        self.setting: Setting | None = None

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
            self.person.tell(f"the journal ended within a record; its {lost} bytes said nothing yet")
        same = {"plan": plan_hash(self.plan), "machine": self.machine.sha256}
        if self.ledger.begun is None:
            made_by = {"version": __version__, "controller": self.driver.rig.controller.version()}
            self.driver.write({"event": "begun", "name": self.plan.name, **made_by, **same})
        for key, found in same.items():
            if self.ledger.begun is not None and self.ledger.begun[key] != found:
                raise InputError(
                    Problem(
                        f"was begun with another {key}; go on with the same one, or name another log",
                        str(self.driver.journal.path),
                    )
                )
        self._keep_edited()

    def _go_through(self) -> None:
        rows, session, total = self.plan.rows(), "", self.plan.traverses_per_session * len(self.plan.sessions)
        for number, row in enumerate(rows.to_dict("records")):
            if number in self.ledger.done:
                continue
            try:
                if row["session"] != session:
                    session = str(row["session"])
                    self.placing.forget()
                    self._note_conditions(self.conditions)
                    self._heed(self.person.begin_session(session))
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
            except BrokenOffError as broken:
                self._save()
                self._heed(self.person.trouble(broken.work, broken.why))

    def _measure(self, row: Row, number: int, title: str) -> bool:
        """Make one traverse; whether the person wants it once more."""
        joint = int(row["joint"])
        self.placing.forget((joint,))
        work, steps = self.driver.traverse(row, number, title)
        self.placing.known[joint] = float(row["stop"])
        self._save()
        counted = steps - row["check_every"] / 2 if row["check_every"] > 1 else steps
        size = abs(row["stop"] - row["start"]) / counted
        answer = self.person.reading(Reading(work, steps, size, work.expected.departure(counted)))
        again = answer.choice is Choice.REPEAT
        if again or answer.choice is Choice.SKIP:
            why = "doubted, and made again" if again else "doubted"
            drive = len(self.ledger.drives) - 1
            self.driver.write({"event": "excluded", "drive": drive, "why": why})
        self._heed(answer)
        return again

    def _set_up(self, row: Row) -> Setting:
        wanted = self._wanted(row)
        if wanted != self.setting:
            self._heed(self.person.set_up(wanted, self.setting))
            before = self.setting.stops if self.setting else ()
            self.placing.forget(tuple(joint for joint, _, _ in set(before) ^ set(wanted.stops)))
            self.setting = wanted
        return wanted

    def _wanted(self, row: Row) -> Setting:
        joint = int(row["joint"])
        low, high = sorted((float(row["start"]), float(row["stop"])))
        least, most = self.machine.ranges[joint]
        slack = ROUNDING * self.machine.span(joint)
        whole = abs(low - least) <= slack and abs(high - most) <= slack
        return Setting(float(row["theta"]), float(row["psi"]), () if whole else ((joint, low, high),))

    def _bring_by_hand(self, joint: int, position: float) -> Answer:
        answer = self.person.bring(joint, position)
        self._heed(answer)
        return answer

    def _heed(self, answer: Answer) -> None:
        """Keep the person's note with the latest drive, and do what they want."""
        if answer.note:
            drive = len(self.ledger.drives) - 1
            self.driver.write({"event": "noted", "drive": drive, "text": answer.note})
        self._note_conditions({**self.ledger.conditions, **answer.conditions})
        if answer.choice is Choice.QUIT:
            raise _QuitError
        if answer.choice is Choice.SKIP:
            raise _SkippedError

    def _note_conditions(self, values: Mapping[str, float]) -> None:
        if dict(values) != dict(self.ledger.conditions):
            self.driver.write({"event": "conditions", "values": dict(values)})

    def _save(self) -> None:
        rows = self.ledger.rows()
        if len(rows):
            content = to_csv(rows)
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
            self.person.tell(f"{log} was changed since it was written; what was changed is kept as {aside}")


def plan_hash(plan: Plan) -> str:
    """A hash over the traverses of a plan, in their order; how it is named or simulated is left out."""
    rows: Any = plan.rows().drop(columns=["sweep", "visit"])
    return hashlib.sha256(pd.DataFrame(rows).to_csv(index=False).encode("utf-8")).hexdigest()
