"""read_plan: a Plan from a TOML file, whose keys `PlanFile` declares.

A sweep lists positions and orientations, which are taken in every combination.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import date, datetime, time, timedelta
from itertools import pairwise, product
from math import nan, prod, tau
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import pandas as pd
from annotated_types import Interval, Len, MinLen
from pydantic import AfterValidator, BeforeValidator, Field, create_model, model_validator

from stickslip_fit._toml import Bounds, Count, Give, Quantity, Text, TomlTable, chosen_by, read_toml
from stickslip_fit.logs.plan import Noise, NoiseKind, Plan, PlannedSession, Timing, TraverseOrder
from stickslip_fit.logs.reader import DIRECTIONS
from stickslip_fit.machine import Machine
from stickslip_fit.machine.machine import PREDICT_DRIVES
from stickslip_fit.units import JOINTS, to_si

ANGLE_UNITS = ("deg", "rad")
UNITS_OF = {1: ANGLE_UNITS, 2: ANGLE_UNITS, 3: ("mm", "m", "µm", "nm")}
SWEEP_AXES = ("q1", "q2", "q3", "theta", "psi")
SWEEP_COLUMNS = ("sweep", "joint", "direction", *SWEEP_AXES, "start", "stop", "status")
MAX_CONFIGURATIONS = 100_000


def _range(joint: int) -> Callable[[Machine], Bounds]:
    return lambda machine: machine.ranges[joint]


def _to_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _check_distinct(values: list[Any]) -> list[Any]:
    if len(set(values)) < len(values):
        raise ValueError("twice the same")
    return values


LIST, PAIRS = "give {}, or a list of such", "give a list of [from, to], two different ends, each {}"
Numbers = Annotated[
    list[float], MinLen(1), BeforeValidator(_to_list, json_schema_input_type=float | list[float])
]
Pairs = Annotated[list[Annotated[list[float], Len(2, 2), AfterValidator(_check_distinct)]], MinLen(1)]
Orientations = Annotated[Numbers, Quantity(ANGLE_UNITS, (-tau, tau), LIST)]
JOINT = Give("give one of 1, 2, 3")
Joint = Annotated[int, JOINT, Interval(ge=1, le=3)]
Directions = Annotated[list[Literal["+", "-"]], MinLen(1), AfterValidator(_check_distinct)]


class SweepTable(TomlTable, extra="ignore"):
    """Keys of every sweep; further ones depend on the joint."""

    joint: Joint
    """Which joint moves."""
    name: Text = ""
    """Heading on the sheet; the joint if left out."""
    directions: Annotated[Directions, Give('give ["+", "-"], ["-", "+"], ["+"] or ["-"]')] = ["+", "-"]
    """In turn."""
    theta: Orientations = [0.0]
    """Orientation of the base, within one turn."""
    psi: Orientations = [0.0]
    """Orientation of the base, within one turn."""
    replicates: Annotated[int, Interval(ge=1, le=1_000)] = 1
    """How often in a row each configuration's directions are traversed."""
    status: Literal["ok", "excluded"] = "ok"
    """`"excluded"`: traverses that count as history but are not fitted, such as a warm-up drive."""

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        if (count := self.configurations()) > MAX_CONFIGURATIONS:
            self.refuse((f"makes {count:,} configurations; keep it to {MAX_CONFIGURATIONS:,}", ("name",)))
        return self

    def configurations(self) -> int:
        """Number of combinations of its lists."""
        return prod(len(getattr(self, axis, None) or [0]) for axis in ("ranges", *SWEEP_AXES))

    def traverses_per_configuration(self) -> int:
        """Number of traverses in each."""
        return len(self.directions) * self.replicates

    def axes(self, machine: Machine) -> dict[str, list[Any]]:
        """The lists, in the order of the table's keys."""
        axes = {axis: getattr(self, axis) for axis in ("ranges", *SWEEP_AXES) if hasattr(self, axis)}
        axes["ranges"] = axes["ranges"] or [machine.ranges[self.joint]]
        written = self.fields_in_file()
        order = sorted(axes, key=lambda axis: written.index(axis) if axis in written else -1)
        return {axis: axes[axis] for axis in order}

    def rows(self, machine: Machine) -> Iterator[tuple[Any, ...]]:
        """Its traverses, with the columns of `Plan.traverses` from sweep on."""
        axes = self.axes(machine)
        for combination in product(*axes.values()):
            position = {f"q{self.joint}": nan, **dict(zip(axes, combination, strict=True))}
            low, high = sorted(position["ranges"])
            for direction in self.directions * self.replicates:
                start, stop = (low, high) if direction == "+" else (high, low)
                name = self.name or f"joint {self.joint}"
                place = (position[axis] for axis in SWEEP_AXES)
                yield (name, self.joint, direction, *place, start, stop, self.status)


