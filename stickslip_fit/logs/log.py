"""Log, the measurement log: its traverses, their selection, its summary, and writing it as CSV.

`write_log` picks for each column the first unit in which every value can be written exactly, so that
reading the file gives the same rows.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa

from stickslip_fit._format import (
    MISSING,
    coordinate_unit,
    format_configuration,
    format_direction,
    format_plain,
    format_time,
    join_words,
    joint_name,
    pluralize,
)
from stickslip_fit._io import write_atomically
from stickslip_fit._rows import unique_rows
from stickslip_fit._summary import Column, Section, Summarized, Summary, Table, numbers, summarize, words
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.errors import check_type
from stickslip_fit.logs._frame import check_frame
from stickslip_fit.logs.schema import (
    CHECK_EVERY,
    CONDITIONS,
    COVARIATE_PREFIX,
    Field,
    has_times,
    log_format,
    position_columns,
)
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.units import SUFFIXES, from_si, to_si

# Finer than anything that can be set, coarser than what unit conversion rounds off (rad, m).
_KEY_DECIMALS = 10
_NUMBER_DECIMALS = 6
CHANGED = "changed after reading"


def count_configurations(rows: pd.DataFrame) -> pd.DataFrame:
    """Count the traverses of each configuration in the rows of a Log.

    One row per session, joint and configuration, in that order: session, joint, q1 to qn (NaN for the
    moving joint), theta, psi, low and high (the stretch traversed, rad or m), ``+`` and ``-`` (traverses in
    each direction), replicates (those that repeat another of the same direction).
    """
    table, keys = _list_configurations(rows), ["session", "joint", *_position_columns(rows)]
    table = table.assign(**{way: (rows["direction"] == way).astype(np.int64) for way in "+-"})
    counted = table.groupby(keys, dropna=False, sort=True)[["+", "-"]].sum().reset_index()
    return counted.assign(replicates=(counted[["+", "-"]] - 1).clip(lower=0).sum(axis=1))


def has_replicates(rows: pd.DataFrame) -> bool:
    """Whether a traverse repeats another of its session, configuration and direction."""
    return bool(_list_configurations(rows).assign(direction=rows["direction"]).duplicated().any())


def number_configurations(rows: pd.DataFrame, features: Array | None = None) -> IntArray:
    """A number for each configuration, the same in both directions and all sessions, shape (n,).

    Rows are of one configuration that traverse the same stretch with the same `features`, shape (n, k):
    without them joint, the other joints and the base.
    """
    if features is None:
        features = rows[["joint", *position_columns(rows)]].astype(float).fillna(9.0).to_numpy()
    ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1)
    keys = np.column_stack([features, ends]).round(_NUMBER_DECIMALS)
    return unique_rows(keys)[1]


def _list_configurations(rows: pd.DataFrame) -> pd.DataFrame:
    """Session, joint and configuration of each row."""
    positions = _position_columns(rows)
    table = rows[["session", "joint", *positions[:-2]]].assign(
        low=np.minimum(rows["start"], rows["stop"]), high=np.maximum(rows["start"], rows["stop"])
    )
    # Adding zero makes -0.0 and 0.0 one configuration.
    with np.errstate(over="ignore"):
        table[positions] = table[positions].round(_KEY_DECIMALS) + 0.0
    return table


def _position_columns(rows: pd.DataFrame) -> list[str]:
    return [*position_columns(rows), "low", "high"]


def write_log(log: Log | pd.DataFrame, path: str | Path, machine: Machine | None = None) -> None:
    """Write a log as CSV so that reading it gives the same rows.

    Quantities are written in the usual units (deg, mm, °C, ms, g), or in another where a value is not exact
    there. Optional columns without content and history are left out; from and to are always written, so that
    the traverses do not depend on the machine file.

    Parameters
    ----------
    log : Log or DataFrame
        A Log, or its rows.
    path : str or Path
        Written completely or not at all.
    machine : Machine, optional
        Of rows, which do not say whether a joint is rotary or prismatic; the nominal one if not given.

    Raises
    ------
    InputError
        If the file cannot be written, or is one that the log was read from.
    """
    if not isinstance(log, pd.DataFrame):
        check_type("log", log, Log)
    rows, files = (log, ()) if isinstance(log, pd.DataFrame) else (log.rows, log.files)
    known = machine if isinstance(log, pd.DataFrame) else log.machine
    write_atomically(path, format_csv(rows, known or load_machine()), files)


def format_csv(rows: pd.DataFrame, machine: Machine) -> bytes:
    """Rows of a machine's Log as the bytes of a CSV file."""
    columns = _cell_columns(rows, machine)
    header = ",".join(map(_quote, columns))
    lines = map(",".join, zip(*columns.values(), strict=True))
    return "\n".join([header, *lines, ""]).encode("utf-8")


