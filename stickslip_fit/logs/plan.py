"""Plan: the traverses to measure, their order and timing, and the sheet to record them on.

A traverse without from and to covers the whole range of its joint.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._io import write_atomically
from stickslip_fit._typing import Array, Int64Array
from stickslip_fit.logs._table import IssueMessage
from stickslip_fit.logs.schema import LogCells
from stickslip_fit.machine import Machine
from stickslip_fit.units import PRISMATIC, from_si

TraverseOrder = Literal["as-written", "random"]
NoiseKind = Literal["gaussian", "t5"]


@dataclass(frozen=True)
class PlannedSession:
    """A planned session and the time of its first traverse."""

    label: str
    begins: datetime


@dataclass(frozen=True)
class Timing:
    """Times in seconds: the step period, and the shortest and longest pause before a traverse.

    `pause` is for setting the next configuration, `turn` for a traverse for which nothing needs to be set.
    """

    step_period: float = 0.010
    pause: tuple[float, float] = (60.0, 240.0)
    turn: tuple[float, float] = (5.0, 15.0)


@dataclass(frozen=True)
class Noise:
    """Standard deviation of log(steps) by joint and direction, and the distribution of the noise.

    ``t5`` is Student's t with 5 degrees of freedom, scaled to the same standard deviation.
    """

    repeatability: dict[tuple[int, str], float]
    kind: NoiseKind = "gaussian"


@dataclass(frozen=True, eq=False)
class Plan:
    """The traverses to make, session by session; at least one of each.

    Attributes
    ----------
    name : str
    sessions : tuple of PlannedSession
        In order of time.
    traverses : DataFrame
        One pass through the list, in order: visit (int; equal for consecutive traverses of one
        configuration), sweep (text), joint, direction, q1, q2, q3, theta, psi, start, stop, SI, status
        (``ok`` or ``excluded``); the moving joint's own position is NaN.
    replicates : int
        Passes through the list in a session.
    order : {'as-written', 'random'}
        ``random`` shuffles the visits within each session; a visit's traverses stay together, and excluded
        ones, such as a warm-up drive, come first.
    check_every : int
        Steps between two checks for the end stop.
    timing : Timing
    noise : Noise or None
        Only needed for a simulation.
    seed : int
        Of the random order, and of the simulation unless it has its own.
    """

    name: str
    sessions: tuple[PlannedSession, ...]
    traverses: pd.DataFrame
    replicates: int = 1
    order: TraverseOrder = "as-written"
    check_every: int = 5
    timing: Timing = field(default_factory=Timing)
    noise: Noise | None = None
    seed: int = 0

    def rows(self) -> pd.DataFrame:
        """Every traverse of every session, in order of time.

        The log's columns session (categorical), joint, direction, q1 to psi, start, stop, status, check_every
        and step_period, SI, with sweep, and visit counted through all sessions. A further session does not
        change the order in the others.
        """
        count = self.traverses_per_session
        index = np.concatenate([self._order(number) for number in range(len(self.sessions))])
        rows = self.traverses.iloc[index % len(self.traverses)].reset_index(drop=True)
        labels = [session.label for session in self.sessions]
        rows.insert(0, "session", pd.Categorical.from_codes(np.repeat(np.arange(len(labels)), count), labels))
        visits = self._visits()[index]
        begins = np.diff(visits, prepend=visits[0]) != 0
        begins[::count] = True
        rows["visit"] = np.cumsum(begins)
        rows["check_every"] = self.check_every
        rows["step_period"] = self.timing.step_period
        return rows

    @property
    def traverses_per_session(self) -> int:
        """Number of traverses in each session."""
        return self.replicates * len(self.traverses)

    def _visits(self) -> npt.NDArray[np.int64]:
        """The visit of each traverse of a session in the order of the list, numbered through all passes."""
        once = self.traverses["visit"].to_numpy(np.int64)
        passes = np.arange(self.replicates) * (once.max() + 1)
        return (passes[:, None] + once).ravel()

    def _order(self, number: int) -> npt.NDArray[np.intp]:
        """Indices of a session's traverses in the repeated list, in order of time."""
        if self.order == "as-written":
            return np.arange(self.traverses_per_session)
        visits = self._visits()
        shuffled = np.random.default_rng([self.seed, number]).permutation(visits.max() + 1)
        fitted = np.tile(self.traverses["status"] == "ok", self.replicates)
        return np.lexsort((shuffled[visits], fitted))


RANGE_TOL = 1e-9  # of a joint's range, for rounding in unit conversion


def _joints_by_kind(machine: Machine) -> dict[str, list[int]]:
    """Rotary and prismatic joints."""
    joints: dict[str, list[int]] = {"angle": [], "length": []}
    for joint in machine.joints:
        joints["length" if machine.is_prismatic(joint) else "angle"].append(joint)
    return {kind: numbers for kind, numbers in joints.items() if numbers}


def read_traverses(
    cells: LogCells, machine: Machine, joint: Int64Array, forward: Int64Array
) -> tuple[Array, Array]:
    """Read and check start and stop from from and to, rad or m, NaN where unknown; all of shape (n,).

    An empty cell is the end of the machine's range. `joint` is 0 where unknown; `forward` is 1 for `+`, -1
    for `-`, 0 where unknown.
    """
    low, high = np.array([(np.nan, np.nan), *(machine.ranges[joint] for joint in machine.joints)]).T
    unknown = np.full_like(low, np.nan)
    start = _read_end(cells, machine, joint, "from", np.stack([high, unknown, low])[forward + 1, joint])
    stop = _read_end(cells, machine, joint, "to", np.stack([low, unknown, high])[forward + 1, joint])
    _report_bad_length(cells, machine, joint, forward, start, stop)
    return start, stop


