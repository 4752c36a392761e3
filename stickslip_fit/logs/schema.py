"""The columns of the log format, and the reading of a file's columns into SI arrays.

`FIELDS` lists every quantity with the units that its column name may end in; `CONDITIONS` are those
recorded beside positions and steps. Numeric columns that the format does not know become covariates.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, pi
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa

from stickslip_fit._typing import Array, BoolArray, Int64Array
from stickslip_fit.errors import InputError
from stickslip_fit.logs._table import (
    MAX_COLUMNS,
    FileTable,
    IssueCollector,
    IssueMessage,
    ParsedTimes,
    is_filled,
    parse_choices,
    parse_numbers,
    parse_times,
    to_text,
)
from stickslip_fit.machine import Machine
from stickslip_fit.units import SUFFIXES, from_si, to_si

ANGLE_SUFFIXES = ("deg", "rad")
LENGTH_SUFFIXES = ("mm", "m", "um", "nm")


@dataclass(frozen=True)
class Field:
    """A quantity of the format: its name in the package, and the stem of its column with the unit suffixes.

    The usual suffix is the first; text and counts have none. `limits` are lowest and highest value, SI, far
    beyond what any lab has; positions have the machine's ranges instead.
    """

    name: str
    stem: str
    suffixes: tuple[str, ...] = ()
    required: bool = False
    limits: tuple[float, float] = (-inf, inf)

    @property
    def spellings(self) -> tuple[str, ...]:
        """Column names that stand for it, the usual one first."""
        return tuple(f"{self.stem}_{suffix}" for suffix in self.suffixes) or (self.stem,)


@dataclass(frozen=True)
class Condition(Field):
    """A recorded condition of a traverse, of the room or the drive; all that is specific to it is here.

    Attributes
    ----------
    label : str
        In a sentence.
    beyond : float
        How far beyond a log in which it is constant it may vary, SI.
    """

    label: str = ""
    beyond: float = 0.0

    @property
    def unit(self) -> str:
        """Symbol of the usual unit."""
        return SUFFIXES[self.suffixes[0]]

    @property
    def axis(self) -> str:
        """Label of a figure's axis."""
        return f"{self.stem.replace('_', ' ')} ({self.unit})"


MAX_STEPS = 10**12  # more than a drive steps in thirty years; sums over any log stay within 64 bits
_TURNS = (-20 * pi, 20 * pi)
FIELDS = (
    Field("session", "session", required=True),
    Field("time", "time", required=True),
    Field("joint", "joint", required=True, limits=(1, 3)),
    Field("direction", "direction", required=True),
    Field("steps", "steps", required=True, limits=(1, MAX_STEPS)),
    Field("q1", "q1", ANGLE_SUFFIXES, required=True),
    Field("q2", "q2", ANGLE_SUFFIXES, required=True),
    Field("q3", "q3", LENGTH_SUFFIXES, required=True),
    Field("theta", "theta", ANGLE_SUFFIXES, required=True, limits=_TURNS),
    Field("psi", "psi", ANGLE_SUFFIXES, required=True, limits=_TURNS),
    Field("from_angle", "from", ANGLE_SUFFIXES),
    Field("to_angle", "to", ANGLE_SUFFIXES),
    Field("from_length", "from", LENGTH_SUFFIXES),
    Field("to_length", "to", LENGTH_SUFFIXES),
    Field("check_every", "check_every", limits=(1, MAX_STEPS)),
    Field("status", "status"),
    Condition(
        "temperature",
        "temperature",
        ("C", "K"),
        limits=(0.001, 1000.0),
        label="ambient temperature",
        beyond=5.0,
    ),
    # Sensors read a little below 0 and above 100 %.
    Condition("humidity", "humidity", ("pct",), limits=(-0.1, 1.2), label="relative humidity", beyond=0.2),
    Condition("supply", "supply", ("V",), limits=(-1e4, 1e4), label="supply voltage", beyond=2.0),
    Condition(
        "step_period", "step_period", ("ms", "s"), limits=(1e-9, 3600.0), label="step period", beyond=0.005
    ),
    Condition("payload", "payload", ("g", "kg"), limits=(0.0, 100.0), label="payload", beyond=0.02),
    Field("note", "note"),
)


