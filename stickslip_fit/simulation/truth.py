"""LawValues: the true laws, parameters and causes of a simulated campaign, read from a TOML file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pandas as pd
from pydantic import (
    BeforeValidator,
    Field,
    PlainValidator,
    PrivateAttr,
    WrapValidator,
    create_model,
    model_validator,
)

from stickslip_fit._format import format_value
from stickslip_fit._input import format_path
from stickslip_fit._toml import Give, Misfit, Quantity, Text, TomlTable, chosen_by, fault, read_toml
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes import Cause, CauseParameter, Covariate, ExtendedLaw, library
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Base, Elbow, Parameter, Prismatic, StepLaw
from stickslip_fit.laws.physical import Physical, PhysicalBase, PhysicalElbow, PhysicalPrismatic, Ratios
from stickslip_fit.logs.plan_reader import JOINT, Joint
from stickslip_fit.logs.reader import DIRECTIONS
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.machine import Machine
from stickslip_fit.simulation.stage_law import MountedStage, StageLaw
from stickslip_fit.simulation.stage_tables import (
    AnyStage,
    ColumnTable,
    DayToDay,
    SimulatedColumn,
    StageTable,
    parse_quantity,
)
from stickslip_fit.units import UNITS, to_si

DEFAULT_SETTINGS = {"half": "1 K"}  # of a nonlinear response; others do not use it


class CauseTable(TomlTable, extra="ignore"):
    """A cause, with its parameters and its other settings: the session of a jump, the form of a bend.

    A parameter is text with its unit, ``A = "3 %"``, or where each joint and direction has its own, a table
    of such, ``k = {"3+" = "2 %"}``.
    """

    name: Text
    """One of the library's, or ``covariate:`` and a column of the lab's own."""
    _cause: Any = PrivateAttr()

    def parse(self) -> tuple[Cause, list[float]]:
        """The cause, and the values of its parameters, SI."""
        names = [parameter.name for parameter in self._cause.parameters]
        values = {name: iter(getattr(self, name)) for name in names}
        cause = replace(self._cause, **{name: getattr(self, name) for name in _settings(self._cause)})
        return cause, [next(values[name]) for name in names]


def causes_of(tables: Sequence[CauseTable]) -> tuple[tuple[Cause, ...], Array]:
    """Causes, and the values of their parameters one after the other, SI, shape (q,)."""
    parsed = [table.parse() for table in tables]
    values = [value for _, sizes in parsed for value in sizes]
    return tuple(cause for cause, _ in parsed), np.array(values, dtype=float)


def _of_name(entry: Any, inner: Callable[[Any], CauseTable]) -> CauseTable:
    """The table with the fields of the cause that it names."""
    header = inner(entry)
    known = {cause.name: cause for cause in library()}
    if header.name.startswith(COVARIATE_PREFIX) and header.name != COVARIATE_PREFIX:
        known[header.name] = Covariate(header.name.removeprefix(COVARIATE_PREFIX))
    if header.name not in known:
        header.refuse((f"give one of {', '.join(known)}, {COVARIATE_PREFIX}COLUMN", ("name",)))
    cause: Any = known[header.name]
    form = entry.get("form") if isinstance(entry, Mapping) else None
    if form in cause.forms:  # which says what parameters it has
        cause = replace(cause, form=form)
    keys: dict[str, Any] = {
        name: _setting_field(cause, name, default) for name, default in _settings(cause).items()
    }
    for name in dict.fromkeys(parameter.name for parameter in cause.parameters):
        parameters = [parameter for parameter in cause.parameters if parameter.name == name]
        given = Give(f"give {_example_entry(parameters[0])}: {parameters[0].meaning}")
        keys[name] = (Annotated[Any, PlainValidator(partial(_sizes, parameters)), given], ...)
    model = create_model(cause.name, __base__=CauseTable, __cls_kwargs__={"extra": "forbid"}, **keys)
    table = model.model_validate(entry)
    table._cause = cause
    return table


Causes = list[Annotated[CauseTable, WrapValidator(_of_name)]]


def _settings(cause: Any) -> dict[str, str | float]:
    """A cause's settings beside its parameters, with their defaults."""
    defaults = {field.name: field.default for field in fields(cause) if field.name != "column"}
    return {name: value for name, value in defaults.items() if isinstance(value, str | float)}


