"""The tables [[stage]], [[stage.schedule]] and [[column]] of a law file."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from annotated_types import Interval
from pydantic import BeforeValidator, Field, create_model, model_validator

from stickslip_fit._format import format_value
from stickslip_fit._toml import Give, Quantity, Text, TomlTable, chosen_by
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, InputIssue, suggest
from stickslip_fit.laws.physical import INERTIA, MAX_SHARE
from stickslip_fit.logs.plan_reader import JOINT, Joint
from stickslip_fit.logs.reader import DIRECTIONS
from stickslip_fit.logs.schema import ARM_FORMAT, COVARIATE_PREFIX, Condition
from stickslip_fit.simulation.schedule import (
    UNITS_OF,
    ByColumn,
    Course,
    QuantityName,
    Schedule,
    Since,
    WithUse,
)
from stickslip_fit.simulation.stage_law import MountedStage
from stickslip_fit.step import Stage
from stickslip_fit.step.stage_file import read_stage
from stickslip_fit.units import JOINTS, PRISMATIC, SUFFIXES, UNITS, to_si, unit_of_difference

MAX_DAY_TO_DAY = 0.2  # beyond, a session's step sizes might come out negative
DayToDay = Annotated[float, Quantity(("%",), (0.0, MAX_DAY_TO_DAY))]


_AMOUNT = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?) *(.*)")


def parse_quantity(entry: Any) -> tuple[float, str]:
    """Number and unit of a text such as "3 %"; a bare number has the unit 1.

    Examples
    --------
    >>> parse_quantity("-0.14 ms"), parse_quantity(3)
    ((-0.14, 'ms'), (3.0, '1'))
    """
    if type(entry) in (int, float) and abs(entry) <= sys.float_info.max:
        return float(entry), "1"
    match = _AMOUNT.fullmatch(entry.strip()) if isinstance(entry, str) else None
    if match is None:
        raise ValueError("no number")
    unit = match[2].replace("urad", "µrad").replace("^2", "²")
    return float(match[1]), unit or "1"


def _known_quantity(entry: Any) -> tuple[float, str]:
    number, unit = parse_quantity(entry)
    if unit not in UNITS or not np.isfinite(number):
        raise ValueError("no unit")
    return number, unit


def _amount(advice: str) -> Any:
    """The type of a number with its unit as text, which comes as both."""
    return Annotated[
        tuple[float, str] | None,
        BeforeValidator(_known_quantity, json_schema_input_type=str | float),
        Give(advice),
    ]


NONE = (0.0, "s")
WITH_UNIT = 'give a number with its unit in quotes, such as "45 %"; a column of your own has a bare number'


@dataclass(frozen=True)
class ColumnOfLog:
    """A column of a log by the name that a file gives it.

    Attributes
    ----------
    name : str
        In the package: ``humidity``, ``covariate:pressure_hPa``.
    unit : str
        Symbol; 1 for a column of the lab's own.
    limits : tuple of float
        Lowest and highest value, SI.
    """

    name: str
    unit: str
    limits: tuple[float, float]

    def parse(self, amount: tuple[float, str], is_difference: bool = False) -> float | None:
        """SI value of an amount; None in another unit than the column's."""
        number, unit = amount
        wanted = unit_of_difference(self.unit) if is_difference else self.unit
        alike = {"s": ("s", "ms"), "ms": ("s", "ms"), "g": ("g", "kg"), "kg": ("g", "kg")}
        return to_si(number, unit) if unit in alike.get(wanted, (wanted,)) else None


def column_of_log(written: str) -> ColumnOfLog | None:
    """The column that a log has under a name; None where no recorded number has it."""
    field = ARM_FORMAT.by_spelling.get(written)
    if isinstance(field, Condition):
        suffix = written.removeprefix(f"{field.stem}_")
        return ColumnOfLog(field.name, SUFFIXES[suffix], field.limits)
    stem = written.rpartition("_")[0] or written
    if field is not None or {stem, written} & {known.stem for known in ARM_FORMAT.fields}:
        return None
    return ColumnOfLog(COVARIATE_PREFIX + written, "1", (-np.inf, np.inf))


