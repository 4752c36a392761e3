"""What is true in a simulated campaign: the laws and the values of their parameters, from a TOML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Base, Elbow, Parameter, Prismatic, StepLaw
from stickslip_fit.logs.check import DIRECTIONS
from stickslip_fit.logs.settings import Settings, read_settings, spelling
from stickslip_fit.machine import JOINTS, Machine
from stickslip_fit.simulate.law_causes import read_causes

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


def read_law_values(path: str | Path, machine: Machine) -> LawValues:
    """Read and check a law file.

    Parameters
    ----------
    path : path
        A TOML file with one [[law]] table for each joint and direction: joint, direction, every parameter
        of the joint's law under `key_of` its name, day_to_day_pct (0 without it). One with a session
        besides gives that session's own parameters. [[cause]] tables, see `read_causes`, extend all laws.
    machine : Machine

    Raises
    ------
    InputError
        Naming every fault of the file with its key and value.
    """
    settings = read_settings(path)
    laws: dict[int, StepLaw] = {law.joint: law for law in (Base(machine), Elbow(machine), Prismatic())}
    values: dict[tuple[int, str, str | None], Array] = {}
    day_to_day: dict[Group, float] = {}
    for table in settings.tables("law"):
        joint, direction = table.choice("joint", JOINTS, None), table.choice("direction", DIRECTIONS, None)
        session = table.text("session", "") if "session" in table.content else None
        if joint is None or direction is None:
            continue
        if (joint, direction, session) in values:
            table.complain("direction", "an earlier [[law]] has this joint and direction; keep one of them")
        read = [_parameter(table, parameter) for parameter in laws[joint].parameters]
        values[joint, direction, session] = np.array(read)
        if session is None:
            day_to_day[joint, direction] = table.number("day_to_day", ("%",), (0.0, LARGEST_DAY_TO_DAY), 0.0)
        table.reject_unknown()
    causes, sizes = read_causes(settings)
    settings.reject_unknown()
    settings.finish()
    if causes:
        laws = {joint: ExtendedLaw(law, causes) for joint, law in laws.items()}
        values = {key: np.append(own, sizes) for key, own in values.items()}
    return LawValues(laws, values, day_to_day)


def key_of(parameter: Parameter) -> str:
    """The TOML key of a parameter: its name with its unit, written once where the name ends in it.

    Examples
    --------
    >>> [key_of(parameter) for parameter in Prismatic.parameters]
    ['a_nm', 'b', 'c_nm']
    >>> [key_of(parameter) for parameter in Base.parameters]
    ['gamma0_reach_0_urad', 'gamma0_urad_per_mm', 'd_reach_0_urad', 'd_urad_per_mm']
    """
    return spelling(_stem(parameter), parameter.unit)


def _stem(parameter: Parameter) -> str:
    return parameter.name.removesuffix("_per_mm")


def _parameter(table: Settings, parameter: Parameter) -> float:
    return table.number(_stem(parameter), (parameter.unit,), (parameter.lower, parameter.upper))
