"""A plan from its TOML file."""

from __future__ import annotations

from datetime import date, datetime, time, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from annotated_types import Interval, Len, MinLen
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from stickslip_fit._toml import Give, Quantity, Table, Text, read_toml
from stickslip_fit.logs.check import DIRECTIONS
from stickslip_fit.logs.plan import Noise, NoiseKind, Order, Plan, PlannedSession, Timing
from stickslip_fit.logs.sweep import AnySweep, traverses_of
from stickslip_fit.machine import JOINTS, Machine
from stickslip_fit.units import to_si

MOST_SESSIONS = 10_000
YEARS = range(1900, 2200)  # what a log's times can hold, with room for every session
MOST_TRAVERSES = 5_000_000
LARGEST_SEED = 2**63 - 1
LEAST_REPEATABLE = 0.2  # beyond, the spread of log(steps) is no relative error any more
DRIVES = {f"{joint}{direction}": (joint, direction) for joint in JOINTS for direction in DIRECTIONS}


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


def _not_falling(ends: list[float]) -> list[float]:
    if ends[0] > ends[1]:
        raise ValueError("falling")
    return ends


def _by_drive(value: Any) -> Any:
    return value if isinstance(value, dict) else dict.fromkeys(DRIVES, value)


Day = Annotated[date, BeforeValidator(_date)]
Clock = Annotated[time, BeforeValidator(_time)]
Seconds = Annotated[
    list[float], Len(2, 2), AfterValidator(_not_falling),
    Quantity(("s", "min"), (0.0, 86_400.0), "give [lowest, highest], each {}"),
]  # fmt: skip
Seed = Annotated[int, Field(ge=0, le=LARGEST_SEED)]


class SessionsTable(Table):
    """When it is measured."""

    dates: Annotated[
        list[Day], MinLen(1), Give("give dates, such as [2012-03-05, 2012-03-06]; or first_date and count")
    ] = Field([], description="one for each session, unless there is a first date")
    first_date: Annotated[Day | None, Give("give a date such as 2012-03-05")] = Field(
        None, description="of as many days in a row as `count` says"
    )
    count: int = Field(1, ge=1, le=MOST_SESSIONS, description="how many days in a row")
    labels: Annotated[list[Text], Give('give texts in quotes, such as ["first day", "second day"]')] = Field(
        [], description="what the log calls the sessions; the dates if left out"
    )
    start: Annotated[
        Clock | list[Clock], Give('give a time of day such as "08:30", or a list of one for each session')
    ] = Field(time(8, 30), description="time of day at which a session begins, or a list of one for each")

    def days(self) -> list[date]:
        """All dates."""
        if self.first_date is None:
            return self.dates
        return [self.first_date + timedelta(days=number) for number in range(self.count)]

    def sessions(self) -> tuple[PlannedSession, ...]:
        """The sessions, which have one label and one start each."""
        days = self.days()
        starts = self.start if isinstance(self.start, list) else [self.start] * len(days)
        labels = self.labels or [day.isoformat() for day in days]
        if not len(labels) == len(starts) == len(days):
            found = f"{len(labels)} labels, {len(starts)} starts, {len(days)} dates"
            self.refuse([(f"{found}; give each session one of each", ["labels"])])
        begins = [datetime.combine(day, clock) for day, clock in zip(days, starts, strict=True)]
        if any(later <= earlier for earlier, later in pairwise(begins)):
            self.refuse([("a session does not begin after the one before it; put them in order", ["dates"])])
        return tuple(PlannedSession(label, moment) for label, moment in zip(labels, begins, strict=True))

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        if not self.days():
            self.refuse([(type(self).model_fields["dates"].metadata[-1].advice, ["dates"])])
        if len(set(self.labels)) < len(self.labels):
            self.refuse([("two sessions have one label; give labels that differ", ["labels"])])
        self.sessions()
        return self


class TimingTable(Table):
    """How long things take."""

    step_period: Annotated[float, Quantity(("ms", "s"), (1e-5, 10.0))] = Timing.step_period
    pause: Seconds = Field(
        list(Timing.pause), description="shortest and longest time to set the next configuration"
    )
    turn: Seconds = Field(list(Timing.turn), description="the same where nothing needs to be set")

    def timing(self) -> Timing:
        """As a plan has it."""
        (shortest, longest), turn = self.pause, self.turn
        return Timing(self.step_period, (shortest, longest), (turn[0], turn[1]))


class NoiseTable(Table):
    """How well counts repeat; only what is simulated needs it."""

    repeatability_pct: Annotated[
        dict[
            Literal["1+", "1-", "2+", "2-", "3+", "3-"],
            Annotated[float, Interval(ge=0, le=100 * LEAST_REPEATABLE)],
        ],
        BeforeValidator(_by_drive),
        Give(
            f"give a percentage from 0 to {100 * LEAST_REPEATABLE:g}, or a table of such by joint and direction: "
            '{"3+" = 0.27, "3-" = 0.3}'
        ),
    ] = Field(description='spread of the counts; one number, or a table such as {"3+" = 0.27, "3-" = 0.3}')
    kind: NoiseKind = Field(
        "gaussian", description="t5: Student's t with 5 degrees of freedom, of the same spread"
    )

    def noise(self) -> Noise:
        """As a plan has it."""
        return Noise(
            {DRIVES[name]: to_si(value, "%") for name, value in self.repeatability_pct.items()}, self.kind
        )


class PlanFile(Table):
    """A plan."""

    name: Text = Field("", description="shown on the sheet; the file's name if left out")
    seed: Seed = Field(0, description="settles the random order and the simulation")
    check_every: int = Field(5, ge=1, le=10_000, description="the end stop is looked for after so many steps")
    order: Order = Field(
        "as-written",
        description="random shuffles each session's configurations; the traverses of one stay together",
    )
    replicates: int = Field(
        1, ge=1, le=10_000, description="how often a session goes through the whole list of sweeps"
    )
    sessions: SessionsTable
    timing: TimingTable
    noise: Annotated[NoiseTable | None, BeforeValidator(lambda written: written or None)] = None
    sweep: Annotated[list[AnySweep], MinLen(1)]

    @model_validator(mode="after")
    def _few_enough(self) -> Self:
        total = sum(sweep.count() for sweep in self.sweep) * self.replicates * len(self.sessions.days())
        if total > MOST_TRAVERSES:
            advice = f"the plan makes {total:,} traverses; keep it to {MOST_TRAVERSES:,}"
            self.refuse([(advice, ["replicates"])])
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
        Naming every fault of the file with its key and value.

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
    return Plan(
        name=read.name or Path(path).stem,
        sessions=read.sessions.sessions(),
        traverses=traverses_of(read.sweep, machine),
        replicates=read.replicates,
        order=read.order,
        check_every=read.check_every,
        timing=read.timing.timing(),
        noise=read.noise.noise() if read.noise else None,
        seed=read.seed,
    )