def _setting_field(cause: Cause, name: str, default: str | float) -> tuple[Any, Any]:
    """The type and default of a setting; a number has no default but in `DEFAULT_SETTINGS`."""
    if isinstance(default, float):
        given = Give('give a number, with its unit where it has one, e.g. "21 °C"')
        number = _si(DEFAULT_SETTINGS[name]) if name in DEFAULT_SETTINGS else ...
        return Annotated[float, BeforeValidator(_si), given], number
    if name == "session" and "session" in cause.columns:
        return Annotated[Text, Give("give the session in which it happens, in quotes")], default or ...
    if forms := cause.forms:
        return Annotated[Literal[forms], Give(f"give one of {', '.join(forms)}")], default
    return Text, default


def _sizes(parameters: Sequence[CauseParameter], entry: Any) -> list[float]:
    """Values of the parameters of one key."""
    if parameters[0].joint is None or not isinstance(entry, dict):
        return [_size(parameter, entry) for parameter in parameters]
    by_key = {_scope(parameter): parameter for parameter in parameters}
    if not entry.keys() <= by_key.keys():
        joints = "joints and directions" if parameters[0].direction else "joints"
        raise fault(f"name {joints} as {', '.join(by_key)}")
    # It is 0 for joints and directions that are left out.
    return [_size(parameter, entry.get(key, 0.0)) for key, parameter in by_key.items()]


def _size(parameter: CauseParameter, entry: Any) -> float:
    (number, unit), wanted = parse_quantity(entry), parameter.unit
    if number and unit != wanted:
        raise ValueError("another unit")
    value = to_si(number, wanted)
    if not parameter.lower <= value <= parameter.upper:
        low, high = (format_value(end, wanted, 2) for end in (parameter.lower, parameter.upper))
        raise fault(f"lies outside what is possible, {low} to {high} (– for no limit)")
    return value


def _example_entry(parameter: CauseParameter) -> str:
    if parameter.unit == "1":
        return "a number"
    example = f'"2 {parameter.unit}"'
    if parameter.joint is None:
        return f"a number and its unit as text, e.g. {example}"
    each = "joint and direction" if parameter.direction else "joint"
    return f'a number and its unit as text for each {each}, e.g. {{"{_scope(parameter)}" = {example}}}'


def _scope(parameter: CauseParameter) -> str:
    """The key of a joint's or of a joint's and direction's own parameter."""
    return f"{parameter.joint}{parameter.direction or ''}"


def _si(entry: Any) -> float:
    number, unit = parse_quantity(entry)
    if unit not in UNITS:
        raise ValueError("no unit")
    return to_si(number, unit)


Group = tuple[int, str]
"""Joint and direction."""


@dataclass(frozen=True, eq=False)
class LawValues:
    """The laws of a campaign and their parameters.

    Attributes
    ----------
    laws : mapping of int to StepLaw
        One for each joint.
    values : mapping of (int, str, str or None) to array, shape (p,)
        Parameters, SI, of a joint, direction and session; without a session, of all sessions that have
        no entry of their own.
    day_to_day : mapping of (int, str) to float
        Standard deviation of the factor by which a session's step sizes differ from the values of all
        sessions. A session with an entry of its own has exactly that.
    columns : tuple of SimulatedColumn
        That the log records and a plan does not have.
    """

    laws: Mapping[int, StepLaw]
    values: Mapping[tuple[int, str, str | None], Array]
    day_to_day: Mapping[Group, float] = field(default_factory=dict)
    columns: tuple[SimulatedColumn, ...] = ()

    @property
    def has_stages(self) -> bool:
        """Whether a stage stands in place of any law."""
        laws = (law.law if isinstance(law, ExtendedLaw) else law for law in self.laws.values())
        return any(isinstance(law, StageLaw) for law in laws)

    def in_campaign(self, sessions: Sequence[str], traverses: int) -> LawValues:
        """The same in a campaign of these sessions, of so many traverses each.

        Raises
        ------
        InputError
            If a stage changes in a session or a traverse that is not planned.
        """

        def bind(law: StepLaw) -> StepLaw:
            if isinstance(law, ExtendedLaw):
                return ExtendedLaw(bind(law.law), law.causes)
            return law.bind(sessions, traverses) if isinstance(law, StageLaw) else law

        return replace(self, laws={joint: bind(law) for joint, law in self.laws.items()})

    def of_rows(self, rows: pd.DataFrame, joint: int) -> tuple[Array, BoolArray]:
        """The parameters of each row of one joint.

        Returns
        -------
        values : array, shape (n, p)
        shared : array of bool, shape (n,)
            Where they are those of all sessions, which change from day to day.

        Raises
        ------
        InputError
            If there are none for a row's joint, direction and session.
        """
        if joint not in self.laws:
            raise InputError(f"joint {joint} has no law; leave it out of the plan, or add it to the law file")
        session, labels = pd.factorize(rows["session"])
        direction_index = (rows["direction"] == DIRECTIONS[1]).to_numpy().astype(int)
        unknown = np.full(len(self.laws[joint].parameters), np.nan)
        table, is_own = [], []
        for direction in DIRECTIONS:
            default = self.values.get((joint, direction, None), unknown)
            table.append([self.values.get((joint, direction, label), default) for label in labels])
            is_own.append([(joint, direction, label) in self.values for label in labels])
        values = np.array(table)[direction_index, session]
        shared = ~np.array(is_own)[direction_index, session]
        if np.isnan(values).any():
            row = rows.iloc[int(np.argmax(np.isnan(values).any(axis=1)))]
            raise InputError(
                f"joint {joint}, direction {row['direction']} has no parameters for session "
                f"{row['session']!r}; add a [[law]] for it to the law file"
            )
        return values, shared


