"""read_log: from files to a checked Log in order of time, with its history. Start reading here.

Each file becomes a table (`_files`, `_csv`); its columns are matched to the format (`schema`). Session,
time, joint and steps are read over all files, sessions are selected, the rules of each row are checked,
the rows are put in order and `history` is added. All faults are raised in one InputError.
"""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from functools import cached_property, partial
from itertools import repeat

import numpy as np
import pandas as pd
import pyarrow as pa

from stickslip_fit._format import format_duration, join_words
from stickslip_fit._typing import Array, BoolArray, Int64Array
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs._files import SourcePath, Sources, hash_sources, open_sources
from stickslip_fit.logs._table import IssueCollector, IssueMessage, label_codes, run_in_threads
from stickslip_fit.logs._units import doubt_temperatures, doubt_units
from stickslip_fit.logs.history import add_session_history, add_unknown_history, steps_before
from stickslip_fit.logs.log import Log
from stickslip_fit.logs.plan import read_traverses, report_outside_range
from stickslip_fit.logs.schema import (
    CHECK_EVERY,
    CONDITIONS,
    MAX_STEPS,
    NO_TIMES,
    ORIENTATION,
    LogCells,
    LogFormat,
    locate_row,
    log_format,
    match_columns,
    read_covariates,
    split_by_file,
)
from stickslip_fit.machine import Machine, load_machine

_BAD_COUNT_MESSAGE = "is no positive integer; write the steps driven, such as 12540"


@dataclass(frozen=True)
class RowKeys:
    """Session, time, joint and steps of the rows of all files, one file after the other, shape (n,).

    Attributes
    ----------
    labels : tuple of str
        All sessions in alphabetical order; `session` has indices.
    time : array of int
        Nanoseconds since 1970, UTC where `has_zone`.
    joint, steps : array of int
        0 where the cell is bad.
    valid : array of bool
        Whether session, time and joint are good.
    has_times : bool
        Whether there is a time at all; without, `time` is 0 and the order in which rows were made unknown.
    """

    labels: tuple[str, ...]
    session: Int64Array
    time: Int64Array
    has_zone: BoolArray
    joint: Int64Array
    steps: Int64Array
    valid: BoolArray
    has_times: bool = True

    @cached_property
    def order(self) -> Int64Array:
        """Rows by time, joint and session: an order that does not depend on that of the files."""
        if not self.has_times:
            return np.lexsort((self.joint, self.session))
        if np.all(self.time[1:] > self.time[:-1]):
            return np.arange(len(self.time))
        return np.lexsort((self.session, self.joint, self.time))

    @property
    def steps_before(self) -> Int64Array:
        """Steps of each row's joint in all rows before it; rows in the order of time."""
        return steps_before(self.joint[self.order], self.steps[self.order])

    def select(self, subset: BoolArray) -> RowKeys:
        """Only these rows."""
        names = ("session", "time", "has_zone", "joint", "steps", "valid")
        return replace(self, **{name: getattr(self, name)[subset] for name in names})

    def columns(self) -> dict[str, pd.Series]:
        """The Log's columns; times are in UTC where the log has zones."""
        time = pd.Series(self.time.view("datetime64[ns]"), copy=False)
        if not self.has_times:
            time = pd.Series(np.full(len(self.time), np.datetime64("NaT", "ns")))
        return {
            "session": label_codes(self.session, self.labels),
            "time": time.dt.tz_localize("UTC") if self.has_zone.any() else time,
            "joint": pd.Series(self.joint, copy=False),
            "steps": pd.Series(self.steps, copy=False),
        }