def _quote(text: str) -> str:
    """Text as a cell; unlike the csv module, lone carriage returns are quoted too."""
    return '"' + text.replace('"', '""') + '"' if re.search('[",\r\n]', text) else text


def _text_cells(values: pd.Series) -> list[str]:
    quoted = {text: _quote(text) for text in values.unique()}
    return [quoted[text] for text in values]


def _cell_columns(rows: pd.DataFrame, machine: Machine) -> dict[str, list[str]]:
    """Column name to cells."""
    form = log_format(machine)
    columns = {
        "session": _text_cells(rows["session"]),
        **({"time": _time_cells(rows["time"])} if has_times(rows) else {}),
        "joint": _number_cells(rows["joint"]),
        "direction": _text_cells(rows["direction"]),
        "steps": _number_cells(rows["steps"]),
    }
    for name in position_columns(rows):
        if form.by_name[name].required or rows[name].notna().any():
            columns |= _quantity_column(form.by_name[name], rows[name].to_numpy())
    slides = rows["joint"].isin([joint for joint in machine.joints if machine.is_prismatic(joint)])
    for kind, subset in (("angle", ~slides), ("length", slides)):
        for end, inside in (("from", "start"), ("to", "stop")):
            if subset.any():
                columns |= _quantity_column(
                    form.by_name[f"{end}_{kind}"], rows[inside].where(subset).to_numpy()
                )
    return columns | _optional_columns(rows)


def _optional_columns(rows: pd.DataFrame) -> dict[str, list[str]]:
    columns: dict[str, list[str]] = {}
    if (rows["check_every"] != CHECK_EVERY).any():
        columns["check_every"] = _number_cells(rows["check_every"])
    if (rows["status"] != "ok").any():
        columns["status"] = _text_cells(rows["status"])
    for name in CONDITIONS:
        if rows[name].notna().any():
            columns |= _quantity_column(CONDITIONS[name], rows[name].to_numpy())
    if (rows["note"] != "").any():
        columns["note"] = _text_cells(rows["note"])
    for name in rows.columns:
        if name.startswith(COVARIATE_PREFIX):
            columns[name.removeprefix(COVARIATE_PREFIX)] = _number_cells(rows[name])
        elif name.startswith("text:"):
            columns[name.removeprefix("text:")] = _text_cells(rows[name])
    return columns


def _quantity_column(field: Field, values: Array) -> dict[str, list[str]]:
    """One column, in the first unit in which every value has an exact equal."""
    candidates = [
        (spelling, _convert_exactly(values, SUFFIXES[suffix]))
        for spelling, suffix in zip(field.spellings, field.suffixes, strict=True)
    ]
    exact = (candidate for candidate in candidates if candidate[1][1])
    spelling, (converted, _) = next(exact, candidates[0])
    return {spelling: _number_cells(converted)}


def _convert_exactly(values: Array, unit: str) -> tuple[Array, bool]:
    """Short decimals that read back as `values`, and whether all of them do to the last bit."""
    # A value that overflows is not exact, and another unit is tried.
    with np.errstate(over="ignore", invalid="ignore"):
        exact = from_si(values, unit)
        neighbours = (np.nextafter(exact, -np.inf), np.nextafter(exact, np.inf))
        written, missed = exact, ~np.isnan(values)
        for candidate in (np.round(exact, 9), np.round(exact, 12), exact, *neighbours):
            hit = missed & (to_si(candidate, unit) == values)
            written = np.where(hit, candidate, written)
            missed &= ~hit
    return written, not missed.any()


def _number_cells(values: pd.Series | Array) -> list[str]:
    """Shortest decimals that read back as the same numbers; empty for NaN."""
    return pa.array(values, from_pandas=True).cast(pa.string()).fill_null("").to_pylist()


