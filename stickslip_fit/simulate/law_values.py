"""What is true in a simulated campaign: the laws and the values of their parameters, from a TOML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
from annotated_types import MinLen
from pydantic import Field, create_model, model_validator

from stickslip_fit._toml import Quantity, Table, Text, chosen_by, read_toml
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Base, Elbow, Parameter, Prismatic, StepLaw
from stickslip_fit.logs.check import DIRECTIONS
from stickslip_fit.logs.sweep import JOINT, Joint
from stickslip_fit.machine import Machine
from stickslip_fit.simulate.law_causes import Causes, causes_of

Array = npt.NDArray[np.float64]
Group = tuple[int, str]
LARGEST_DAY_TO_DAY = 0.2  # beyond, a session's step sizes might come out negative


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
    """

    laws: Mapping[int, StepLaw]
    values: Mapping[tuple[int, str, str | None], Array]
    day_to_day: Mapping[Group, float] = field(default_factory=dict)

    def of_rows(self, rows: pd.DataFrame, joint: int) -> tuple[Array, npt.NDArray[np.bool_]]:
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
        way = (rows["direction"] == DIRECTIONS[1]).to_numpy().astype(int)
        nothing = np.full(len(self.laws[joint].parameters), np.nan)
        general = [self.values.get((joint, direction, None), nothing) for direction in DIRECTIONS]
        table = [
            [self.values.get((joint, direction, label), usual) for label in labels]
            for direction, usual in zip(DIRECTIONS, general, strict=True)
        ]
        own = [[(joint, direction, label) in self.values for label in labels] for direction in DIRECTIONS]
        values, shared = np.array(table)[way, session], ~np.array(own)[way, session]
        if np.isnan(values).any():
            row = rows.iloc[int(np.argmax(np.isnan(values).any(axis=1)))]
            raise InputError(
                f"joint {joint}, direction {row['direction']} has no parameters for session "
                f"{row['session']!r}; add a [[law]] for it to the law file"
            )
        return values, shared


def key_of(parameter: Parameter) -> str:
    """The TOML key of a parameter: its name with its unit, written once where the name ends in it.

    Examples
    --------
    >>> [key_of(parameter) for parameter in Prismatic.parameters]
    ['a_nm', 'b', 'c_nm']
    >>> [key_of(parameter) for parameter in Base.parameters]
    ['gamma0_reach_0_urad', 'gamma0_urad_per_mm', 'd_reach_0_urad', 'd_urad_per_mm']
    """
    (key,) = Quantity((parameter.unit,)).keys(_stem(parameter))
    return key


def _stem(parameter: Parameter) -> str:
    return parameter.name.removesuffix("_per_mm")


class LawTable(Table, extra="ignore"):
    """What each [[law]] must have; its parameters depend on the joint."""

    joint: Joint
    direction: Literal["+", "-"]
    session: Text = ""
    """The only one that has these parameters."""
    day_to_day: Annotated[float, Quantity(("%",), (0.0, LARGEST_DAY_TO_DAY))] = 0.0
    """Spread of the factor by which a session's step sizes differ; not with a session."""

    @model_validator(mode="after")
    def _days_are_of_all_sessions(self) -> Self:
        if self.session and "day_to_day" in self.fields_in_file():
            self.refuse(("is no key of this table of one session; leave it out", ("day_to_day_pct",)))
        return self

    def entry(self) -> tuple[int, str, str | None]:
        """What the parameters are of."""
        return self.joint, self.direction, self.session or None


def _of_joint(joint: int) -> type[LawTable]:
    fields: dict[str, Any] = {"joint": Annotated[Literal[joint], JOINT]}
    for each in LAWS[joint].parameters:
        quantity = Quantity((each.unit,), (each.lower, each.upper))
        fields[_stem(each)] = (Annotated[float, quantity], Field(description=each.meaning))
    return create_model(f"LawOfJoint{joint}", __base__=LawTable, __cls_kwargs__={"extra": "forbid"}, **fields)


LAWS: dict[int, type[StepLaw]] = {1: Base, 2: Elbow, 3: Prismatic}
AnyLaw = Annotated[LawTable, chosen_by("joint", {joint: _of_joint(joint) for joint in LAWS}, LawTable)]


class LawFile(Table):
    """Laws by joint and direction, and causes that extend them all."""

    law: Annotated[list[AnyLaw], MinLen(1)]
    cause: Causes = []

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        entries = [law.entry() for law in self.law]
        again = [number for number, entry in enumerate(entries) if entry in entries[:number]]
        advice = "an earlier [[law]] has this joint and direction; keep one of them"
        self.refuse(*((advice, ("law", number, "direction")) for number in again))
        return self


def read_law_values(path: str | Path, machine: Machine) -> LawValues:
    """Read and check a law file.

    Parameters
    ----------
    path : path
        A TOML file with the keys of `LawFile`. A [[law]] with a session gives that session's own parameters.
    machine : Machine

    Raises
    ------
    InputError
        With every fault of the file.
    """
    read = read_toml(path, LawFile, "law file")
    laws: dict[int, StepLaw] = {law.joint: law for law in (Base(machine), Elbow(machine), Prismatic())}
    causes, sizes = causes_of(read.cause)
    if causes:
        laws = {joint: ExtendedLaw(law, causes) for joint, law in laws.items()}
    values, day_to_day = {}, {}
    for law in read.law:
        own = [getattr(law, _stem(each)) for each in LAWS[law.joint].parameters]
        values[law.entry()] = np.array([*own, *sizes])
        if not law.session:
            day_to_day[law.joint, str(law.direction)] = law.day_to_day
    return LawValues(laws, values, day_to_day)