def read_row_keys(files: list[LogCells], machine: Machine, *, labelled: bool = True) -> RowKeys:
    """Read and check session, time, joint and steps; every session has a label if `labelled`."""
    has_times = _check_time_columns(files)

    def counts(field: str, message: str, maximum: int = MAX_STEPS) -> Int64Array:
        return np.concatenate([cells.counts(field, message, maximum=maximum, needed=True) for cells in files])

    read = run_in_threads(
        {
            "sessions": lambda: _read_sessions(files, labelled),
            "times": lambda: [cells.times("time") for cells in files],
            "joint": lambda: counts("joint", _bad_joint_message(machine), len(machine.joints)),
            "steps": lambda: counts("steps", _BAD_COUNT_MESSAGE),
        },
        sum(cells.table.count for cells in files),
    )
    labels, session = read["sessions"]
    timed = ~np.concatenate([time.empty | time.bad for time in read["times"]]) | (not has_times)
    identity = RowKeys(
        labels=labels,
        session=session,
        time=np.concatenate([time.values for time in read["times"]]),
        has_zone=np.concatenate([time.has_zone for time in read["times"]]),
        joint=read["joint"],
        steps=read["steps"],
        valid=timed & (read["joint"] > 0) & np.array([bool(label) for label in labels], np.bool_)[session],
        has_times=has_times,
    )
    if not has_times:
        return identity
    _report_mixed_zones(files, identity.has_zone & timed, ~identity.has_zone & timed)
    _report_duplicates(files, identity)
    return identity


def _bad_joint_message(machine: Machine) -> str:
    """What to write for a joint, by the machine's kinds."""
    by_kind: dict[str, list[str]] = {}
    for joint in machine.joints:
        by_kind.setdefault(machine.kinds[joint - 1], []).append(str(joint))
    choices = [f"{join_words(joints, 'or')} ({kind})" for kind, joints in by_kind.items()]
    return f"is no joint; write {' or '.join(choices)}"


def _check_time_columns(files: list[LogCells]) -> bool:
    """Whether the log has times; an issue for each file without, where others have them."""
    timed = [cells.has("time") for cells in files]
    required = any(cells.layout.form.by_name["time"].required for cells in files)
    if any(timed) and not all(timed) and not required:
        message = "is missing here, and other files have it; give all files their times, or none"
        for cells, has_it in zip(files, timed, strict=True):
            if not has_it:
                cells.issues.add(cells.table.file, message, cells.table.header_line, "time")
    return required or any(timed)


def _read_sessions(files: list[LogCells], labelled: bool) -> tuple[tuple[str, ...], Int64Array]:
    encoded = pa.concat_arrays([cells.texts("session") for cells in files]).dictionary_encode()
    unsorted = np.array(encoded.dictionary.to_pylist(), dtype=object)
    order = np.argsort(unsorted)
    session = np.argsort(order)[encoded.indices.to_numpy()]
    labels = tuple(unsorted[order])
    blank = np.array([labelled and not label.strip() for label in labels], np.bool_)[session]
    for cells, blank_here in zip(files, split_by_file(files, blank), strict=True):
        cells.add_issue("session", blank_here, "is empty; write a label, such as the date 2012-03-05")
    return labels, session


def _report_mixed_zones(files: list[LogCells], zoned: BoolArray, local: BoolArray) -> None:
    """Report zones on some rows only; the rarer kind is taken as the mistake."""
    if not (zoned.any() and local.any()):
        return
    if zoned.sum() < local.sum():
        wrong, right, message = zoned, local, "has a time zone, but {} has none; give all rows one, or none"
    else:
        wrong, right, message = local, zoned, "has no time zone, but {} has one; give all rows one, or none"
    message = message.format(locate_row(files, int(np.argmax(right))))
    for cells, wrong_here in zip(files, split_by_file(files, wrong), strict=True):
        cells.add_issue("time", wrong_here, message)


def _report_duplicates(files: list[LogCells], identity: RowKeys) -> None:
    order = identity.order
    # Times seldom repeat: joint and session are compared only where they do.
    again = np.flatnonzero(np.diff(identity.time[order]) == 0)
    one, other = order[again], order[again + 1]
    same = identity.valid[one] & identity.valid[other] & (identity.joint[one] == identity.joint[other])
    same &= identity.session[one] == identity.session[other]
    twin = dict(zip(other[same].tolist(), one[same].tolist(), strict=True))
    wrong = np.zeros(len(order), np.bool_)
    wrong[list(twin)] = True
    start = 0
    for cells, wrong_here in zip(files, split_by_file(files, wrong), strict=True):
        cells.add_issue("time", wrong_here, _describe_duplicate(files, twin, start))
        start += cells.table.count


def _describe_duplicate(files: list[LogCells], twin: dict[int, int], start: int) -> IssueMessage:
    def message(row: int, value: str) -> str:
        other = locate_row(files, twin[start + row])
        return f"repeats the session, time and joint of {other}; correct one of the two, or delete a copy"

    return message