def _parameter_stem(parameter: Parameter) -> str:
    return parameter.name.removesuffix("_per_mm")


class LawTable(TomlTable, extra="ignore"):
    """What each [[law]] must have; its parameters depend on the joint."""

    joint: Joint
    direction: Literal["+", "-"]
    session: Text = ""
    """The only one that has these parameters."""
    day_to_day: DayToDay = 0.0
    """Spread of the factor by which a session's step sizes differ; not with a session."""

    @model_validator(mode="after")
    def _days_are_of_all_sessions(self) -> Self:
        if self.session and "day_to_day" in self.fields_in_file():
            self.refuse(("is no key of this table of one session; leave it out", ("day_to_day_pct",)))
        return self

    def entry(self) -> tuple[int, str, str | None]:
        """Joint, direction and session of the parameters; None for all sessions."""
        return self.joint, self.direction, self.session or None


def _of_joint(name: str, joint: int, law: type[StepLaw]) -> type[LawTable]:
    fields: dict[str, Any] = {"joint": Annotated[Literal[joint], JOINT]}
    for each in law.parameters:
        quantity = Quantity((each.unit,), (each.lower, each.upper))
        default = 0.0 if each.name in NO_EFFECT else ...
        fields[_parameter_stem(each)] = (
            Annotated[float, quantity],
            Field(default=default, description=each.meaning),
        )
    if issubclass(law, Physical):
        meaning = "foot's over friction's acceleration, D / (af T1²); one number for a direction"
        fields[LAMBDA] = (Annotated[float, Quantity(("1",), LAMBDA_LIMITS)], Field(description=meaning))
    return create_model(f"{name}{joint}", __base__=LawTable, __cls_kwargs__={"extra": "forbid"}, **fields)


LAMBDA, LAMBDA_LIMITS = "lambda", (0.01, 100.0)
NO_EFFECT = {"inertia"}  # parameters that may be left out
LAWS: dict[int, type[StepLaw]] = {1: Base, 2: Elbow, 3: Prismatic}
PHYSICAL_LAWS: dict[int, type[Physical]] = {1: PhysicalBase, 2: PhysicalElbow, 3: PhysicalPrismatic}
LAW_TABLES: dict[int | str, type[LawTable]] = {
    **{joint: _of_joint("LawOfJoint", joint, law) for joint, law in LAWS.items()},
    **{f"{LAMBDA} {joint}": _of_joint("PhysicalLaw", joint, law) for joint, law in PHYSICAL_LAWS.items()},
}


def _table_kind(written: Mapping[str, Any]) -> int | str | None:
    joint = written.get("joint")
    return f"{LAMBDA} {joint}" if LAMBDA in written else joint


AnyLaw = Annotated[LawTable, chosen_by(_table_kind, LAW_TABLES, LawTable)]


