"""The journal of a drive: every burst before it is commanded, so that the position survives a crash.

A burst is appended, which survives the program; a snapshot of the position and its uncertainty follows
whenever the joints come to rest, and every so many bursts. Only these are written so that they survive a
power cut, which takes milliseconds: while the joints move, it may lose the bursts since the last snapshot.
Of the last burst of a journal nobody knows whether it was made, unless something follows it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from stickslip_fit import __version__
from stickslip_fit.capture.events import ImpossibleEventError
from stickslip_fit.capture.journal import Journal, continue_journal, create_journal, read_journal
from stickslip_fit.drive.diffusion import Burst
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.moves import CalibratedArm, DriveReckoning
from stickslip_fit.moves.incremental import GROUPS
from stickslip_fit.units import JOINTS

SNAPSHOT_INTERVAL = 500  # bursts: 5 s of uninterrupted motion
MAX_STEPS = 10**5
_KEYS = {
    "begun": {"version", "time", "law", "session", "snapshot"},
    "burst": {"joint", "steps", "seconds"},
    "rest": {"seconds", "steps", "snapshot"},
}


class DriveReplay:
    """What a journal says of a drive: the last snapshot, and the bursts since."""

    def __init__(self) -> None:
        self.law = ""
        self.session = ""
        self.began = datetime.now(UTC)
        self.seconds = 0.0
        self.steps = [0, 0, 0]
        self.snapshot: Mapping[str, Any] = {}
        self.bursts: list[tuple[Burst, float]] = []

    def apply(self, event: Mapping[str, Any]) -> None:
        """Apply one more event; raises ImpossibleEventError for one that no drive writes here."""
        content = {key: value for key, value in event.items() if key not in ("event", "number")}
        name = event.get("event")
        if name not in _KEYS or content.keys() != _KEYS[name]:
            raise ImpossibleEventError(f"{name!r} with {', '.join(content)} is no event of a drive")
        if (name == "begun") == bool(self.law):
            raise ImpossibleEventError(f"{name} cannot stand here")
        if name == "begun":
            self.law, self.session = str(content["law"]), str(content["session"])
            self.began = _time(content["time"])
        else:
            self.seconds = _number(content["seconds"], "seconds")
        if name == "burst":
            burst = _burst(content)
            self.bursts.append((burst, self.seconds))
            self.steps[burst.joint - 1] += burst.signed_steps
        else:
            self.snapshot, self.bursts = _check_snapshot(content["snapshot"]), []
        if name == "rest" and content["steps"] != self.steps:
            raise ImpossibleEventError(f"{content['steps']} steps, and the bursts are {self.steps}")

    def restore(self, arm: CalibratedArm) -> DriveReckoning:
        """The drive as it was; the last burst may or may not have been made, if nothing follows it."""
        drive = DriveReckoning(arm, self.snapshot["q"])
        drive.restore(self.snapshot)
        moved = 0.0
        for burst, seconds in self.bursts:
            moved = drive.advance(burst.joint, burst.direction, burst.steps, seconds)
        if self.bursts:
            drive.doubt(self.bursts[-1][0].joint, moved)
        return drive


@dataclass(frozen=True)
class Departure:
    """Steps of a joint in one direction since it left a stop, all others at rest; the first at `seconds`."""

    direction: str
    steps: int
    seconds: float


class BurstRecord:
    """Writes a drive into a journal, if there is one.

    Parameters
    ----------
    journal : Journal, optional
    seconds : float
        Of the drive that are over already.
    steps : sequence of int, optional
        That its joints have made already, see below.

    Attributes
    ----------
    departures : dict of int to Departure
        Of the joints whose steps since a stop are a count.
    steps : list of int
        Of each joint since the drive began, those in direction - taken off.
    """

    def __init__(
        self, journal: Journal | None = None, seconds: float = 0.0, steps: Sequence[int] = (0, 0, 0)
    ) -> None:
        self.journal = journal
        self.seconds = seconds
        self.departures: dict[int, Departure] = {}
        self.steps = list(steps)
        self._bursts = 0  # since the last snapshot

    def close(self) -> None:
        """Close the journal."""
        if self.journal is not None:
            self.journal.close()

    def begin(self, drive: DriveReckoning) -> None:
        """A new drive begins here."""
        if self.journal is not None:
            arm, time = drive.arm, datetime.now(UTC).isoformat(timespec="milliseconds")
            content = {"version": __version__, "time": time, "law": hash_law(arm), "session": arm.session}
            self.journal.commit({"event": "begun", **content, "snapshot": drive.snapshot()})

    def burst(self, burst: Burst, drive: DriveReckoning, seconds: float) -> None:
        """A burst that is about to be commanded; all before it have been made."""
        if self._bursts >= SNAPSHOT_INTERVAL:
            self.rest(drive, seconds)
        self._follow(burst, drive, seconds)
        if self.journal is None:
            return
        event = {"event": "burst", "joint": burst.joint, "steps": burst.signed_steps, "seconds": seconds}
        self.journal.append(event)
        self._bursts += 1

    def _follow(self, burst: Burst, drive: DriveReckoning, seconds: float) -> None:
        """Count the steps, and those since a stop until the joint turns or another one moves."""
        joint, before = burst.joint, self.departures.get(burst.joint)
        self.steps[joint - 1] += burst.signed_steps
        self.departures.clear()
        if drive.variance(joint) == 0.0 and drive.q[joint - 1] in drive.arm.machine.ranges[joint]:
            self.departures[joint] = Departure(burst.direction, burst.steps, seconds)
        elif before is not None and before.direction == burst.direction:
            self.departures[joint] = replace(before, steps=before.steps + burst.steps)

    def rest(self, drive: DriveReckoning, seconds: float) -> None:
        """All bursts have been made, or their doubt is in the drive's uncertainty."""
        if self.journal is not None:
            content = {"seconds": seconds, "steps": self.steps, "snapshot": drive.snapshot()}
            self.journal.commit({"event": "rest", **content})
            self._bursts = 0


