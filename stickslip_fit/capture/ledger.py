"""What a journal's events amount to: which drives were made, what became of them, and the log of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import pandas as pd

from stickslip_fit.logs.columns import CONDITIONS

POSITIONS = ("q1", "q2", "q3", "theta", "psi", "start", "stop")
COLUMNS = (
    *("session", "time", "joint", "direction", "steps", *POSITIONS, "check_every", "status"),
    *(*CONDITIONS, "note"),
)
BROKEN_OFF = "the capture ended in mid-traverse"


@dataclass(frozen=True)
class Driven:
    """One drive: a traverse of the plan, or one that brought a joint into place.

    Attributes
    ----------
    row : dict
        session, time, joint, direction, positions (SI, None for the moving joint's own), check_every, and the
        conditions under which it began.
    planned : int or None
        Which traverse of the plan; None for one that only brought a joint into place.
    purpose : str
        What that was for.
    steps : int
        Commanded so far.
    status : str
        As in a log; ``interrupted`` until it has ended well.
    notes : tuple of str
    """

    row: Mapping[str, Any]
    planned: int | None
    purpose: str = ""
    steps: int = 0
    status: str = "interrupted"
    notes: tuple[str, ...] = (BROKEN_OFF,)


class Ledger:
    """The drives of a journal, kept up to date event by event."""

    def __init__(self) -> None:
        self.begun: Mapping[str, Any] | None = None
        self.drives: list[Driven] = []
        self.skipped: set[int] = set()
        self.conditions: Mapping[str, float] = {}
        self.written: tuple[str, ...] = ()  # hashes of the log as it was written last, and before that

    def take(self, event: Mapping[str, Any]) -> None:
        """Enter one more event."""
        match event["event"]:
            case "begun":
                self.begun = event
            case "drive":
                row = {**self.conditions, **event["row"]}
                self.drives.append(Driven(row, event["planned"], event["purpose"]))
            case "conditions":
                self.conditions = event["values"]
            case "writing":
                self.written = (*self.written[-1:], event["sha256"])
            case "commanded":
                self.drives[-1] = replace(self.drives[-1], steps=event["steps"])
            case "ended":
                self.drives[-1] = _ended(self.drives[-1], event)
            case "excluded":
                self._change(event["drive"], event["why"], status="excluded")
            case "noted":
                self._change(event["drive"], event["text"])
            case "skipped":
                self.skipped.add(event["planned"])

    @property
    def done(self) -> set[int]:
        """Traverses of the plan that need not be made any more."""
        made = {each.planned for each in self.drives if each.planned is not None and each.status == "ok"}
        return made | self.skipped

    @property
    def last_time(self) -> datetime | None:
        """When the latest drive began."""
        return datetime.fromisoformat(self.drives[-1].row["time"]) if self.drives else None

    def rows(self) -> pd.DataFrame:
        """The log's rows, in order of time; a drive that never made a step is none."""
        records = [_record(each) for each in self.drives if each.steps > 0]
        own = dict.fromkeys(name for each in records for name in each if name not in COLUMNS)
        rows = pd.DataFrame(records, columns=[*COLUMNS, *own])
        rows["time"] = pd.to_datetime(rows["time"], utc=True)
        numbers = [*POSITIONS, *CONDITIONS, *own]
        return rows.astype(dict.fromkeys(numbers, float) | {"joint": "int64", "steps": "int64"})

    def _change(self, drive: int, note: str, **changes: Any) -> None:
        before = self.drives[drive]
        self.drives[drive] = replace(before, notes=(*before.notes, note), **changes)


def _ended(drive: Driven, event: Mapping[str, Any]) -> Driven:
    notes = tuple(filter(None, (drive.purpose, event["why"])))
    brings = drive.planned is None and event["status"] == "ok"
    return replace(drive, steps=event["steps"], status="excluded" if brings else event["status"], notes=notes)


def _record(drive: Driven) -> dict[str, Any]:
    """A row of the log; a drive that wasn't ended by its stop is known to the step."""
    heard = drive.steps % drive.row["check_every"] == 0 and drive.status != "interrupted"
    said = {name: drive.row.get(name, math.nan) for name in CONDITIONS}
    found = {
        "steps": drive.steps,
        "status": drive.status,
        "check_every": drive.row["check_every"] if heard else 1,
        "note": "; ".join(drive.notes),
    }
    return {**said, **drive.row, **found}
