"""The columns of a campaign log: which quantity a column's name stands for, and in which unit."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from stickslip_fit.logs.faults import Faults
from stickslip_fit.units import SUFFIXES

ANGLE = ("deg", "rad")
LENGTH = ("mm", "m", "um", "nm")


@dataclass(frozen=True)
class Field:
    """One quantity of the format.

    Attributes
    ----------
    name : str
        Inside the program.
    stem : str
        In a file, without its unit.
    suffixes : tuple of str
        Units it may be written in, the usual one first; none for text and counts.
    required : bool
    """

    name: str
    stem: str
    suffixes: tuple[str, ...] = ()
    required: bool = False

    @property
    def spellings(self) -> tuple[str, ...]:
        """Column names that stand for it, the usual one first."""
        return tuple(f"{self.stem}_{suffix}" for suffix in self.suffixes) or (self.stem,)


@dataclass(frozen=True)
class Condition(Field):
    """What the room or the drive is like in a traverse, as far as a log says it.

    Attributes
    ----------
    label : str
        As sentences have it.
    beyond : float
        How far one may go beyond a log in which it never changed, SI.
    fault : str
        What is wrong with a value that is not above 0, SI; empty where any value will do.
    """

    label: str = ""
    beyond: float = 0.0
    fault: str = ""

    @property
    def unit(self) -> str:
        """Symbol of the usual unit."""
        return SUFFIXES[self.suffixes[0]]

    @property
    def axis(self) -> str:
        """As the axis of a figure has it, with its unit."""
        return f"{self.stem.replace('_', ' ')} ({self.unit})"


FIELDS = (
    Field("session", "session", required=True),
    Field("time", "time", required=True),
    Field("joint", "joint", required=True),
    Field("direction", "direction", required=True),
    Field("steps", "steps", required=True),
    Field("q1", "q1", ANGLE, required=True),
    Field("q2", "q2", ANGLE, required=True),
    Field("q3", "q3", LENGTH, required=True),
    Field("theta", "theta", ANGLE, required=True),
    Field("psi", "psi", ANGLE, required=True),
    Field("from_angle", "from", ANGLE),
    Field("to_angle", "to", ANGLE),
    Field("from_length", "from", LENGTH),
    Field("to_length", "to", LENGTH),
    Field("check_every", "check_every"),
    Field("status", "status"),
    Condition(
        "temperature", "temperature", ("C", "K"), label="ambient temperature", beyond=5.0,
        fault="is at or below absolute zero; correct it, or the column's unit",
    ),
    Condition("humidity", "humidity", ("pct",), label="relative humidity", beyond=0.2),
    Condition("supply", "supply", ("V",), label="supply voltage", beyond=2.0),
    Condition(
        "step_period", "step_period", ("ms", "s"), label="step period", beyond=0.005,
        fault="is no period; write a time above 0",
    ),
    Condition("payload", "payload", ("g", "kg"), label="payload", beyond=0.02),
    Field("note", "note"),
)  # fmt: skip
# What an empty cell means.
CHECK_EVERY = 5
CONDITIONS = {field.name: field for field in FIELDS if isinstance(field, Condition)}
COVARIATE = "covariate:"  # begins the names of the lab's own columns that hold numbers

CONDITION_SPELLINGS = {
    f"{condition.stem}_{suffix}": (condition.name, SUFFIXES[suffix])
    for condition in CONDITIONS.values()
    for suffix in condition.suffixes
}
_BY_SPELLING = {spelling: field for field in FIELDS for spelling in field.spellings}
_COUNTS = ("joint", "steps", "check_every")
_WITH_UNIT = {field.stem for field in FIELDS if field.suffixes}
_UNNAMED = "has no name; give it one, or delete the column"
# What pandas adds to a Parquet file to remember its row labels: bookkeeping, not a measurement.
_ROW_LABELS = re.compile(r"__index_level_\d+__")


@dataclass(frozen=True)
class Column:
    """A column of a file and the unit its numbers are in (a symbol of `units.UNITS`)."""

    name: str
    unit: str = "1"


@dataclass(frozen=True)
class Layout:
    """What the columns of one file stand for.

    Attributes
    ----------
    known : dict of str to Column
        Field name to column.
    others : tuple of str
        The lab's own columns.
    notes : tuple of str
        What a person should know about the columns.
    """

    known: dict[str, Column]
    others: tuple[str, ...]
    notes: tuple[str, ...]


def lay_out(names: tuple[str, ...], file: str, line: int | None, faults: Faults) -> Layout:
    """Say what each column of a file stands for.

    Parameters
    ----------
    names : tuple of str
        The header, as it stands in the file.
    file : str
    line : int, optional
        Line of the header.
    faults : Faults
        Told of missing, doubled, unnamed and unit-less columns.

    Examples
    --------
    >>> layout = lay_out(("theta_rad", "pressure_hPa"), "day.csv", 1, Faults())
    >>> layout.known["theta"], layout.others
    (Column(name='theta_rad', unit='rad'), ('pressure_hPa',))
    """
    known: dict[str, Column] = {}
    others: list[str] = []
    notes: list[str] = []
    meant: set[str] = set()
    for name, times in Counter(name for name in names if name.strip()).items():
        field = _BY_SPELLING.get(name)
        fault = _doubled(times) or fault_of_name(name)
        if fault:
            faults.place(file, fault, line=line, column=name)
            meant |= _stem_fields(name)
        elif _ROW_LABELS.fullmatch(name):
            notes.append(f"{file}: column {name} holds pandas' row labels and is left out")
        elif field is None:
            others.append(name)
        elif field.name in known:
            fault = f"is a second column for {field.stem}, beside {known[field.name].name}; keep one of them"
            faults.place(file, fault, line=line, column=name)
        else:
            known[field.name] = Column(name, _unit(name, field))
    unnamed = [position for position, name in enumerate(names, start=1) if not name.strip()]
    faults.lines(file, [(line, f"number {position}", None, _UNNAMED) for position in unnamed])
    for field in FIELDS:
        if field.required and field.name not in known and field.name not in meant:
            message = f"is missing; every log needs it{_hint(field, others)}"
            faults.place(file, message, line=line, column=field.spellings[0])
    notes += _lookalikes(file, known, others)
    return Layout(known, tuple(others), tuple(notes))


def holds_numbers(name: str) -> bool:
    """Say whether a name is a column of the format that holds numbers."""
    field = _BY_SPELLING.get(name)
    return field is not None and (bool(field.suffixes) or field.name in _COUNTS)


def is_known(name: str) -> bool:
    """Say whether a name is a column of the format."""
    return name in _BY_SPELLING


def _unit(name: str, field: Field) -> str:
    return SUFFIXES[name.removeprefix(f"{field.stem}_")] if field.suffixes else "1"


def _doubled(times: int) -> str | None:
    return f"stands {times} times in the header; rename or delete all but one" if times > 1 else None


def fault_of_name(name: str) -> str | None:
    """What is wrong with the unit of a column's name, if anything.

    Examples
    --------
    >>> fault_of_name("temperature")
    'has no unit; write temperature_C or temperature_K'
    """
    if name in _BY_SPELLING:
        return None
    stem, _, suffix = name.rpartition("_")
    if name in _WITH_UNIT:
        return f"has no unit; write {_choices(name)}"
    if stem in _WITH_UNIT:
        return f"{suffix!r} is no unit of {stem}; write {_choices(stem)}"
    return None


def _choices(stem: str) -> str:
    spellings = [spelling for spelling, field in _BY_SPELLING.items() if field.stem == stem]
    return " or ".join([", ".join(spellings[:-1])] * (len(spellings) > 1) + spellings[-1:])


def _stem_fields(name: str) -> set[str]:
    """Fields that a column with a faulty name was meant to be, so that they aren't called missing too."""
    return {field.name for field in FIELDS if field.stem in (name, name.rpartition("_")[0])}


def _hint(field: Field, others: list[str]) -> str:
    for other in others:
        if _meant(other) is field:
            return f" (found {other!r}: write {_spelling(other, field)})"
    return ""


def _lookalikes(file: str, known: dict[str, Column], others: list[str]) -> list[str]:
    """Optional columns that are written almost as the format has them: kept literally, but not silently."""
    notes = []
    for other in others:
        field = _meant(other)
        if field and not field.required and field.name not in known:
            spelling = _spelling(other, field)
            notes.append(
                f"{file}: column {other!r} is kept as the lab's own; if it is {spelling}, write it so"
            )
    return notes


def _meant(name: str) -> Field | None:
    plain = _plain(name)
    for spelling, field in _BY_SPELLING.items():
        if plain in (_plain(spelling), field.stem):
            return field
    return None


def _spelling(name: str, field: Field) -> str:
    alike = [spelling for spelling in field.spellings if _plain(spelling) == _plain(name)]
    return (alike or list(field.spellings))[0]


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