def _time_cells(time: pd.Series) -> list[str]:
    """ISO 8601, as fine as the finest time needs; with Z where the log has zones."""
    utc = time.to_numpy(dtype="datetime64[ns]")
    units: tuple[Literal["s", "ms", "us", "ns"], ...] = ("s", "ms", "us", "ns")
    unit = next(unit for unit in units if (utc == utc.astype(f"M8[{unit}]")).all())
    zone = "" if time.dt.tz is None else "Z"
    return [text + zone for text in np.datetime_as_string(utc, unit=unit).tolist()]


@dataclass(frozen=True, eq=False, repr=False)
class Log(Summarized):
    """The traverses of a campaign, as `read_log` returns them.

    Attributes
    ----------
    rows : DataFrame
        One row per traverse, sorted by time and joint, SI throughout. ``session``, ``time`` (NaT in a log
        without times), ``joint``, ``direction`` ('+', '-'), ``steps``; ``q1`` to ``qn`` (the moving joint's
        own is NaN), ``theta``, ``psi`` (NaN where not given); ``start``, ``stop`` (rad or m);
        ``check_every``; ``status`` ('ok', 'interrupted', 'excluded'); ``temperature``, ``humidity``,
        ``supply``, ``step_period``, ``payload`` (NaN where not given); ``note``; the lab's own
        columns as ``covariate:<column>`` and ``text:<column>``; and history, see `add_history`.
    sources : tuple of (str, str)
        Name and sha256 of each file.
    file_sha256 : str
        Hash over all files; see `sha256`.
    machine : Machine
        Its ranges are the ends of full traverses.
    notes : tuple of str
        On how the files were read.
    rows_as_read : DataFrame or None
        A copy of `rows`, by which a change of them shows; None where nothing was read.

    Raises
    ------
    InputError
        If `rows` lack a column or hold what no file could have given, such as a count of 0 or NaN.
    """

    rows: pd.DataFrame
    sources: tuple[tuple[str, str], ...]
    file_sha256: str
    machine: Machine
    notes: tuple[str, ...] = ()
    rows_as_read: pd.DataFrame | None = None

    def __post_init__(self) -> None:
        check_frame(self.rows, self.machine)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def is_changed(self) -> bool:
        """Whether `rows` are no longer those that were read, or a selection of them."""
        return self.rows_as_read is not None and not self.rows.equals(self.rows_as_read)

    @property
    def sha256(self) -> str:
        """The hash of the files; of the rows, once these are changed."""
        if not self.is_changed:
            return self.file_sha256
        names = "\n".join(map(str, self.rows.columns)).encode()
        cells = pd.util.hash_pandas_object(self.rows.astype(str), index=False).to_numpy().tobytes()
        return hashlib.sha256(names + cells).hexdigest()

    @property
    def provenance(self) -> tuple[tuple[str, str], ...]:
        """Name and hash of each file, and of rows that were changed after reading."""
        files = tuple((name, f"sha256 {sha}") for name, sha in self.sources)
        return (*files, (CHANGED, f"sha256 {self.sha256}")) if self.is_changed else files

    @property
    def sessions(self) -> tuple[str, ...]:
        """Labels of the sessions, in the order in which they began; alphabetical in a log without times."""
        return tuple(self.rows["session"].unique())

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints that were driven."""
        return tuple(int(joint) for joint in sorted(self.rows["joint"].unique()))

    @property
    def usable(self) -> pd.DataFrame:
        """The rows that may be fitted: those whose status is ok.

        InputError for rows that no file could have given, since a DataFrame can be changed in place. Texts
        and labels are of dtype object: single rows and columns of Arrow's strings are slow to select.
        """
        check_frame(self.rows, self.machine)
        rows = self.rows[self.rows["status"] == "ok"].reset_index(drop=True)
        rows.columns = rows.columns.astype(object)
        for name in rows.columns[rows.dtypes == "str"]:
            # Of all columns at once, `astype` takes five times as long.
            rows[name] = pd.Series(rows[name].to_numpy(object), dtype=object)
        return rows

    def select(self, mask: npt.ArrayLike) -> Log:
        """Only the rows where `mask` is true, with their history in the whole log."""
        read = self.rows_as_read
        if read is not None and len(read) == len(self.rows):
            read = read[mask].reset_index(drop=True)
        return replace(self, rows=self.rows[mask].reset_index(drop=True), rows_as_read=read)

    def exclude(self, labels: npt.ArrayLike) -> Log:
        """The rows with these labels of the index have the status 'excluded', which changes no count."""
        rows = self.rows.copy()
        rows.loc[labels, "status"] = "excluded"
        return replace(self, rows=rows, rows_as_read=self.rows_as_read if self.is_changed else rows.copy())

    def configurations(self) -> pd.DataFrame:
        """The configurations of the usable rows, see `count_configurations`."""
        return count_configurations(self.usable)

    def plot(self, column: str | None = None) -> npt.NDArray[np.object_]:
        """Mean step sizes of the usable traverses, an Axes for each joint.

        Parameters
        ----------
        column : str, optional
            Against what: ``"q2"``, ``"theta"``, ``"temperature"``, ``"hours"`` in the session, any column of
            the log without its unit; of the moving joint's own position the middle of the traverse. Without
            it, in order of time.

        Raises
        ------
        InputError
            If no traverse is usable, or there is no such column.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.readings import plot_step_sizes

        return collect_axes(plot_step_sizes(self, column))

    @property
    def files(self) -> tuple[str, ...]:
        """The files that it was read from, as they were named."""
        return tuple(name for name, _ in self.sources)

    def to_csv(self, path: str | Path) -> None:
        """Write the log in its file format; see `write_log`."""
        write_log(self, path)