_CONDITIONS = [field for field in ARM_FORMAT.fields if isinstance(field, Condition)]
_KNOWN = [field.spellings[0] for field in _CONDITIONS]
COLUMN_ADVICE = f"give {', '.join(_KNOWN)}, or another name for a column of your own"


class ScheduleTable(TomlTable):
    """A change of one quantity of the stage; one of session, traverse, column and over says when."""

    quantity: QuantityName
    """`friction` is the coefficient, `voltage` sets the foot's travel, `payload` is a mass at the tip."""
    change: _amount('give a change with its unit in quotes, such as "-10 %", "5 g" or "0.01 ms"')  # type: ignore[valid-type]
    """A share of the stage's own value, or in its unit."""
    session: Text = ""
    """From this session on."""
    moment: _amount('give a time after the session\'s beginning, such as "40 min"') = None  # type: ignore[valid-type]
    """With `session`: after its first traverse."""
    traverse: Annotated[int | None, Interval(ge=1, le=5_000_000)] = None
    """From this traverse on, counted from 1 through the whole campaign, all joints together."""
    column: Text = ""
    """In proportion to a column, named as in a log."""
    at: _amount(WITH_UNIT) = None  # type: ignore[valid-type]
    """With `column`: where there is no change."""
    per: _amount(WITH_UNIT) = None  # type: ignore[valid-type]
    """With `column`: the change comes once for each of these above `at`."""
    over: _amount('give steps or a time, such as "50000 steps" or "20 min"') = None  # type: ignore[valid-type]
    """1 - exp(-n / over) of the change, n the joint's own steps so far (wear) or the session's time."""

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        number, unit = self.change
        units = UNITS_OF[self.quantity]
        relative = ("%",) if self.quantity != "payload" else ()
        if unit not in (*units, *relative):
            self.refuse((f"give a change in {' or '.join((*relative, *units))}", ("change",)))
        if unit == "%" and number <= -100:
            self.refuse(("give a change above -100 %", ("change",)))
        ways = {"session", "traverse", "column", "over"} & {*self.fields_in_file()}
        if len(ways) != 1:
            place = min(ways) if ways else "quantity"
            self.refuse(("give one of session, traverse, column, over to say when", (place,)))
        for name, wanted in {"moment": "session", "at": "column", "per": "column"}.items():
            if name in self.fields_in_file() and wanted not in ways:
                self.refuse((f"goes with {wanted}; leave it out", (name,)))
        self._check_column()
        if self.moment is not None and self.moment[1] not in ("s", "min", "h"):
            self.refuse(('give a time, such as "40 min"', ("moment",)))
        if self.over is not None and (self.over[1] not in ("steps", "s", "min", "h") or self.over[0] <= 0):
            self.refuse(('give steps or a time above 0, such as "50000 steps" or "20 min"', ("over",)))
        return self

    def _check_column(self) -> None:
        if not self.column:
            return
        column = column_of_log(self.column)
        if column is None:
            self.refuse((COLUMN_ADVICE + suggest(self.column, _KNOWN), ("column",)))
            return
        for name in ("at", "per"):
            amount = getattr(self, name)
            example = f"such as {_example(column, name == 'per')}"
            if amount is None:
                self.refuse((f"give {name} too, {example}", ("column",)))
            elif not (value := column.parse(amount, name == "per")) and (name == "per" or value is None):
                self.refuse((f"give a number in the column's unit, {example}", (name,)))

    def schedule(self) -> Schedule:
        """The schedule."""
        number, unit = self.change
        return Schedule(self.quantity, to_si(number, unit), unit == "%", self._course())

    def _course(self) -> Course:
        if self.session:
            return Since(session=self.session, moment=to_si(*(self.moment or NONE)))
        if self.traverse is not None:
            return Since(traverse=self.traverse)
        if self.over is not None:
            column: Literal["steps_before", "session_seconds"] = (
                "steps_before" if self.over[1] == "steps" else "session_seconds"
            )
            return WithUse(column, to_si(*self.over))
        column_read = column_of_log(self.column)
        assert column_read is not None
        at, per = column_read.parse(self.at or NONE), column_read.parse(self.per or NONE, True)
        assert at is not None
        assert per is not None
        return ByColumn(column_read.name, at, per)