@dataclass(frozen=True)
class LogFormat:
    """The quantities of a machine's logs, or of another `kind` of list, and how their columns are spelt."""

    fields: tuple[Field, ...]
    kind: str = "log"

    @cached_property
    def by_name(self) -> dict[str, Field]:
        """Each quantity by its name in the package."""
        return {field.name: field for field in self.fields}

    @cached_property
    def by_spelling(self) -> dict[str, Field]:
        """Each quantity by the names that its column may have."""
        return {spelling: field for field in self.fields for spelling in field.spellings}

    @cached_property
    def stems_with_unit(self) -> frozenset[str]:
        """What a column begins with that has to end in a unit."""
        return frozenset(field.stem for field in self.fields if field.suffixes)

    def guess_field(self, name: str) -> Field | None:
        """The quantity that a column with nearly its name may be."""
        return self._by_normalized.get(_normalize_name(name))

    @cached_property
    def _by_normalized(self) -> dict[str, Field]:
        return {field.stem: field for field in reversed(self.fields)} | {
            _normalize_name(spelling): field for spelling, field in self.by_spelling.items()
        }


def _normalize_name(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


ARM_FORMAT = LogFormat(FIELDS)
_OF_ARM_ONLY = ("q1", "q2", "q3", "theta", "psi", "time", "joint")
_JOINT_COLUMN = re.compile(r"q[0-9]+(?:_.*)?")


def log_format(machine: Machine) -> LogFormat:
    """The columns of a machine's logs: `FIELDS` for the published arm.

    Without the published geometry, joint K has the column ``qK`` in the units of its kind, and neither the
    base's orientation nor the time has to be there.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> log_format(load_machine()).fields is FIELDS
    True
    """
    if machine.has_published_geometry:
        return ARM_FORMAT
    kinds = {kind for kind, _ in _unit_suffixes(machine)}
    positions = (
        Field(f"q{joint}", f"q{joint}", suffixes)
        for joint, (_, suffixes) in zip(machine.joints, _unit_suffixes(machine), strict=True)
    )
    fields: list[Field] = []
    for field in FIELDS:
        if field.name == "q1":
            fields += positions
        elif field.name == "joint":
            fields.append(replace(field, limits=(1, len(machine.joints))))
        elif field.name in _OF_ARM_ONLY:
            fields += [] if field.name in ("q2", "q3") else [replace(field, required=False)]
        elif field.stem not in ("from", "to") or field.name.rpartition("_")[2] in kinds:
            fields.append(field)
    return LogFormat(tuple(fields))


def _unit_suffixes(machine: Machine) -> list[tuple[str, tuple[str, ...]]]:
    """Kind of position and unit suffixes of each joint."""
    length, angle = ("length", LENGTH_SUFFIXES), ("angle", ANGLE_SUFFIXES)
    return [length if machine.is_prismatic(joint) else angle for joint in machine.joints]


def position_columns(rows: pd.DataFrame) -> list[str]:
    """The columns of a log's rows with positions of the joints and the orientation of the base."""
    joints = [str(name) for name in rows.columns if _POSITION.fullmatch(str(name))]
    return [*joints, *ORIENTATION]


def is_coordinate(name: str) -> bool:
    """Whether a column has positions of a joint, or the base's orientation."""
    return name in ORIENTATION or _POSITION.fullmatch(name) is not None


_POSITION = re.compile(r"q[0-9]+")
ORIENTATION = ("theta", "psi")
NO_TIMES = "the log has no times"


def has_times(rows: pd.DataFrame) -> bool:
    """Whether it is known when the traverses of a log were made, and so in which order."""
    return not rows["time"].isna().any()


# Of the lab's own columns; squares of larger numbers overflow.
OWN_LIMITS = (-1e100, 1e100)
CHECK_EVERY = 5  # where the cell is empty
CONDITIONS = {field.name: field for field in FIELDS if isinstance(field, Condition)}
COVARIATE_PREFIX = "covariate:"  # begins the names of the lab's own columns that hold numbers

CONDITION_SPELLINGS = {
    f"{condition.stem}_{suffix}": (condition.name, SUFFIXES[suffix])
    for condition in CONDITIONS.values()
    for suffix in condition.suffixes
}
_COUNT_FIELDS = ("joint", "steps", "check_every")
_UNNAMED_MESSAGE = "has no name; give it one, or delete the column"
# Row labels that pandas adds to a Parquet file.
_ROW_LABELS = re.compile(r"__index_level_\d+__")


@dataclass(frozen=True)
class SourceColumn:
    """A column of a file and the unit its numbers are in (a symbol of `units.UNITS`)."""

    name: str
    unit: str = "1"


@dataclass(frozen=True)
class ColumnLayout:
    """The columns of one file: of the format, by field name; the lab's own; and notes for the user."""

    known: dict[str, SourceColumn]
    unknown: tuple[str, ...]
    notes: tuple[str, ...]
    form: LogFormat = ARM_FORMAT


def match_columns(
    names: tuple[str, ...],
    file: str,
    line: int | None,
    issues: IssueCollector,
    type_faults: Mapping[str, str] = MappingProxyType({}),
    form: LogFormat = ARM_FORMAT,
) -> ColumnLayout:
    """Match the header `names` of a file, in line `line`, to the format.

    Missing, repeated and unnamed columns, those without a unit and those with a fault of their type are added
    to `issues`.

    Examples
    --------
    >>> layout = match_columns(("theta_rad", "pressure_hPa"), "day.csv", 1, IssueCollector())
    >>> layout.known["theta"], layout.unknown
    (SourceColumn(name='theta_rad', unit='rad'), ('pressure_hPa',))
    """
    known: dict[str, SourceColumn] = {}
    unknown: list[str] = []
    notes: list[str] = []
    intended: set[str] = set()
    for name, count in Counter(name for name in names if name.strip()).items():
        field = form.by_spelling.get(name)
        repeated = f"stands {count} times in the header; rename or delete all but one" if count > 1 else None
        message = repeated or explain_bad_unit(name, form) or type_faults.get(name)
        if message:
            issues.add(file, message, line, name)
            # What the column was meant for is not called missing too.
            stems = (name, name.rpartition("_")[0])
            intended |= {meant.name for meant in form.fields if meant.stem in stems}
        elif _ROW_LABELS.fullmatch(name):
            notes.append(f"{file}: column {name} holds pandas' row labels and is left out")
        elif field is None:
            unknown.append(name)
        elif field.name in known:
            message = (
                f"is a second column for {field.stem}, beside {known[field.name].name}; keep one of them"
            )
            issues.add(file, message, line, name)
        else:
            known[field.name] = SourceColumn(
                name, SUFFIXES[name.removeprefix(f"{field.stem}_")] if field.suffixes else "1"
            )
    unnamed = [position for position, name in enumerate(names, start=1) if not name.strip()]
    issues.add_lines(file, [(line, f"number {position}", None, _UNNAMED_MESSAGE) for position in unnamed])
    for field in form.fields:
        if field.required and field.name not in known and field.name not in intended:
            message = f"is missing; every {form.kind} needs it{_spelling_hint(field, unknown, form)}"
            issues.add(file, message, line, field.spellings[0])
    notes += _note_lookalikes(file, known, unknown, form)
    return ColumnLayout(known, tuple(unknown), tuple(notes), form)


def holds_numbers(name: str) -> bool:
    """Whether a name is a column of the format that holds numbers."""
    field = ARM_FORMAT.by_spelling.get(name)
    return field is not None and (bool(field.suffixes) or field.name in _COUNT_FIELDS)


def is_known(name: str) -> bool:
    """Whether a name is a column of the format."""
    return name in ARM_FORMAT.by_spelling


def explain_bad_unit(name: str, form: LogFormat = ARM_FORMAT) -> str | None:
    """What is wrong with the unit of a column's name, or with the joint that it names, if anything.

    Examples
    --------
    >>> explain_bad_unit("temperature")
    'has no unit; write temperature_C or temperature_K'
    """
    if name in form.by_spelling:
        return None
    stem, _, suffix = name.rpartition("_")
    if name in form.stems_with_unit:
        return f"has no unit; write {_unit_choices(name, form)}"
    if stem in form.stems_with_unit:
        return f"{suffix!r} is no unit of {stem}; write {_unit_choices(stem, form)}"
    if form is not ARM_FORMAT and _JOINT_COLUMN.fullmatch(name):
        last = int(form.by_name["joint"].limits[1])
        return f"the machine has no such joint, but 1 to {last}; correct the column or the machine file"
    return None


def _unit_choices(stem: str, form: LogFormat) -> str:
    spellings = [spelling for spelling, field in form.by_spelling.items() if field.stem == stem]
    return " or ".join([", ".join(spellings[:-1])] * (len(spellings) > 1) + spellings[-1:])


def _spelling_hint(field: Field, unknown: list[str], form: LogFormat) -> str:
    similar = (name for name in unknown if form.guess_field(name) is field)
    return next((f" (found {name!r}: write {_closest_spelling(name, field)})" for name in similar), "")


def _note_lookalikes(
    file: str, known: dict[str, SourceColumn], unknown: list[str], form: LogFormat
) -> list[str]:
    """Notes on columns that are kept as the lab's own though their names nearly are optional fields."""
    notes = []
    for other in unknown:
        field = form.guess_field(other)
        if field and not field.required and field.name not in known:
            spelling = _closest_spelling(other, field)
            notes.append(
                f"{file}: column {other!r} is kept as the lab's own; if it is {spelling}, write it so"
            )
    return notes


def _closest_spelling(name: str, field: Field) -> str:
    same = [spelling for spelling in field.spellings if _normalize_name(spelling) == _normalize_name(name)]
    return (same or field.spellings)[0]


@dataclass(frozen=True)
class LogCells:
    """The columns of one file by field name.

    A bad cell, or an empty one that is needed, is added to `issues` and read as NaN (counts: 0, choices:
    -1), so that what depends on it can be left unchecked. A missing column is read as empty cells, without
    an issue: `match_columns` has added one.
    """

    table: FileTable
    layout: ColumnLayout
    issues: IssueCollector

    def has(self, field: str) -> bool:
        """Whether the file has a column for this quantity."""
        return field in self.layout.known

    def is_filled(self, field: str) -> BoolArray:
        """Where the quantity's cell is not empty."""
        return is_filled(self._column(field)) if self.has(field) else self._none()

    def add_issue(self, field: str, wrong: BoolArray, message: IssueMessage) -> None:
        """Add an issue for cells of a quantity, unless the file lacks its column."""
        if self.has(field):
            self.issues.add_cells(self.table, wrong, self.layout.known[field].name, message)

    def numbers(
        self, field: str, *, needed: BoolArray | bool = False, ignored: BoolArray | bool = False
    ) -> Array:
        """Read finite numbers within the quantity's limits in SI, NaN where empty or ignored."""
        if not self.has(field):
            return np.full(self.table.count, np.nan)
        parsed = parse_numbers(self._column(field))
        with np.errstate(over="ignore"):
            values = to_si(parsed.values, self.layout.known[field].unit)
        usable = np.isfinite(values) & np.logical_not(ignored)
        bad = ~(usable | ignored)
        outside = usable & is_outside(values, self.layout.form.by_name[field].limits)
        self.add_issue(field, outside, self._limits_message(field))
        usable &= ~outside
        self.add_issue(field, bad & ~parsed.empty, _bad_number_message)
        self.add_issue(field, bad & parsed.empty & needed, "is empty; write the number")
        np.copyto(values, np.nan, where=~usable)
        return values

    def counts(
        self, field: str, message: str, *, maximum: int = MAX_STEPS, needed: bool = False
    ) -> Int64Array:
        """Read integers from 1 to `maximum`, 0 where empty or bad."""
        if not self.has(field):
            return np.zeros(self.table.count, np.int64)
        parsed = parse_numbers(self._column(field))
        values = parsed.values
        good = (values >= 1) & (values <= maximum) & (values == np.floor(values))
        self.add_issue(field, ~good if needed else ~(good | parsed.empty), message)
        return np.where(good, values, 0.0).astype(np.int64)

    def choices(self, field: str, choices: tuple[str, ...], message: IssueMessage) -> npt.NDArray[np.int8]:
        """Index of each cell's text among `choices`, -1 where it is none of them."""
        if not self.has(field):
            return np.full(self.table.count, -1, np.int8)
        index = parse_choices(self._column(field), choices)
        self.add_issue(field, index < 0, message)
        return index

    def times(self, field: str) -> ParsedTimes:
        """Read times, 0 where empty or bad."""
        if not self.has(field):
            zeros = np.zeros(self.table.count, np.int64)
            return ParsedTimes(zeros, self._none(), ~self._none(), self._none())
        times = parse_times(self._column(field))
        self.add_issue(field, times.empty, "is empty; write when the traverse began")
        self.add_issue(field, times.bad, "is no date with a time of day; write it like 2012-03-05T09:41:10")
        return times

    def texts(self, field: str) -> pa.Array:
        """Read cells as text, literally; empty where the column is missing."""
        if not self.has(field):
            return pa.repeat(pa.scalar("", pa.large_string()), self.table.count)
        return self.table.text(self.layout.known[field].name)

    def _limits_message(self, field: str) -> str:
        unit = self.layout.known[field].unit
        low, high = (from_si(limit, unit) for limit in self.layout.form.by_name[field].limits)
        return f"is outside the limits, {low:g} to {high:g} {unit}; correct it, or the column's unit"

    def _column(self, field: str) -> pa.Array:
        return self.table.column(self.layout.known[field].name)

    def _none(self) -> BoolArray:
        return np.zeros(self.table.count, np.bool_)


def is_outside(values: Array, limits: tuple[Array | float, Array | float]) -> BoolArray:
    """Where a number is beyond the limits by more than rounding; NaN is not."""
    low, high = limits
    return (values < low - 1e-12 * np.abs(low)) | (values > high + 1e-12 * np.abs(high))


def split_by_file(files: list[LogCells], rows: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Split an array over the rows of all files into one for each."""
    return np.split(rows, np.cumsum([cells.table.count for cells in files])[:-1])


def locate_row(files: list[LogCells], row: int) -> str:
    """Where a row of all files stands, in words."""
    counts = [cells.table.count for cells in files]
    which = int(np.searchsorted(np.cumsum(counts), row, side="right"))
    return files[which].table.locate(row - sum(counts[:which]))


def _bad_number_message(row: int, value: str) -> str:
    text = value.strip()
    if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", text):
        return f"is no number; write a decimal point, not a comma: {text.replace(',', '.')}"
    if text.startswith("\N{MINUS SIGN}"):
        return f"is no number; write a plain minus sign: -{text[1:]}"
    if re.fullmatch(r"[+-]?(nan|inf|infinity|[0-9.]+e[+-]?[0-9]+)", text, re.IGNORECASE):
        return "is no finite number; write the number, or leave the cell empty where it may be"
    return "is no number; write digits and a decimal point, such as 12.5"


_OWN_LIMITS_MESSAGE = "is outside the limits, {:g} to {:g}; correct it, or leave the cell empty".format(
    *OWN_LIMITS
)


def read_covariates(files: list[LogCells]) -> tuple[dict[str, pd.Series], tuple[str, ...]]:
    """Read the columns that are not of the format, over all files, and note those that are text by few cells.

    A column is numeric, ``covariate:<column>`` with NaN where empty, if every cell that is not empty holds a
    finite number; else it is ``text:<column>``.
    """
    columns: dict[str, pd.Series] = {}
    notes: list[str] = []
    names = dict.fromkeys(name for cells in files for name in cells.layout.unknown)
    if len(names) > MAX_COLUMNS:
        message = (
            f"the files have {len(names):,} columns of their own, and no more than {MAX_COLUMNS:,} are read"
        )
        raise InputError(message)
    for name in names:
        parts = [_raw_column(cells, name) for cells in files]
        numbers = [parse_numbers(part) for part in parts]
        empty = np.concatenate([part.empty for part in numbers])
        bad = np.concatenate([part.bad for part in numbers])
        if not bad.any() and not empty.all():
            values = np.concatenate([part.values for part in numbers])
            outside = split_by_file(files, is_outside(values, OWN_LIMITS))
            for cells, outside_here in zip(files, outside, strict=True):
                cells.issues.add_cells(cells.table, outside_here, name, _OWN_LIMITS_MESSAGE)
            columns[COVARIATE_PREFIX + name] = pd.Series(values, copy=False)
            continue
        text = pa.concat_arrays([_text_column(cells, name) for cells in files]).to_pandas()
        columns[f"text:{name}"] = text
        if 0 < 2 * bad.sum() < len(empty) - empty.sum():
            first = int(np.argmax(bad))
            count = f"{bad.sum():,} of {len(bad):,} cells {'is' if bad.sum() == 1 else 'are'} no number"
            example = f"{text.iloc[first]!r} in {locate_row(files, first)}"
            notes.append(f"column {name}: {count} ({example}), so the column is kept as text")
    return columns, tuple(notes)


def _text_column(cells: LogCells, name: str) -> pa.Array:
    return cells.table.text(name) if name in cells.layout.unknown else to_text(_raw_column(cells, name))


def _raw_column(cells: LogCells, name: str) -> pa.Array:
    missing = pa.nulls(cells.table.count, pa.large_string())
    return cells.table.column(name) if name in cells.layout.unknown else missing