TimeLike = str | date | datetime

_EPOCH = datetime(1970, 1, 1)
# Falls of the time: of more in a file its rows stand in another order; smaller ones are slips of a hand.
MAX_CLOCKS, MIN_FALL_SECONDS = 3, 60.0


def select_sessions(identity: RowKeys, since: TimeLike | None, until: TimeLike | None) -> BoolArray:
    """Which rows belong to sessions whose first traverse is in [since, until).

    InputError for a bound that is no date or time or has a zone where the log has none, and for no session.
    """
    if not identity.has_times:
        message = f"{NO_TIMES}: leave this out, and name a file that has only the sessions you mean"
        given = {"since": since, "until": until}.items()
        raise InputError(
            [InputIssue(message, value=str(one), argument=name) for name, one in given if one is not None]
        )
    zoned = bool(identity.has_zone.any())
    began = np.full(len(identity.labels), np.iinfo(np.int64).max)
    np.minimum.at(began, identity.session, identity.time)
    inside = np.ones(len(began), np.bool_)
    if since is not None:
        inside &= began >= _to_nanoseconds("since", since, zoned)
    if until is not None:
        inside &= began < _to_nanoseconds("until", until, zoned)
    if not inside.any():
        first, last = np.datetime_as_string(np.array([began.min(), began.max()]).view("M8[ns]"), unit="m")
        bounds = (("since", since), ("until", until))
        span = " and ".join(f"{name} {bound}" for name, bound in bounds if bound)
        raise InputError(f"no session began {span}; the log's sessions began from {first} to {last}")
    return inside[identity.session]


def note_similar_sessions(identity: RowKeys) -> tuple[str, ...]:
    """Notes on sessions whose labels differ only in spaces or capitals, which may be one session."""
    groups = defaultdict(list)
    for label in identity.labels:
        groups["".join(label.split()).casefold()].append(label)
    return tuple(
        f"sessions {', '.join(map(repr, same))} differ only in spaces or capitals, and count as {len(same)}"
        for same in groups.values()
        if len(same) > 1
    )


def note_clocks_set_back(identity: RowKeys) -> tuple[str, ...]:
    """Notes on sessions whose rows stand in the order of time in one file, but for one place.

    Where the traverses of one joint stand after those of another, times fall from joint to joint as well.
    """
    rows = np.flatnonzero(identity.valid)
    rows = rows[np.argsort(identity.session[rows], kind="stable")]
    session, seconds, joint = identity.session[rows], identity.time[rows] / 1e9, identity.joint[rows]
    falls = 1 + np.flatnonzero((np.diff(seconds) < 0) & (np.diff(session) == 0))
    if not 0 < len(falls) <= MAX_CLOCKS or len(np.unique(session[falls])) < len(falls):
        return ()
    notes = []
    for fall in falls:
        begin, end = np.searchsorted(session, session[fall] + np.arange(2))
        size = float(seconds[fall - 1] - seconds[fall])
        if size >= MIN_FALL_SECONDS and np.isin(joint[fall:end], joint[begin:fall]).any():
            notes.append(
                f"session {identity.labels[session[fall]]}: from its traverse {fall - begin} to the next in "
                f"the file the time falls by {format_duration(size / 60.0, 'min')}, and rises everywhere "
                "else; if the clock was set back there, correct the times, since traverses count in their "
                "order"
            )
    return tuple(notes)


def _to_nanoseconds(name: str, moment: TimeLike, zoned: bool) -> int:
    try:
        when = datetime.fromisoformat(moment) if isinstance(moment, str) else moment
    except ValueError:
        message = "is no date or time; write it like 2012-03-05 or 2012-03-05T09:41"
        raise InputError(InputIssue(message, value=str(moment), argument=name)) from None
    if not isinstance(when, datetime):
        when = datetime(when.year, when.month, when.day)
    if when.tzinfo is not None:
        if not zoned:
            message = "has a time zone, but the log's times have none; leave it out"
            raise InputError(InputIssue(message, value=str(moment), argument=name))
        when = when.astimezone(UTC).replace(tzinfo=None)
    return (when - _EPOCH) // timedelta(microseconds=1) * 1000