def _example(column: ColumnOfLog, is_difference: bool) -> str:
    unit = unit_of_difference(column.unit) if is_difference else column.unit
    return "10" if unit == "1" else f'"10 {unit}"'


class StageTable(TomlTable, extra="ignore"):
    """A stage that drives a joint, in place of a [[law]]; further keys depend on the joint."""

    joint: Joint
    file: Text
    """Stage file, named from where this one lies; without gravity, force and drift."""
    direction: Literal["+", "-"] | None = None
    """Both if left out."""
    day_to_day: DayToDay = 0.0
    """Spread of the factor by which a session's step sizes differ."""
    schedule: list[ScheduleTable] = []
    """What changes."""

    @property
    def directions(self) -> tuple[str, ...]:
        """In which it drives the joint."""
        return DIRECTIONS if self.direction is None else (self.direction,)

    def mount(self, folder: Path, file: str, number: int) -> MountedStage:
        """The stage on its joint, of the table with this number; InputError where it cannot be there."""

        def refuse(message: str, key: str, value: str) -> InputError:
            return InputError(InputIssue(message, file, None, f"stage {number} {key}", value))

        stage = read_stage(folder / self.file)
        if stage.load:
            message = "has gravity or a force under [slider]; leave it out, for configurations give the load"
            raise refuse(message, "file", self.file)
        if stage.drift is not None:
            message = "has a [drift]; leave it out, and write what changes as [[stage.schedule]]"
            raise refuse(message, "file", self.file)
        if stage.drive.table is not None and any(each.quantity == "ramp time" for each in self.schedule):
            message = "has a waveform from a table, which has no ramp time to change; give a ramp_time"
            raise refuse(message, "file", self.file)
        return self._mounted(stage)

    def _mounted(self, stage: Stage) -> MountedStage:
        schedules = tuple(each.schedule() for each in self.schedule)
        if self.joint == PRISMATIC:
            return MountedStage(stage, schedules, recoil=getattr(self, "b"))  # noqa: B009
        radius, inertia, *shares = (getattr(self, name) for name in _ROTARY[self.joint])
        return MountedStage(stage, schedules, 0.0, radius, inertia, (shares[0], shares[1]))


_ROTARY = {
    1: ("radius", "inertia", "r_reach_0", "r_reach_full"),
    2: ("radius", "inertia", "r_q3_0", "r_q3_12"),
}
_ENDS = {
    "r_reach_0": "at no reach",
    "r_reach_full": "with the arm level and out",
    "r_q3_0": "with the arm in",
    "r_q3_12": "with the arm out",
}


def _of_joint(joint: int) -> type[StageTable]:
    fields: dict[str, Any] = {"joint": Annotated[Literal[joint], JOINT]}
    if joint == PRISMATIC:
        recoil = Annotated[float, Quantity(("1",), (-1.0, 0.99))]
        fields["b"] = (
            recoil,
            Field(0.0, description="Share of the step lost to recoil with the arm upright."),
        )
    else:
        radius, inertia, *shares = _ROTARY[joint]
        meaning = "Of the contact about the joint's axis: turns lengths into angles."
        fields[radius] = (Annotated[float, Quantity(("mm", "m"), (1e-4, 1.0))], Field(description=meaning))
        meaning = "Gained over the arm's range, as a share; the stage's mass is what moves at its beginning."
        fields[inertia] = (
            Annotated[float, Quantity(("1",), (INERTIA[0], 10.0))],
            Field(0.0, description=meaning),
        )
        for name in shares:
            share = Annotated[float, Quantity(("1",), (-MAX_SHARE, MAX_SHARE))]
            meaning = f"Torque of gravity at full load over that of friction, {_ENDS[name]}."
            fields[name] = (share, Field(description=meaning))
    return create_model(
        f"StageOfJoint{joint}", __base__=StageTable, __cls_kwargs__={"extra": "forbid"}, **fields
    )


