"""Drives as they go into the journal: each announced, followed step by step, and ended in writing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from math import ceil, isfinite
from typing import Any

import pandas as pd

from stickslip_fit.capture.controller import Unplugged
from stickslip_fit.capture.ear import Heard
from stickslip_fit.capture.expected import Expected, Predictor, expected
from stickslip_fit.capture.journal import Event, Journal
from stickslip_fit.capture.ledger import POSITIONS, Ledger
from stickslip_fit.capture.person import Person, Work
from stickslip_fit.capture.traverse import Outcome, Rig, Way, drive_steps, drive_to_stop

Row = Mapping[str, Any]
# Commands between two that are written to outlive a power cut: those take milliseconds, too long for each.
SAFE_EVERY = 100


@dataclass(frozen=True)
class Safety:
    """What protects the manipulator from an ear that hears nothing.

    Attributes
    ----------
    most_steps : int
        For any drive.
    over : float
        Where a count was predicted, no more than that times it.
    slower : float
        A step takes no longer than that times what the plan says.
    spare_seconds : float
        On top of that, for each drive.
    """

    most_steps: int = 60_000
    over: float = 1.25
    slower: float = 4.0
    spare_seconds: float = 30.0

    def way(self, row: Row, predicted: Expected) -> Way:
        """A drive with its limits."""
        every = int(row["check_every"])
        high = predicted.high if isfinite(predicted.high) else predicted.steps
        # The stop is heard a few checks after it is met.
        steps = ceil(self.over * high) + 20 * every if predicted.known else self.most_steps
        steps = min(steps, self.most_steps)
        seconds = self.spare_seconds + self.slower * steps * float(row["step_period"])
        return Way(int(row["joint"]), str(row["direction"]), every, steps, seconds)


class BrokenOffError(Exception):
    """A drive that did not end as it should; it is in the journal."""

    def __init__(self, work: Work, why: str) -> None:
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
    safety : Safety
    """

    def __init__(
        self,
        rig: Rig,
        journal: Journal,
        ledger: Ledger,
        person: Person,
        predictor: Predictor | None,
        safety: Safety,
    ) -> None:
        self.rig = rig
        self.journal = journal
        self.ledger = ledger
        self.person = person
        self.predictor = predictor
        self.safety = safety

    def traverse(self, row: Row, planned: int, title: str) -> tuple[Work, int]:
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
        return work, self._drive(work, planned, "", lambda way, watch: drive_to_stop(self.rig, way, watch))

    def to_stop(self, row: Row, purpose: str) -> None:
        """Run a joint into its stop; raises as `traverse`."""
        self._drive(
            self._work(row, purpose), None, purpose, lambda way, watch: drive_to_stop(self.rig, way, watch)
        )

    def steps(self, row: Row, steps: int, purpose: str) -> bool:
        """Make so many steps; whether no stop was met on the way. Raises as `traverse`."""
        work = self._work(row, purpose)
        made = self._drive(work, None, purpose, lambda way, watch: drive_steps(self.rig, way, steps, watch))
        return made == steps

    def write(self, event: Event) -> None:
        """Write an event so that it outlives a power cut."""
        self.journal.commit(event)
        self.ledger.take(event)

    def _work(self, row: Row, title: str) -> Work:
        series = pd.Series(dict(row))
        return Work(series, title, expected(self.predictor, series))

    def _drive(
        self, work: Work, planned: int | None, purpose: str, drive: Callable[[Way, _Follower], Outcome]
    ) -> int:
        self.person.begins(work)
        way = self.safety.way(work.row, work.expected)
        self.write({"event": "drive", "planned": planned, "purpose": purpose, "row": self._written(work.row)})
        outcome = drive(way, _Follower(self, work))
        self.write(
            {
                "event": "ended", "steps": outcome.steps, "pushed": outcome.pushed,
                "status": outcome.status, "why": outcome.why,
            }
        )  # fmt: skip
        if outcome.unplugged:
            raise Unplugged(f"{outcome.why}; see to the controller, then go on with --resume")
        if outcome.status != "ok":
            raise BrokenOffError(work, outcome.why)
        return outcome.steps

    def _written(self, row: pd.Series) -> dict[str, Any]:
        places = {name: None if pd.isna(row[name]) else float(row[name]) for name in POSITIONS}
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


class _Follower:
    """Writes a drive's commands down before they are given, and shows how it goes."""

    def __init__(self, driver: Driver, work: Work) -> None:
        self.driver = driver
        self.work = work
        self.commands = 0

    def commanding(self, steps: int) -> None:
        event = {"event": "commanded", "steps": steps}
        self.commands += 1
        if self.commands % SAFE_EVERY:
            self.driver.journal.append(event)
        else:
            self.driver.journal.commit(event)
        self.driver.ledger.take(event)

    def heard(self, steps: int, heard: Heard) -> None:
        self.driver.person.progress(self.work, steps, heard)

    def stop_wanted(self) -> bool:
        return self.driver.person.stop_wanted()
