"""A law of one's own as a TOML file: the formula, what its names are, causes, and the roles of columns.

::

    formula = "F ~ M*acc + Fv*vel + Fc*sign(vel) + offset"

    [units]
    F = "N"
    M = "kg"
    Fv = "N s/m"

    [[cause]]
    name = "viscous-by-direction"
    formula = "+ dFv*abs(vel)"
    parameters = "dFv in N s/m"

    [roles]
    time = "t"
    direction = "way"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field

from stickslip_fit._input import format_path
from stickslip_fit._toml import Give, Text, TomlTable, read_toml
from stickslip_fit.causes.formula import FormulaCause
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws import Law

NUMBER = Give("give a number")
Ends = Annotated[list[float], Len(2, 2)]


class CauseEntry(TomlTable):
    """A cause of one's own; see `ssf.Cause`."""

    name: Annotated[Text, Give("give the cause a name")]
    formula: Annotated[Text, Give("begin with + (adds), * (multiplies) or 'column =' (in its place)")]
    parameters: Annotated[Text, Give('name each parameter with its unit, e.g. "A in %, tau in min"')]
    by: Annotated[str, Give("name a column: one set of parameters for each of its values")] = ""
    bounds: Annotated[dict[str, Ends], Give("give the lowest and the highest value, e.g. tau = [1, 60]")] = (
        Field(default_factory=dict)
    )
    size: Annotated[float | None, NUMBER] = None
    phrase: Annotated[str, Give("say in a few words what is the matter")] = ""
    remedy: Annotated[str, Give("say in a few words what cures it")] = ""
    shows_best: Annotated[str, Give("say in which data it shows best")] = ""


class LawEntries(TomlTable):
    """The file as a whole."""

    formula: Annotated[Text, Give('write the response, ~ and its law, e.g. "F ~ Fv*vel + offset"')]
    name: Annotated[str, Give("name the law")] = ""
    units: Annotated[dict[str, str], Give('give units of columns and parameters, e.g. F = "N"')] = Field(
        default_factory=dict
    )
    bounds: Annotated[dict[str, Ends], Give("give the lowest and the highest value, e.g. Fv = [0, 10]")] = (
        Field(default_factory=dict)
    )
    start: Annotated[dict[str, float], Give("give a number for each parameter")] = Field(default_factory=dict)
    shared: Annotated[
        list[str] | Literal["all"], Give('name the parameters that all sessions share, or "all"')
    ] = Field(default_factory=list)
    cause: Annotated[list[CauseEntry], Give("write each cause as a table [[cause]]")] = Field(
        default_factory=list
    )
    roles: Annotated[
        dict[Literal["session", "time", "position", "direction", "group"], str],
        Give("name columns for session, time, position, direction or group"),
    ] = Field(default_factory=dict)


@dataclass(frozen=True)
class TableLawFile:
    """A law, causes of one's own, and the column of each role that the file names."""

    law: Law
    causes: tuple[FormulaCause, ...] = ()
    roles: Mapping[str, str] = field(default_factory=dict)


def read_law_file(path: str | Path) -> TableLawFile:
    """Read a law, its causes and the roles of columns from a TOML file.

    Raises
    ------
    InputError
        If the file cannot be read, has keys that a law file has not, or formulas that cannot be read.
    """
    entries = read_toml(path, LawEntries, "law (TOML)")
    name, issues, causes = format_path(path), [], []
    try:
        law = Law(
            entries.formula,
            units=entries.units,
            bounds={one: (low, high) for one, (low, high) in entries.bounds.items()},
            start=entries.start,
            shared=entries.shared if isinstance(entries.shared, str) else tuple(entries.shared),
            name=entries.name,
        )
    except InputError as error:
        issues += [InputIssue(str(issue), name) for issue in error.problems]
    for entry in entries.cause:
        try:
            causes.append(
                FormulaCause(
                    entry.name,
                    entry.formula,
                    entry.parameters,
                    by=entry.by,
                    bounds={one: (low, high) for one, (low, high) in entry.bounds.items()},
                    size=entry.size,
                    phrase=entry.phrase,
                    remedy=entry.remedy,
                    shows_best=entry.shows_best,
                )
            )
        except InputError as error:
            issues += [InputIssue(str(issue), name) for issue in error.problems]
    if issues:
        raise InputError(issues)
    return TableLawFile(law, tuple(causes), {role: column for role, column in entries.roles.items()})