AnyStage = Annotated[
    StageTable, chosen_by("joint", {joint: _of_joint(joint) for joint in JOINTS}, StageTable)
]


@dataclass(frozen=True)
class SimulatedColumn:
    """A column of the log that is drawn: a level for each session, and a wave within it.

    Attributes
    ----------
    column : str
        Its name in the package.
    mean, between_sessions, within_session : float
        Mean, and standard deviations, SI.
    limits : tuple of float
        What a log may have.

    Examples
    --------
    >>> humidity = SimulatedColumn("humidity", 0.45, 0.05, 0.02)
    >>> humidity.draw(seed=1, number=0, sessions=2, traverses=3).round(3)
    array([0.447, 0.493, 0.485, 0.495, 0.464, 0.447])
    """

    column: str
    mean: float
    between_sessions: float = 0.0
    within_session: float = 0.0
    limits: tuple[float, float] = (-np.inf, np.inf)

    def draw(self, seed: int, number: int, sessions: int, traverses: int) -> Array:
        """Values in order of time, shape (sessions * traverses,).

        Every session draws from its own stream, as in `draw_random`; `number` tells columns apart.

        Raises
        ------
        InputError
            For values that no log may have.
        """
        values = []
        for session in range(sessions):
            stream = np.random.SeedSequence(seed, spawn_key=(session, OTHER_STREAMS + number))
            rng = np.random.default_rng(stream)
            level = self.mean + self.between_sessions * rng.standard_normal()
            turns = np.arange(traverses) / traverses + rng.random()
            values.append(level + self.within_session * sqrt(2.0) * np.sin(2 * np.pi * turns))
        drawn = _as_read(np.concatenate(values), max(self.between_sessions, self.within_session))
        low, high = self.limits
        if drawn.min() < low or drawn.max() > high:
            unit = next((field.unit for field in _CONDITIONS if field.name == self.column), "1")
            ends = " to ".join(format_value(end, unit, 3) for end in (drawn.min(), drawn.max()))
            raise InputError(f"the column {self.column} comes out as {ends}; make it vary less")
        return drawn


OTHER_STREAMS = 4  # that a session's noise takes


def _as_read(values: Array, spread: float) -> Array:
    """As an instrument shows them, to about a hundredth of their spread."""
    return values.round(2 - int(np.floor(np.log10(spread)))) if spread > 0 else values


class ColumnTable(TomlTable):
    """A column that the log records: a level for each session, and a wave within it."""

    name: Text
    """As in a log: `humidity_pct`, `temperature_C`, `supply_V`, or one of your own."""
    mean: _amount(WITH_UNIT)  # type: ignore[valid-type]
    """Over all sessions."""
    between_sessions: _amount(WITH_UNIT) = None  # type: ignore[valid-type]
    """Standard deviation of the sessions' levels."""
    within_session: _amount(WITH_UNIT) = None  # type: ignore[valid-type]
    """Standard deviation of one wave through each session, with a phase of its own."""

    @model_validator(mode="after")
    def _in_its_unit(self) -> Self:
        column = column_of_log(self.name)
        if column is None or column.name == "step_period":
            self.refuse((COLUMN_ADVICE, ("name",)))
        assert column is not None
        for name in ("mean", "between_sessions", "within_session"):
            amount, differs = getattr(self, name), name != "mean"
            if amount is None:
                continue
            value = column.parse(amount, differs)
            if value is None or (differs and value < 0):
                self.refuse(
                    (f"give a number in the column's unit, such as {_example(column, differs)}", (name,))
                )
        return self

    def column(self) -> SimulatedColumn:
        """The column."""
        of = column_of_log(self.name)
        assert of is not None
        spreads = [self.between_sessions, self.within_session]
        sizes = [0.0 if each is None else of.parse(each, True) or 0.0 for each in spreads]
        return SimulatedColumn(of.name, of.parse(self.mean or NONE) or 0.0, sizes[0], sizes[1], of.limits)