DIRECTIONS = ("+", "-")
STATUSES = ("ok", "interrupted", "excluded", "")


def check_rows(
    cells: LogCells, machine: Machine, placed: Collection[int], joint: Int64Array, steps: Int64Array
) -> pd.DataFrame:
    """Read and check the other columns of the format in one file, in its order.

    The machine's ranges bound every position and are the ends of traverses without from and to. `placed` are
    the joints of which it has to be known where they stand; `joint` and `steps`, shape (n,), are 0 where bad.
    """
    direction = cells.choices("direction", DIRECTIONS, "is no direction; write + or -")
    forward = np.array([1, -1, 0])[direction]
    columns = run_in_threads(
        {
            "direction": lambda: label_codes(direction, DIRECTIONS),
            **{
                f"q{other}": partial(_read_position, cells, machine, joint, other, other in placed)
                for other in machine.joints
            },
            **{name: partial(cells.numbers, name, needed=True) for name in ORIENTATION},
            "traverse": lambda: read_traverses(cells, machine, joint, forward),
            "check_every": lambda: _read_check_every(cells, steps),
            "status": lambda: _read_status(cells),
            **{name: partial(cells.numbers, name) for name in CONDITIONS},
            "note": lambda: cells.texts("note").to_pandas(),
        },
        cells.table.count,
    )
    columns["start"], columns["stop"] = columns.pop("traverse")
    return pd.DataFrame(columns, copy=False)


def _read_position(cells: LogCells, machine: Machine, joint: Int64Array, other: int, needed: bool) -> Array:
    """Position of another joint; the moving joint's own cell is ignored."""
    field, others = f"q{other}", needed & (joint > 0) & (joint != other)
    if not cells.has(field) and not cells.layout.form.by_name[field].required and others.any():
        column = cells.layout.form.by_name[field].spellings[0]
        message = f"is missing; where joint {other} stands is needed where another joint moves"
        cells.issues.add(cells.table.file, message, cells.table.header_line, column)
    position = cells.numbers(field, needed=others, ignored=joint == other)
    report_outside_range(cells, machine, field, other, position)
    return position


def _read_check_every(cells: LogCells, steps: Int64Array) -> Int64Array:
    given = cells.counts("check_every", "is no positive integer; write 5, or 1 where the count is exact")
    check_every = np.where(given > 0, given, CHECK_EVERY)
    # Not checked where the cell or the whole column is bad.
    readable = cells.has("check_every") or "check_every" not in cells.table.names
    known = (given > 0) | (~cells.is_filled("check_every") & readable)

    def message(row: int, value: str) -> str:
        return f"is no multiple of check_every, {check_every[row]}; correct the one or the other"

    cells.add_issue("steps", known & (steps % check_every != 0), message)
    return check_every


def _read_status(cells: LogCells) -> pd.Series:
    """Read the status; an empty cell is ok."""
    if not cells.has("status"):
        return label_codes(np.zeros(cells.table.count, np.int8), STATUSES)
    status = cells.choices("status", STATUSES, "is no status; write ok, interrupted or excluded")
    return label_codes(np.where(status == STATUSES.index(""), 0, status), STATUSES)


_MAX_LOOSE_COLUMNS = 80
_LEADING_COLUMNS = ["session", "time", "joint", "direction", "steps"]