def _sweep_model(joint: int) -> type[SweepTable]:
    ranges = Annotated[Pairs, Quantity(UNITS_OF[joint], _range(joint), PAIRS)]
    meaning = "Ends of partial traverses, which each direction runs its own way; the full range if left out."
    fields: dict[str, Any] = {
        "joint": Annotated[Literal[joint], JOINT],
        "ranges": (ranges, Field([], description=meaning)),
    }
    for other in {*JOINTS} - {joint}:
        numbers = Annotated[Numbers, Quantity(UNITS_OF[other], _range(other), LIST)]
        # Joints 2 and 3 affect every law: their positions are required.
        default = [0.0] if other == 1 else ...
        fields[f"q{other}"] = (numbers, Field(default, description=f"Where joint {other} stands."))
    return create_model(
        f"SweepOfJoint{joint}", __base__=SweepTable, __cls_kwargs__={"extra": "forbid"}, **fields
    )


AnySweep = Annotated[
    SweepTable, chosen_by("joint", {joint: _sweep_model(joint) for joint in JOINTS}, SweepTable)
]


def traverses_of(sweeps: list[SweepTable], machine: Machine) -> pd.DataFrame:
    """The traverses of all [[sweep]] tables, in order, with the columns of `Plan.traverses`.

    A key's list is taken in every combination with the others', the last key of the table fastest.
    """
    records = [row for sweep in sweeps for row in sweep.rows(machine)]
    table = pd.DataFrame(records, columns=list(SWEEP_COLUMNS)).astype({"joint": "int64"})
    table.insert(0, "visit", _number_visits(table))
    return table


def _number_visits(table: pd.DataFrame) -> pd.Series:
    """Number the visits: consecutive traverses between which only the direction changes."""
    setting = table[["joint", *SWEEP_AXES]].fillna(0.0)
    ends = table[["start", "stop"]]
    setting["low"], setting["high"] = ends.min(axis=1), ends.max(axis=1)
    return (setting != setting.shift()).any(axis=1).cumsum() - 1


ALLOWED_YEARS = range(1900, 2200)  # within the range of nanosecond times
MAX_TRAVERSES = 5_000_000
MAX_LISTED = 500_000
MAX_REPEATABILITY_PERCENT = 20.0  # %; beyond, the spread of log(steps) is no relative error any more
DRIVES = {f"{joint}{direction}": (joint, direction) for joint in JOINTS for direction in DIRECTIONS}
DATES = "give dates, such as [2012-03-05, 2012-03-06]; or first_date and count"


def _parse_date(value: Any) -> date:
    value = date.fromisoformat(value) if isinstance(value, str) else value
    if isinstance(value, datetime) or not isinstance(value, date) or value.year not in ALLOWED_YEARS:
        raise ValueError("no date")
    return value


def _parse_time(value: Any) -> time:
    value = time.fromisoformat(value) if isinstance(value, str) else value
    if not isinstance(value, time) or value.tzinfo is not None:
        raise ValueError("no time of day")
    return value.replace(microsecond=0)


def _to_drives(value: Any) -> Any:
    return value if isinstance(value, dict) else dict.fromkeys(DRIVES, value)


def _check_order(ends: list[float]) -> list[float]:
    if ends[0] > ends[1]:
        raise ValueError("falling")
    return ends


Day = Annotated[date, BeforeValidator(_parse_date)]
Clock = Annotated[time, BeforeValidator(_parse_time)]
Pause = Quantity(("s", "min"), (0.0, 86_400.0), "give [lowest, highest], each {}")
Seconds = Annotated[list[float], Len(2, 2), AfterValidator(_check_order), Pause]
Seed = Annotated[int, Interval(ge=0, le=2**63 - 1)]
Percent = Annotated[float, Interval(ge=0, le=MAX_REPEATABILITY_PERCENT)]
Drive = Literal["1+", "1-", "2+", "2-", "3+", "3-"]


class SessionsTable(TomlTable):
    """When it is measured."""

    dates: Annotated[list[Day], MinLen(1), Give(DATES)] = []
    """One for each session, unless there is a first date."""
    first_date: Annotated[Day | None, Give("give a date such as 2012-03-05")] = None
    """Of `count` days in a row."""
    count: Count = 1
    """How many days in a row."""
    labels: Annotated[list[Text], Give('give texts in quotes, such as ["first day", "second day"]')] = []
    """What the log calls the sessions; the dates if left out."""
    start: Annotated[
        Clock | list[Clock], Give('give a time of day such as "08:30", or a list of one for each session')
    ] = time(8, 30)
    """Time of day at which a session begins, or a list of one for each."""

    def sessions(self) -> tuple[PlannedSession, ...]:
        """The sessions, with one label and one start each, in order."""
        days, first = self.dates, self.first_date
        if first is not None:
            days = [first + timedelta(days=number) for number in range(self.count)]
        labels = self.labels or [day.isoformat() for day in days]
        starts = self.start if isinstance(self.start, list) else [self.start] * len(days)
        if not days:
            self.refuse((DATES, ("dates",)))
        if len(set(labels)) < len(labels):
            self.refuse(("two sessions have one label; give labels that differ", ("labels",)))
        if not len(labels) == len(starts) == len(days):
            given = f"{len(labels)} labels, {len(starts)} starts, {len(days)} dates"
            self.refuse((f"{given}; give each session one of each", ("labels",)))
        begins = [datetime.combine(day, clock) for day, clock in zip(days, starts, strict=True)]
        if any(later <= earlier for earlier, later in pairwise(begins)):
            self.refuse(("a session does not begin after the one before it; put them in order", ("dates",)))
        return tuple(PlannedSession(label, moment) for label, moment in zip(labels, begins, strict=True))

    @model_validator(mode="after")
    def _check_sessions(self) -> Self:
        self.sessions()
        return self