def report_outside_range(cells: LogCells, machine: Machine, field: str, joint: int, values: Array) -> None:
    """Add issues for positions beyond the joint's range."""
    low, high = machine.ranges[joint]
    slack = RANGE_TOL * (high - low)
    if not cells.has(field):
        return
    unit = cells.layout.known[field].unit
    limits = f"{from_si(low, unit):g} to {from_si(high, unit):g} {unit}"
    message = f"is outside joint {joint}'s range, {limits}; correct it, or the range in the machine file"
    cells.add_issue(field, (values < low - slack) | (values > high + slack), message)


def _read_end(cells: LogCells, machine: Machine, joint: Int64Array, stem: str, default: Array) -> Array:
    values = default
    for kind, joints in _joints_by_kind(machine).items():
        field = f"{stem}_{kind}"
        if not cells.has(field):
            continue
        subset, filled = np.isin(joint, joints), cells.is_filled(field)
        foreign = ~subset & (joint > 0)
        cells.add_issue(field, foreign & filled, _wrong_kind_message(machine, joint, stem))
        ends = cells.numbers(field, ignored=foreign)
        for number in joints:
            report_outside_range(cells, machine, field, number, np.where(joint == number, ends, np.nan))
        values = np.where(subset & filled, ends, values)
    return values


def _wrong_kind_message(machine: Machine, joint: Int64Array, stem: str) -> IssueMessage:
    def message(row: int, value: str) -> str:
        number = int(joint[row])
        if machine.is_prismatic(number):
            return f"is an angle, but joint {number} is prismatic; write {stem}_mm, and leave this cell empty"
        return f"is a length, but joint {number} is rotary; write {stem}_deg, and leave this cell empty"

    return message


def _report_bad_length(
    cells: LogCells, machine: Machine, joint: Int64Array, forward: Int64Array, start: Array, stop: Array
) -> None:
    span = np.array([np.nan, *map(machine.span, machine.joints)])
    for kind, joints in _joints_by_kind(machine).items():
        ends = _end_column_names(cells, kind)
        if not ends:
            continue
        subset, has_end = np.isin(joint, joints), cells.is_filled(f"to_{kind}")
        length = stop - start
        # NaN, which has an issue already, gets no further one.
        zero = subset & (np.abs(length) <= RANGE_TOL * span[joint])
        message = f"makes a traverse of no length ({ends}); leave both empty for the full range"
        cells.add_issue(f"to_{kind}", zero & has_end, message)
        cells.add_issue(f"from_{kind}", zero & ~has_end, message)
        opposite = subset & ~zero & (forward * length < 0)
        cells.add_issue("direction", opposite, _direction_message(kind, ends, start, stop))


def _direction_message(kind: str, ends: str, start: Array, stop: Array) -> IssueMessage:
    unit = "mm" if kind == "length" else "deg"

    def message(row: int, value: str) -> str:
        first, last = (from_si(float(end[row]), unit) for end in (start, stop))
        return f"disagrees with {ends}: {first:g} to {last:g} {unit}; correct the one or the other"

    return message


def _end_column_names(cells: LogCells, kind: str) -> str:
    ends = [f"{end}_{kind}" for end in ("from", "to")]
    return " and ".join(cells.layout.known[end].name for end in ends if cells.has(end))


def build_sheet(plan: Plan) -> pd.DataFrame:
    """The cells of the sheet as text, one row per traverse in order of time."""
    rows = plan.rows()
    rotary = rows["joint"] != PRISMATIC
    ends = {"from": rows["start"], "to": rows["stop"]}
    blank = pd.Series("", rows.index)
    return pd.DataFrame(
        {
            "session": rows["session"],
            "time": blank,
            "joint": rows["joint"],
            "direction": rows["direction"],
            "steps": blank,
            **{f"{name}_deg": format_cells(rows[name], "deg") for name in ("q1", "q2")},
            "q3_mm": format_cells(rows["q3"], "mm"),
            **{f"{name}_deg": format_cells(rows[name], "deg") for name in ("theta", "psi")},
            **{f"{name}_deg": format_cells(end.where(rotary), "deg") for name, end in ends.items()},
            **{f"{name}_mm": format_cells(end.where(~rotary), "mm") for name, end in ends.items()},
            "check_every": rows["check_every"],
            "step_period_ms": format_cells(rows["step_period"], "ms"),
            "status": rows["status"].replace("ok", ""),
            "note": blank,
        }
    )


def write_sheet_csv(plan: Plan, path: str | Path) -> None:
    """Write the sheet; when it is filled in, `read_log` reads it.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_atomically(path, build_sheet(plan).to_csv(index=False, lineterminator="\n"))


def format_cells(values: pd.Series, symbol: str) -> list[str]:
    """Rounded numbers; empty for NaN."""
    return [
        "" if np.isnan(value) else f"{value + 0.0:.10g}"
        for value in from_si(values.to_numpy(float), symbol).round(10)
    ]
