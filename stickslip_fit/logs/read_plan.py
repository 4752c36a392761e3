"""A plan from its TOML file."""

from __future__ import annotations

from datetime import date, datetime, time, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from annotated_types import Interval, Len, MinLen
from pydantic import AfterValidator, BeforeValidator, model_validator

from stickslip_fit._toml import Count, Give, Quantity, Table, Text, read_toml
from stickslip_fit.logs.check import DIRECTIONS
from stickslip_fit.logs.plan import Noise, NoiseKind, Order, Plan, PlannedSession, Timing
from stickslip_fit.logs.sweep import AnySweep, traverses_of
from stickslip_fit.machine import JOINTS, Machine
from stickslip_fit.units import to_si

YEARS = range(1900, 2200)  # what a log's times can hold, with room for every session
MOST_TRAVERSES = 5_000_000
LEAST_REPEATABLE = 20.0  # %; beyond, the spread of log(steps) is no relative error any more
DRIVES = {f"{joint}{direction}": (joint, direction) for joint in JOINTS for direction in DIRECTIONS}
DATES = "give dates, such as [2012-03-05, 2012-03-06]; or first_date and count"


def _date(value: Any) -> date:
    value = date.fromisoformat(value) if isinstance(value, str) else value
    if isinstance(value, datetime) or not isinstance(value, date) or value.year not in YEARS:
        raise ValueError("no date")
    return value


def _time(value: Any) -> time:
    value = time.fromisoformat(value) if isinstance(value, str) else value
    if not isinstance(value, time) or value.tzinfo is not None:
        raise ValueError("no time of day")
    return value.replace(microsecond=0)


def _by_drive(value: Any) -> Any:
    return value if isinstance(value, dict) else dict.fromkeys(DRIVES, value)


def _not_falling(ends: list[float]) -> list[float]:
    if ends[0] > ends[1]:
        raise ValueError("falling")
    return ends


Day = Annotated[date, BeforeValidator(_date)]
Clock = Annotated[time, BeforeValidator(_time)]
Patience = Quantity(("s", "min"), (0.0, 86_400.0), "give [lowest, highest], each {}")
Seconds = Annotated[list[float], Len(2, 2), AfterValidator(_not_falling), Patience]
Seed = Annotated[int, Interval(ge=0, le=2**63 - 1)]
Percent = Annotated[float, Interval(ge=0, le=LEAST_REPEATABLE)]
Drive = Literal["1+", "1-", "2+", "2-", "3+", "3-"]


class SessionsTable(Table):
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
    def _fit_together(self) -> Self:
        self.sessions()
        return self


class TimingTable(Table):
    """How long things take."""

    step_period: Annotated[float, Quantity(("ms", "s"), (1e-5, 10.0))] = Timing.step_period
    """Between two steps."""
    pause: Seconds = list(Timing.pause)
    """Shortest and longest time to set the next configuration."""
    turn: Seconds = list(Timing.turn)
    """The same where nothing needs to be set."""


class NoiseTable(Table):
    """How well counts repeat; only a simulation needs it."""

    repeatability_pct: Annotated[
        dict[Drive, Percent],
        BeforeValidator(_by_drive, json_schema_input_type=Percent | dict[Drive, Percent]),
        Give(
            f"give a percentage from 0 to {LEAST_REPEATABLE:g}, or a table of such by joint and direction: "
            '{"3+" = 0.27, "3-" = 0.3}'
        ),
    ]
    """Spread of the counts; one number, or a table such as `{"3+" = 0.27, "3-" = 0.3}`."""
    kind: NoiseKind = "gaussian"
    """`"t5"`: Student's t with 5 degrees of freedom, scaled to the same spread."""


class PlanFile(Table):
    """A plan: what is measured when."""

    name: Text = ""
    """Shown on the sheet; the file's name if left out."""
    seed: Seed = 0
    """Settles the random order and the simulation."""
    check_every: Count = 5
    """The end stop is looked for after so many steps."""
    order: Order = "as-written"
    """`"random"` shuffles each session's configurations; the traverses of one configuration stay together."""
    replicates: Count = 1
    """How often a session goes through the whole list of sweeps."""
    sessions: SessionsTable
    timing: TimingTable
    noise: Annotated[NoiseTable | None, BeforeValidator(lambda written: written or None)] = None
    sweep: Annotated[list[AnySweep], MinLen(1)]

    @model_validator(mode="after")
    def _few_enough(self) -> Self:
        in_a_session = sum(sweep.configurations() * sweep.in_each() for sweep in self.sweep)
        total = in_a_session * self.replicates * len(self.sessions.sessions())
        if total > MOST_TRAVERSES:
            self.refuse(
                (f"the plan makes {total:,} traverses; keep it to {MOST_TRAVERSES:,}", ("replicates",))
            )
        return self


def read_plan(path: str | Path, machine: Machine) -> Plan:
    """Read and check a plan.

    Parameters
    ----------
    path : path
        A TOML file with the keys of `PlanFile`.
    machine : Machine
        Its ranges fill in full traverses and bound everything else.

    Raises
    ------
    InputError
        With every fault of the file.

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
    read = read_toml(path, PlanFile, "plan file", machine)
    noise, (shortest, longest), turn = read.noise, read.timing.pause, read.timing.turn
    spreads = noise.repeatability_pct.items() if noise else ()
    return Plan(
        name=read.name or Path(path).stem,
        sessions=read.sessions.sessions(),
        traverses=traverses_of(read.sweep, machine),
        replicates=read.replicates,
        order=read.order,
        check_every=read.check_every,
        timing=Timing(read.timing.step_period, (shortest, longest), (turn[0], turn[1])),
        noise=Noise({DRIVES[drive]: to_si(value, "%") for drive, value in spreads}, noise.kind)
        if noise
        else None,
        seed=read.seed,
    )