MAX_ROWS = 10  # of a table; the log itself holds the others
MAX_FILES = 3
FEW_VALUES = 4
NOT_FITTED = ("interrupted", "excluded")


@summarize.register
def summarize_log(log: Log) -> Summary:
    """The log in two sentences, then its sessions, coverage, conditions, and traverses with a note."""
    tables = [_session_table(log), _coverage_table(log), _condition_table(log), _note_table(log)]
    files = join_words([f"{name} (sha256 {sha[:12]})" for name, sha in log.sources[:MAX_FILES]] or ["memory"])
    more = len(log.sources) - MAX_FILES
    changed = ("The rows were changed after reading: they are not those of the files.",) * log.is_changed
    return Summary(
        title=f"Log {file_names([name for name, _ in log.sources])}".strip(),
        headline=(f"{_describe_rows(log)} From {files}{f' and {more:,} more' if more > 0 else ''}.",),
        sections=(Section(tables=tuple(table for table in tables if table and table.rows)),),
        flags=(*changed, *log.notes),
        provenance=(*log.provenance, (f"machine {log.machine.name}", f"sha256 {log.machine.sha256}")),
    )


def file_names(names: list[str]) -> str:
    """Files in a title, without their folders; empty for a log that was never in a file."""
    short = [Path(name).name for name in names[:MAX_FILES]]
    if len(names) > MAX_FILES:
        short.append(pluralize(len(names) - MAX_FILES, "more file"))
    return join_words(short)


def latest(sessions: int) -> str:
    """The note of a table that leaves earlier sessions out."""
    return f"The latest {MAX_ROWS} of {pluralize(sessions, 'session')}." if sessions > MAX_ROWS else ""


def _describe_rows(log: Log) -> str:
    rows = log.rows
    counts = f"{pluralize(len(rows), 'traverse')} in {pluralize(len(log.sessions), 'session')}"
    if rows.empty:
        return f"{counts}."
    joints = join_words([joint_name(joint, log.machine) for joint in log.joints])
    states = rows["status"].value_counts()
    unused = [pluralize(int(states[name]), f"{name} traverse") for name in NOT_FITTED if name in states]
    use = f"Not fitted, but part of the history: {join_words(unused)}." if unused else "All are usable."
    if not has_times(rows):
        order = "Without times: whatever depends on time or on the order of traverses cannot be tested."
        return f"{counts}, {joints}. {use} {order}"
    dates = dict.fromkeys(f"{moment:%Y-%m-%d}" for moment in (rows["time"].min(), rows["time"].max()))
    return f"{counts} ({' to '.join(dates)}), {joints}. {use}"


def _session_table(log: Log) -> Table:
    """Time and traverses of each session."""
    kinds = [(joint, sign) for joint in log.joints for sign in ("+", "-")]
    timed = has_times(log.rows)
    columns = (
        *words("session", *(("first traverse", "last traverse") if timed else ())),
        *(Column(format_direction(sign), group=f"joint {joint}") for joint, sign in kinds),
        *(Column(name, group="not fitted") for name in NOT_FITTED),
    )
    shown = log.rows[log.rows["session"].isin(log.sessions[-MAX_ROWS:])]
    body = []
    for session, rows in shown.groupby("session", sort=False, observed=True):
        driven = rows.groupby(["joint", "direction"], observed=True).size()
        body.append(
            (
                str(session),
                *(f"{rows['time'].iloc[place]:%Y-%m-%d %H:%M}" for place in (0, -1) if timed),
                *(f"{driven.get(kind, 0):,}" for kind in kinds),
                *(f"{(rows['status'] == name).sum():,}" for name in NOT_FITTED),
            )
        )
    note = latest(len(log.sessions))
    return Table("Sessions and traverses", columns, tuple(body), note=note, short=slice(-3, None))