class TimingTable(TomlTable):
    """How long things take."""

    step_period: Annotated[float, Quantity(("ms", "s"), (1e-5, 10.0))] = Timing.step_period
    """Between two steps."""
    pause: Seconds = list(Timing.pause)
    """Shortest and longest time to set the next configuration."""
    turn: Seconds = list(Timing.turn)
    """The same where nothing needs to be set."""


class NoiseTable(TomlTable):
    """How well counts repeat; only a simulation needs it."""

    repeatability_pct: Annotated[
        dict[Drive, Percent],
        BeforeValidator(_to_drives, json_schema_input_type=Percent | dict[Drive, Percent]),
        Give(
            f"give a percentage from 0 to {MAX_REPEATABILITY_PERCENT:g}, or a table of such by joint and "
            'direction: {"3+" = 0.27, "3-" = 0.3}'
        ),
    ]
    """Spread of the counts; one number, or a table such as `{"3+" = 0.27, "3-" = 0.3}`."""
    kind: NoiseKind = "gaussian"
    """`"t5"`: Student's t with 5 degrees of freedom, scaled to the same spread."""


class PlanFile(TomlTable):
    """A plan: what is measured when."""

    name: Text = ""
    """Shown on the sheet; the file's name if left out."""
    seed: Seed = 0
    """Settles the random order and the simulation."""
    check_every: Count = 5
    """The end stop is looked for after so many steps."""
    order: TraverseOrder = "as-written"
    """`"random"` shuffles each session's configurations; the traverses of one configuration stay together."""
    replicates: Count = 1
    """How often a session goes through the whole list of sweeps."""
    sessions: SessionsTable
    timing: TimingTable
    noise: Annotated[NoiseTable | None, BeforeValidator(lambda written: written or None)] = None
    sweep: Annotated[list[AnySweep], MinLen(1)]

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        counts = [sweep.configurations() * sweep.traverses_per_configuration() for sweep in self.sweep]
        if sum(counts) > MAX_LISTED:
            message = f"a session's list has {sum(counts):,} traverses; keep it to {MAX_LISTED:,}"
            self.refuse((message, ("sweep",)))
        total = sum(counts) * self.replicates * len(self.sessions.sessions())
        if total > MAX_TRAVERSES:
            message = f"the plan makes {total:,} traverses; keep it to {MAX_TRAVERSES:,}"
            self.refuse((message, ("replicates",)))
        return self


def read_plan(path: str | Path, machine: Machine) -> Plan:
    """Read and check a plan, a TOML file with the keys of `PlanFile`.

    The machine's ranges are the ends of full traverses and bound every position. InputError has every issue
    of the file, or says that plans are for machines of the published geometry.

    Examples
    --------
    >>> import tempfile
    >>> from stickslip_fit.machine import load_machine
    >>> text = '''
    ... [sessions]
    ... dates = [2012-03-05]
    ... [[sweep]]
    ... joint = 3
    ... q2_deg = [-90, 0]
    ... theta_deg = [-90, 0]
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "plan.toml")
    ...     _ = path.write_text(text)
    ...     plan = read_plan(path, load_machine())
    >>> print(plan.rows()[["session", "joint", "direction", "q2", "theta"]].round(2).head(3))
          session  joint direction    q2  theta
    0  2012-03-05      3         + -1.57  -1.57
    1  2012-03-05      3         - -1.57  -1.57
    2  2012-03-05      3         + -1.57   0.00
    """
    machine.require_geometry("a plan of a campaign", PREDICT_DRIVES)
    content = read_toml(path, PlanFile, "plan file", machine)
    noise, (shortest, longest), turn = None, content.timing.pause, content.timing.turn
    if content.noise:
        percent = content.noise.repeatability_pct.items()
        noise = Noise({DRIVES[drive]: to_si(value, "%") for drive, value in percent}, content.noise.kind)
    return Plan(
        name=content.name or Path(path).stem,
        sessions=content.sessions.sessions(),
        traverses=traverses_of(content.sweep, machine),
        replicates=content.replicates,
        order=content.order,
        check_every=content.check_every,
        timing=Timing(content.timing.step_period, (shortest, longest), (turn[0], turn[1])),
        noise=noise,
        seed=content.seed,
    )