def read_log(
    source: SourcePath | Iterable[SourcePath],
    *,
    machine: Machine | None = None,
    since: TimeLike | None = None,
    until: TimeLike | None = None,
    sheet: str | None = None,
) -> Log:
    """Read and check a campaign log, CSV, Excel or Parquet, in one file or many.

    Parameters
    ----------
    source : path or iterable of paths
        Files, or folders, which are searched for ``*.csv``, ``*.xlsx`` and ``*.parquet`` (hidden files left
        out).
    machine : Machine, optional
        The nominal one if not given.
    since, until : str, date or datetime, optional
        Select the sessions whose first traverse is in [since, until); without a zone, they are UTC where
        the log has zones. Of other sessions only session, time, joint and steps are read, for history.
    sheet : str, optional
        The sheet of a workbook; the first one if not given.

    Returns
    -------
    Log

    Raises
    ------
    InputError
        With every fault of every file: file, line, column, value and what to do.

    Warns
    -----
    UserWarning
        For a column whose numbers look as if they were in another unit than its name says.
    """
    machine = machine or load_machine()
    issues = IssueCollector()
    sources = open_sources(source, issues, sheet)
    files = match_files(sources, log_format(machine), issues)
    identity = kept = read_row_keys(files, machine)
    chosen = np.ones(len(identity.time), np.bool_)
    if since is not None or until is not None:
        issues.raise_if_any()
        chosen = select_sessions(identity, since, until)
        files, kept = _select_rows(files, chosen), identity.select(chosen)
    columns, notes = build_columns(files, kept, machine, machine.joints)
    issues.raise_if_any()
    doubts = [doubt for cells in files for doubt in doubt_units(cells, machine)]
    doubts += doubt_temperatures(columns)
    for doubt in doubts:
        warnings.warn(doubt, UserWarning, stacklevel=2)
    notes = (
        *sources.notes,
        *(note for cells in files for note in (*cells.table.notes, *cells.layout.notes)),
        *doubts,
        *notes,
        *note_similar_sessions(identity),
        *(note_clocks_set_back(identity) if len(files) == 1 else ()),
    )
    hashes = tuple((file.table.file, file.sha256) for file in sources.files)
    file_sha256 = hash_sources(sources.files)
    # The cells of a large log take as much memory as its rows, and history needs more.
    del files, sources
    rows = order_columns(columns, kept.order)
    if kept.has_times:
        rows = add_session_history(rows, kept.session[kept.order], machine)
        rows = rows.assign(steps_before=identity.steps_before[chosen[identity.order]])
    else:
        rows = add_unknown_history(rows)
    # Pandas copies a shared column when it is first changed.
    as_read = rows.copy(deep=False)
    return Log(rows, hashes, file_sha256, machine, notes, rows_as_read=as_read)


def match_files(sources: Sources, form: LogFormat, issues: IssueCollector) -> list[LogCells]:
    """The cells of each file, its columns matched to the format; InputError if no file could be opened."""
    if not sources.files:
        issues.raise_if_any()
    tables = [source.table for source in sources.files]
    layouts = [
        match_columns(table.names, table.file, table.header_line, issues, table.type_faults, form)
        for table in tables
    ]
    return [LogCells(table, layout, issues) for table, layout in zip(tables, layouts, strict=True)]


def _select_rows(files: list[LogCells], chosen: BoolArray) -> list[LogCells]:
    """Only the selected rows, and only the files that have any."""
    return [
        replace(cells, table=cells.table.select(np.flatnonzero(subset)))
        for cells, subset in zip(files, split_by_file(files, chosen), strict=True)
        if subset.any()
    ]


def build_columns(
    files: list[LogCells], identity: RowKeys, machine: Machine, placed: Collection[int]
) -> tuple[dict[str, pd.Series], tuple[str, ...]]:
    """All columns but history, in the order of the files, and notes about the lab's own columns.

    `placed` as of `check_rows`.
    """
    joints, steps = split_by_file(files, identity.joint), split_by_file(files, identity.steps)
    read = run_in_threads(
        {
            "checked": lambda: list(map(check_rows, files, repeat(machine), repeat(placed), joints, steps)),
            "own": lambda: read_covariates(files),
        },
        sum(cells.table.count for cells in files),
    )
    own, notes = read["own"]
    # A single file's columns are not copied, for speed.
    checked = read["checked"][0] if len(files) == 1 else pd.concat(read["checked"], ignore_index=True)
    return {**identity.columns(), **dict(checked.items()), **own}, notes


def order_columns(columns: dict[str, pd.Series], order: Int64Array) -> pd.DataFrame:
    """Rows in the given order, the leading columns of a log first."""
    names = _LEADING_COLUMNS + [name for name in columns if name not in _LEADING_COLUMNS]
    rows = pd.DataFrame({name: columns[name] for name in names}, copy=False)
    if len(names) > _MAX_LOOSE_COLUMNS:
        rows = rows.copy()  # in one block: pandas warns of more pieces
    if np.all(order[1:] > order[:-1]):
        return rows
    return rows.take(order).reset_index(drop=True)