class LawFile(TomlTable):
    """Laws or stages by joint and direction, causes that extend them all, and columns of the log."""

    law: list[AnyLaw] = []
    stage: list[AnyStage] = []
    cause: Causes = []
    column: list[ColumnTable] = []

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        if not self.law and not self.stage:
            self.refuse(("give at least one table [[law]] or [[stage]]", ("law",)))
        advice = "an earlier [[law]] has this joint and direction; keep one of them"
        entries = [law.entry() for law in self.law]
        again = [number for number, entry in enumerate(entries) if entry in entries[:number]]
        self.refuse(*((advice, ("law", number, "direction")) for number in again))
        self.refuse(*self._lambda_misfits())
        self.refuse(*self._stage_misfits())
        return self

    def _lambda_misfits(self) -> Iterator[Misfit]:
        physical, ratios = dict[int, bool](), dict[Group, float]()
        for number, law in enumerate(self.law):
            ratio = getattr(law, LAMBDA, None)
            if physical.setdefault(law.joint, ratio is not None) != (ratio is not None):
                other = "without" if ratio is not None else "with"
                advice = f"an earlier [[law]] of joint {law.joint} is {other} lambda; write all of them alike"
                yield advice, ("law", number, LAMBDA if ratio is not None else "joint")
            elif ratio is not None and ratios.setdefault((law.joint, law.direction), ratio) != ratio:
                advice = "an earlier [[law]] of this joint and direction has another lambda; it is one number"
                yield advice, ("law", number, LAMBDA)

    def ratios(self) -> dict[int, Ratios]:
        """By joint of physical laws, lambda in `+` and in `-`; a direction without one has the other's."""
        given: dict[int, dict[str, float]] = {}
        for law in self.law:
            if (ratio := getattr(law, LAMBDA, None)) is not None:
                given.setdefault(law.joint, {})[law.direction] = ratio
        return {
            joint: (own.get("+", own.get("-", 0.0)), own.get("-", own.get("+", 0.0)))
            for joint, own in given.items()
        }

    def _stage_misfits(self) -> Iterator[Misfit]:
        with_law, taken = {law.joint for law in self.law}, set[Group]()
        for number, stage in enumerate(self.stage):
            own = {(stage.joint, direction) for direction in stage.directions}
            if stage.joint in with_law:
                yield f"joint {stage.joint} has a [[law]] too; keep one of them", ("stage", number, "joint")
            elif own & taken:
                advice = "an earlier [[stage]] has this joint and direction; keep one of them"
                yield advice, ("stage", number, "joint")
            taken |= own
        names = [column.name for column in self.column]
        for number, name in enumerate(names):
            if name in names[:number]:
                yield "an earlier [[column]] has this name; keep one of them", ("column", number, "name")


def read_law_values(path: str | Path, machine: Machine) -> LawValues:
    """Read and check a law file.

    Parameters
    ----------
    path : path
        A TOML file with the keys of `LawFile`. A [[law]] with lambda is a physical one, whose parameters
        are those of `laws.physical`. A [[law]] with a session gives that session's own parameters; the stage
        files that it names are read too.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    read = read_toml(path, LawFile, "law file")
    laws: dict[int, StepLaw] = {law.joint: law for law in (Base(machine), Elbow(machine), Prismatic())}
    laws |= {joint: _physical_law(joint, machine, ratios) for joint, ratios in read.ratios().items()}
    parameters = {joint: law.parameters for joint, law in laws.items()}
    laws |= _stage_laws(read.stage, Path(path), machine)
    causes, sizes = causes_of(read.cause)
    if causes:
        laws = {joint: ExtendedLaw(law, causes) for joint, law in laws.items()}
    values: dict[tuple[int, str, str | None], Array] = {}
    day_to_day: dict[Group, float] = {}
    for law in read.law:
        own = [getattr(law, _parameter_stem(each)) for each in parameters[law.joint]]
        values[law.entry()] = np.array([*own, *sizes])
        if not law.session:
            day_to_day[law.joint, str(law.direction)] = law.day_to_day
    for stage in read.stage:
        values |= {(stage.joint, direction, None): sizes for direction in stage.directions}
        day_to_day |= {(stage.joint, direction): stage.day_to_day for direction in stage.directions}
    return LawValues(laws, values, day_to_day, tuple(table.column() for table in read.column))


def _physical_law(joint: int, machine: Machine, ratios: Ratios) -> Physical:
    if joint == PhysicalPrismatic.joint:
        return PhysicalPrismatic(ratios)
    return PhysicalElbow(machine, ratios) if joint == PhysicalElbow.joint else PhysicalBase(machine, ratios)


def _stage_laws(tables: Sequence[StageTable], path: Path, machine: Machine) -> dict[int, StageLaw]:
    stages: dict[int, dict[str, MountedStage]] = {}
    for number, table in enumerate(tables, start=1):
        mounted = table.mount(path.parent, format_path(path), number)
        stages.setdefault(table.joint, {}).update(dict.fromkeys(table.directions, mounted))
    return {joint: StageLaw(joint, own, machine) for joint, own in stages.items()}
