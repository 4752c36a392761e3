"""What order and history need of every row: its session, time, joint and steps, over all files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
import pyarrow as pa

from stickslip_fit.logs.cells import Cells, by_file, place_of
from stickslip_fit.logs.faults import Message
from stickslip_fit.logs.history import steps_before
from stickslip_fit.logs.parse import Bools, Ints, labelled
from stickslip_fit.logs.together import together

_NO_JOINT = "is no joint; write 1 or 2 (rotary) or 3 (prismatic)"
_NO_COUNT = "is no positive integer; write the steps driven, such as 12540"


@dataclass(frozen=True)
class Identity:
    """Rows of all files, one file after the other.

    Attributes
    ----------
    labels : tuple of str
        All sessions, in alphabetical order.
    session : array of int, shape (n,)
        Place of each row's session among the labels.
    time : array of int, shape (n,)
        Nanoseconds since 1970.
    zoned : array of bool, shape (n,)
        Whether the time came with a zone (and is UTC).
    joint, steps : array of int, shape (n,)
        0 where the cell is faulty.
    valid : array of bool, shape (n,)
        Whether session, time and joint can be relied on.
    """

    labels: tuple[str, ...]
    session: Ints
    time: Ints
    zoned: Bools
    joint: Ints
    steps: Ints
    valid: Bools

    @cached_property
    def order(self) -> Ints:
        """Rows by time, joint and session: the one order that doesn't depend on the files'."""
        if np.all(self.time[1:] > self.time[:-1]):
            return np.arange(len(self.time))
        return np.lexsort((self.session, self.joint, self.time))

    @property
    def steps_before(self) -> Ints:
        """Steps of each row's joint in all rows before it; rows in the order of time."""
        return steps_before(self.joint[self.order], self.steps[self.order])

    def take(self, chosen: Bools) -> Identity:
        """Only these rows."""
        return Identity(
            self.labels,
            self.session[chosen],
            self.time[chosen],
            self.zoned[chosen],
            self.joint[chosen],
            self.steps[chosen],
            self.valid[chosen],
        )

    def columns(self) -> dict[str, pd.Series]:
        """The Log's columns; times are in UTC where the log has zones."""
        time = pd.Series(self.time.view("datetime64[ns]"), copy=False)
        return {
            "session": labelled(self.session, self.labels),
            "time": time.dt.tz_localize("UTC") if self.zoned.any() else time,
            "joint": pd.Series(self.joint, copy=False),
            "steps": pd.Series(self.steps, copy=False),
        }


def identify(files: list[Cells]) -> Identity:
    """Read the columns by which a row is known, and tell of what is wrong with them."""
    read = together(
        {
            "sessions": lambda: _sessions(files),
            "times": lambda: [cells.times("time") for cells in files],
            "joint": lambda: np.concatenate(
                [cells.counts("joint", _NO_JOINT, most=3, needed=True) for cells in files]
            ),
            "steps": lambda: np.concatenate(
                [cells.counts("steps", _NO_COUNT, needed=True) for cells in files]
            ),
        }
    )
    labels, session = read["sessions"]
    timed = ~np.concatenate([time.empty | time.bad for time in read["times"]])
    identity = Identity(
        labels=labels,
        session=session,
        time=np.concatenate([time.values for time in read["times"]]),
        zoned=np.concatenate([time.zoned for time in read["times"]]),
        joint=read["joint"],
        steps=read["steps"],
        valid=timed & (read["joint"] > 0) & np.array([bool(label) for label in labels], np.bool_)[session],
    )
    _complain_about_zones(files, identity.zoned & timed, ~identity.zoned & timed)
    _complain_about_doubles(files, identity)
    return identity


def _sessions(files: list[Cells]) -> tuple[tuple[str, ...], Ints]:
    encoded = pa.concat_arrays([cells.texts("session") for cells in files]).dictionary_encode()
    found = np.array(encoded.dictionary.to_pylist(), dtype=object)
    order = np.argsort(found)
    session = np.argsort(order)[encoded.indices.to_numpy()]
    labels = tuple(found[order])
    blank = np.array([not label.strip() for label in labels], np.bool_)[session]
    for cells, blank_here in zip(files, by_file(files, blank), strict=True):
        cells.complain("session", blank_here, "is empty; write a label, such as the date 2012-03-05")
    return labels, session


def _complain_about_zones(files: list[Cells], zoned: Bools, local: Bools) -> None:
    """Tell of zones on some rows only; the rarer kind is held to be the mistake."""
    if not (zoned.any() and local.any()):
        return
    if zoned.sum() < local.sum():
        wrong, right, said = zoned, local, "has a time zone, but {} has none; give all rows one, or none"
    else:
        wrong, right, said = local, zoned, "has no time zone, but {} has one; give all rows one, or none"
    message = said.format(place_of(files, int(np.argmax(right))))
    for cells, wrong_here in zip(files, by_file(files, wrong), strict=True):
        cells.complain("time", wrong_here, message)


def _complain_about_doubles(files: list[Cells], identity: Identity) -> None:
    order = identity.order
    # Times seldom repeat: joint and session need a look only where they do.
    again = np.flatnonzero(np.diff(identity.time[order]) == 0)
    one, other = order[again], order[again + 1]
    same = identity.valid[one] & identity.valid[other] & (identity.joint[one] == identity.joint[other])
    same &= identity.session[one] == identity.session[other]
    twin = dict(zip(other[same].tolist(), one[same].tolist(), strict=True))
    wrong = np.zeros(len(order), np.bool_)
    wrong[list(twin)] = True
    start = 0
    for cells, wrong_here in zip(files, by_file(files, wrong), strict=True):
        cells.complain("time", wrong_here, _double(files, twin, start))
        start += cells.table.count


def _double(files: list[Cells], twin: dict[int, int], start: int) -> Message:
    def message(row: int, value: str) -> str:
        other = place_of(files, twin[start + row])
        return f"repeats the session, time and joint of {other}; correct one of the two, or delete a copy"

    return message