def begin_record(path: Path | None, drive: DriveReckoning) -> BurstRecord:
    """Begin the journal of a drive; raises InputError where there is one already, or it cannot be written."""
    journal = None
    if path is not None:
        replay = DriveReplay()
        # An empty one was left by a drive that failed before it began.
        empty = path.exists() and not read_journal(path, replay.apply).count
        journal = continue_journal(path, replay.apply) if empty else create_journal(path)
    record = BurstRecord(journal)
    record.begin(drive)
    return record


def resume_record(path: Path, arm: CalibratedArm) -> tuple[BurstRecord, DriveReckoning]:
    """Continue the journal of a drive; the time in between counts as time of the drive.

    Raises
    ------
    InputError
        If there is none, it is in use, damaged or empty, or was begun with another law.
    """
    replay = DriveReplay()
    journal = continue_journal(path, replay.apply)
    if not replay.law:
        journal.close()
        raise InputError(InputIssue("is empty; delete it, and begin without --resume", str(path)))
    if (replay.law, replay.session) != (hash_law(arm), arm.session):
        journal.close()
        message = f"was begun with another law or session (session {replay.session}); go on with the same one"
        raise InputError(InputIssue(message, str(path)))
    drive = replay.restore(arm)
    elapsed = (datetime.now(UTC) - replay.began).total_seconds()
    record = BurstRecord(journal, max(replay.seconds, elapsed), replay.steps)
    record.rest(drive, record.seconds)
    return record, drive


def hash_law(arm: CalibratedArm) -> str:
    """A hash of a calibration: the parameters of its session, their covariance, and the base."""
    digest = hashlib.sha256(repr((arm.machine.sha256, arm.session, arm.theta, arm.psi)).encode())
    for joint, direction in GROUPS:
        fit = arm.result.joints.get(joint)
        if fit is not None:
            own = ((fit.groups["session"] == arm.session) & (fit.groups["direction"] == direction)).to_numpy()
            digest.update(fit.values[own].tobytes() + fit.covariance[own].tobytes())
    return digest.hexdigest()


def _burst(content: Mapping[str, Any]) -> Burst:
    joint, steps = content["joint"], content["steps"]
    whole = isinstance(steps, int) and not isinstance(steps, bool)
    if joint not in JOINTS or not whole or not 0 < abs(steps) <= MAX_STEPS:
        raise ImpossibleEventError(f"a burst of {steps!r} steps of joint {joint!r}")
    return Burst(joint, "+" if steps > 0 else "-", abs(steps))


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ImpossibleEventError(f"{name} is {value!r}, not a number")
    return float(value)


def _time(value: Any) -> datetime:
    try:
        time = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        time = None
    if time is None or time.tzinfo is None:
        raise ImpossibleEventError(f"the time is {value!r}, no date and time with its time zone")
    return time


def _check_snapshot(snapshot: Any) -> Mapping[str, Any]:
    """A snapshot as `DriveReckoning.snapshot` writes it."""
    if not isinstance(snapshot, dict) or snapshot.keys() != {"q", "variance", "doubt", "history", "sums"}:
        raise ImpossibleEventError("a snapshot that lacks something")
    for name in ("q", "variance", "doubt"):
        values = snapshot[name]
        if not isinstance(values, list) or len(values) != len(JOINTS):
            raise ImpossibleEventError(f"{name} is {values!r}")
        for value in values:
            _number(value, name)
    groups = {f"{joint}{direction}" for joint, direction in GROUPS}
    if not isinstance(snapshot["sums"], dict) or not snapshot["sums"].keys() <= groups:
        raise ImpossibleEventError("sums of no joint and direction")
    for own in snapshot["sums"].values():
        for value in own:
            _number(value, "a sum")
    return snapshot
