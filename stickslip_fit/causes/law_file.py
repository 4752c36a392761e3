"""read_law_file: laws of one's own and causes as formulas, and the roles of a table's columns, from TOML.

Formulas only: no file names a Python function, so that reading one runs nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from stickslip_fit._toml import Give, Misfit, Text, TomlTable, read_toml
from stickslip_fit.causes.formula import FormulaCause
from stickslip_fit.errors import InputError
from stickslip_fit.laws import Law

_End = Annotated[float, Field(allow_inf_nan=True)]
_Units = Annotated[dict[str, str], Give('give units as text, e.g. M = "kg"')]
_Bounds = Annotated[dict[str, list[_End]], Give("give a lower and an upper bound, e.g. tau = [1, inf]")]
_Start = Annotated[dict[str, float], Give("give numbers, e.g. tau = 10")]
_Size = Annotated[dict[str, float], Give("give numbers, e.g. size = { A = 1 }")]
_Shared = Annotated[list[str] | str, Give('give a list of parameters, or "all"')]


class FormulaLawTable(TomlTable):
    """A law as a formula, and what is known of its names."""

    formula: Text | None = None
    """As in "F ~ M*acc + Fv*vel"; of a joint "gamma ~ a - c*load"."""
    name: str = ""
    units: _Units = {}
    """Of columns and parameters."""
    bounds: _Bounds = {}
    """Lower and upper bound of a parameter; inf and -inf for none."""
    start: _Start = {}
    """Where the search for a parameter begins."""
    shared: _Shared = []
    """Parameters with one value for the whole table."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.formula is not None:
            _refuse_faults(self, self.law)
        return self

    def law(self) -> Law:
        """The law; InputError where there is none to be read."""
        bounds: dict[str, Any] = {  # the law checks that there are two
            name: tuple(end if abs(end) < float("inf") else None for end in ends)
            for name, ends in self.bounds.items()
        }
        shared = self.shared if isinstance(self.shared, str) else tuple(self.shared)
        return Law(
            str(self.formula),
            units=self.units,
            bounds=bounds,
            start=self.start,
            shared=shared,
            name=self.name,
        )


class FormulaCauseTable(TomlTable):
    """A cause as a formula."""

    name: Text
    formula: Text
    """As in "+ dFv*abs(vel)" or "* (1 + k*(T - 293))"."""
    parameters: Text
    """With their units: "A in %, tau in min"."""
    by: str = ""
    """A column: one set of parameters for each of its values."""
    bounds: _Bounds = {}
    """Of parameters that enter nonlinearly, in their units."""
    size: _Size = {}
    """Sizes that matter, in the parameters' units."""
    phrase: str = ""
    physics: str = ""
    sentence: str = ""
    remedy: str = ""
    shows_best: str = ""
    joints: Annotated[list[int], Give("give joints, e.g. joints = [1, 2]")] = []
    """Of a log, on which it acts; all by default."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        _refuse_faults(self, self.cause)
        return self

    def cause(self) -> FormulaCause:
        """The cause."""
        words = ("by", "phrase", "physics", "sentence", "remedy", "shows_best")
        more: dict[str, Any] = {word: getattr(self, word) for word in words}
        more |= {"bounds": dict(self.bounds), "size": self.size or None, "joints": tuple(self.joints)}
        return FormulaCause(self.name, self.formula, self.parameters, **more)


class RolesTable(TomlTable):
    """What columns of a table are."""

    session: Text | None = None
    time: Text | None = None
    position: Text | None = None
    direction: Text | None = None
    group: Text | None = None
    sigma: Text | None = None


class FormulaFile(FormulaLawTable):
    """A file of formulas: a law of a table, or of the joints of a log; causes; roles of columns."""

    cause: list[FormulaCauseTable] = []
    roles: RolesTable
    joint: Annotated[dict[str, FormulaLawTable], Give("write it as tables: [joint.1], [joint.2]")] = {}

    @model_validator(mode="after")
    def _check_joints(self) -> Self:
        faults: list[Misfit] = []
        for key, table in self.joint.items():
            if not (key.isdecimal() and int(key) > 0):
                faults.append(("name a joint by its number: [joint.2]", ("joint", key)))
            elif table.formula is None:
                faults.append(('give its formula, e.g. "gamma ~ a - c*load"', ("joint", key)))
        if self.formula is None and not self.joint:
            faults.append(
                ('give a formula, e.g. "F ~ a + b*x", or one for each joint in [joint.1]', ("formula",))
            )
        self.refuse(*faults)
        return self


@dataclass(frozen=True)
class LawsAndCauses:
    """What a file of formulas holds.

    Attributes
    ----------
    law : Law or None
        Of a table.
    laws : mapping of int to Law
        Of a log's joints.
    causes : tuple of FormulaCause
    roles : mapping of str to str
        Columns by role: session, time, position, direction, group.
    """

    law: Law | None
    laws: Mapping[int, Law]
    causes: tuple[FormulaCause, ...]
    roles: Mapping[str, str]


def read_law_file(path: str | Path) -> LawsAndCauses:
    """Read a TOML file with the keys of `FormulaFile`.

    Raises
    ------
    InputError
        With every fault: file, line, key, value, and what to do.
    """
    content = read_toml(path, FormulaFile, "law file")
    roles = {name: getattr(content.roles, name) for name in RolesTable.model_fields}
    return LawsAndCauses(
        law=None if content.formula is None else content.law(),
        laws={int(joint): table.law() for joint, table in content.joint.items()},
        causes=tuple(table.cause() for table in content.cause),
        roles={name: column for name, column in roles.items() if column is not None},
    )


def _refuse_faults(table: TomlTable, build: Any) -> None:
    """Refuse a table whose content cannot be used, at the formula."""
    try:
        build()
    except InputError as error:
        table.refuse(*[(problem.message, ("formula",)) for problem in error.problems])