def _coverage_table(log: Log) -> Table | None:
    """What was covered: one column for each joint."""
    usable, configurations = log.usable, log.configurations()
    covered = [_describe_coverage(log, joint, usable, configurations) for joint in log.joints]
    if not covered:
        return None
    columns = words("covered", *(joint_name(joint, log.machine) for joint in log.joints))
    body = tuple((name, *(joint[name] for joint in covered)) for name in covered[0])
    note = "Configurations: in either direction. Replicates: traverses that repeat another of their session."
    return Table("Coverage, usable traverses", columns, body, note=note)


def _describe_coverage(
    log: Log, joint: int, usable: pd.DataFrame, configurations: pd.DataFrame
) -> dict[str, str]:
    rows, configurations = usable[usable["joint"] == joint], configurations[configurations["joint"] == joint]
    distinct = configurations[_position_columns(rows)].drop_duplicates()
    length = (rows["stop"] - rows["start"]).abs()
    covered = {
        "traverses": f"{len(rows):,}",
        "over the full range": f"{np.isclose(length, log.machine.span(joint), rtol=1e-6).sum():,}",
        "configurations": f"{len(distinct):,}",
        "replicates": f"{configurations['replicates'].sum():,}",
    }
    for name in position_columns(rows):
        unit = coordinate_unit(name, log.machine)
        values = "moves" if name == f"q{joint}" else _format_values(rows[name], unit)
        if values != MISSING or log.machine.has_published_geometry:
            covered[f"{name} ({'°' if unit == 'deg' else unit})"] = values
    return covered


def _condition_table(log: Log) -> Table:
    """Conditions, and the lab's own columns of numbers."""
    rows = log.rows
    units = {name: condition.unit for name, condition in CONDITIONS.items()}
    recorded = [name for name in CONDITIONS if rows[name].notna().any()]
    own = [name for name in rows.columns if name.startswith(COVARIATE_PREFIX)]
    body = tuple(
        (
            f"{name} ({units[name]})" if name in units else name,
            f"{rows[name].notna().sum():,} of {len(rows):,}",
            _format_values(rows[name], units.get(name, "1")),
        )
        for name in recorded + own
    )
    return Table("Conditions", (*words("column"), *numbers("given", "values")), body)


def _note_table(log: Log) -> Table | None:
    """Traverses with a note or not fitted."""
    rows = log.rows[(log.rows["note"] != "") | (log.rows["status"] != "ok")]
    body = tuple(
        (
            format_time(row["time"]),
            str(row["session"]),
            f"{row['joint']} {format_direction(row['direction'])}",
            format_configuration(row, log.machine),
            str(row["status"]),
            str(row["note"]),
        )
        for row in rows.head(MAX_ROWS).to_dict("records")
    )
    hidden = len(rows) - len(body)
    note = f"{pluralize(hidden, 'more traverse')} with a note or not fitted: see the log." if hidden else ""
    columns = words("time", "session", "joint", "configuration", "status", "note")
    return Table("Traverses with a note or not fitted", columns, body, note=note, folded=True)


def _format_values(values: pd.Series[float], unit: str) -> str:
    """A few values as they are, many as lowest and highest, with their spacing where it is even."""
    with np.errstate(over="ignore"):
        distinct = np.unique(np.round(from_si(values.dropna().to_numpy(float), unit), 3)) + 0.0
    if not len(distinct):
        return MISSING
    if len(distinct) <= FEW_VALUES:
        return ", ".join(format_plain(value) for value in distinct)
    ends = f"{format_plain(distinct[0])} to {format_plain(distinct[-1])}"
    spacing = np.diff(distinct)
    if np.allclose(spacing, spacing[0], atol=2e-3):
        return f"{ends} by {format_plain(spacing[0])}"
    return f"{ends}, {len(distinct):,} values"
