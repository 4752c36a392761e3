"""Drives to be predicted: `read_drives` from a file, `one_drive` from its ends; checked against the law."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words, position_unit
from stickslip_fit.bayes import Posterior
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.causes.parameters import REQUIRED_HISTORY
from stickslip_fit.errors import InputError, InputIssue, check_type
from stickslip_fit.estimation import Result
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs import drives
from stickslip_fit.logs._files import SourcePath
from stickslip_fit.logs.history import LATE_TEMPERATURE, PAST, condition_of
from stickslip_fit.logs.schema import COVARIATE_PREFIX, ORIENTATION, is_coordinate
from stickslip_fit.machine import Machine
from stickslip_fit.moves.arm import CONDITION_KEYS, check_given_conditions, column_key
from stickslip_fit.units import from_si, to_si

MISSING_HISTORY = {
    "session_seconds": "the law depends on how long the session has run: give each drive its time, a "
    "session's first one beginning it, or this column",
    "steps_before": f"the law depends on {REQUIRED_HISTORY['steps_before']}: give this column",
}


def read_drives(
    source: SourcePath | Iterable[SourcePath],
    law: Result | Posterior,
    conditions: Mapping[str, float] | None = None,
    sheet: str | None = None,
) -> pd.DataFrame:
    """Read drives that a law is to predict: a file with the columns of a log, without counts.

    Parameters
    ----------
    source : path or iterable of paths
        CSV, Excel or Parquet. One row for each drive, with joint, direction, and from and to where it does
        not cover the joint's whole range. The session is one of those that were fitted; without it, or where
        it is empty, the drive is of a session to come. The positions of the other joints, the time and
        recorded conditions are needed only where the law depends on them; beside the time,
        `session_min` and `steps_before` may be given. A column of counts is not read.
    law : Result or Posterior
    conditions : mapping of str to float, optional
        For cells that are empty or missing, by a log's columns, SI; see `predict`.
    sheet : str, optional
        Of a workbook; the first one if not given.

    Returns
    -------
    DataFrame
        In SI and in the order of the file, as `predict` and `Result.predict` take it.

    Raises
    ------
    InputError
        With every fault: file, line, column, value and what to do.
    """
    check_type("law", law, Result, Posterior)
    check_given_conditions(conditions or {}, law, drive_columns(law.machine))
    fitted: dict[tuple[int, str], list[str]] = {}
    for joint, fit in law.joints.items():
        for session, way in zip(fit.groups["session"], fit.groups["direction"], strict=True):
            fitted.setdefault((joint, str(way)), []).append(str(session))
    needed = {name for fit in law.joints.values() for name in _needed_columns(fit.law, law.machine)}
    rows = drives.read_drives(source, law.machine, fitted, needed, sheet)
    for key, (name, unit) in CONDITION_KEYS.items():
        if name in needed & {*REQUIRED_HISTORY} and COVARIATE_PREFIX + key in rows:
            given = pd.Series(to_si(rows[COVARIATE_PREFIX + key].to_numpy(float), unit))
            rows[name] = given.fillna(rows[name]) if name in rows else given
    rows = fill_conditions(rows, conditions or {})
    _check_history(rows, needed, None if not isinstance(source, SourcePath) else str(source))
    return rows


def _check_history(rows: pd.DataFrame, needed: Collection[str], file: str | None) -> None:
    """Refuse drives without the history that the law needs; raises InputError."""
    missing = [
        name for name in MISSING_HISTORY if name in needed and (name not in rows or rows[name].isna().any())
    ]
    if missing:
        raise InputError(
            [InputIssue(MISSING_HISTORY[name], file, column=column_key(name)) for name in missing]
        )


def _needed_columns(law: StepLaw, machine: Machine) -> tuple[str, ...]:
    """Columns of a log on which a law depends: all of an arm's pose, of others what causes use."""
    if machine.has_published_geometry or not isinstance(law, ExtendedLaw):
        return law.columns
    causes = [cause for cause, _ in law.active_causes]
    of_causes = [name for one in causes for name in (*one.columns, *getattr(one, "carriers", ()))]
    return tuple(dict.fromkeys([*law.law.columns, *of_causes]))


def drive_columns(machine: Machine) -> list[str]:
    """Columns that say how a drive goes, which conditions may fill in."""
    return [*(f"q{joint}" for joint in machine.joints), *ORIENTATION]


def fill_conditions(rows: pd.DataFrame, conditions: Mapping[str, float]) -> pd.DataFrame:
    """The drives, with conditions in cells that are empty or missing."""
    for name, value in conditions.items():
        known = rows[name] if name in rows else pd.Series(np.nan, rows.index)
        rows = rows.assign(**{name: known.fillna(value)})
    # A condition that is given has been so for long.
    for name in (name for name in PAST if condition_of(name) in conditions):
        known = rows[name] if name in rows else pd.Series(np.nan, rows.index)
        rows = rows.assign(
            **{name: known.fillna(rows[condition_of(name)] if name in LATE_TEMPERATURE else 0.0)}
        )
    return rows


def one_drive(
    law: Result | Posterior,
    joint: int | None,
    direction: str | None,
    ends: tuple[float | None, float | None],
    conditions: Mapping[str, float],
) -> pd.DataFrame:
    """One drive of a session to come, as `read_drives` returns it, from the options of a command.

    Parameters
    ----------
    law : Result or Posterior
    joint : int or None
        The only one that was fitted, if not given.
    direction : {"+", "-"} or None
        Follows from both ends.
    ends : tuple of float
        Degrees or mm; the end of the joint's range in that direction where not given.
    conditions : mapping of str to float
        See `read_drives`.

    Raises
    ------
    InputError
        If it is not said which joint or which direction, an end is outside the joint's range, or the law
        depends on something that is not given.
    """
    known, machine = list(law.joints), law.machine
    if joint is None and len(known) > 1:
        raise InputError(f"give --joint: the law knows joints {join_words(list(map(str, known)))}")
    joint = known[0] if joint is None else joint
    if joint not in known:
        raise InputError(f"joint {joint} was not fitted; this result knows joints {known}")
    unit, span = position_unit(joint, machine), machine.ranges[joint]
    issues = []
    for option, end in zip(("--from", "--to"), ends, strict=True):
        if end is not None and not span[0] <= round(to_si(end, unit), 12) <= span[1]:
            low, high = (from_si(one, unit) for one in span)
            message = f"is outside joint {joint}'s range, {low:g} to {high:g} {unit}"
            issues.append(InputIssue(message, column=option, value=f"{end:g}"))
    if issues:
        raise InputError(issues)
    start, stop = (None if end is None else float(to_si(end, unit)) for end in ends)
    if direction is None:
        if start is None or stop is None or start == stop:
            raise InputError("give --direction, or by --from and --to two different ends")
        direction = "+" if stop > start else "-"
    first, last = span if direction == "+" else reversed(span)
    start, stop = first if start is None else start, last if stop is None else stop
    if start == stop or (stop > start) != (direction == "+"):
        message = (
            f"disagrees with the drive's ends, {from_si(start, unit):g} to {from_si(stop, unit):g} {unit}"
        )
        raise InputError(InputIssue(message, column="--direction", value=direction))
    needed = _needed_columns(law.joints[joint].law, machine)
    if others := [name for name in needed if is_coordinate(name) and name != f"q{joint}"]:
        what = join_words(others)
        raise InputError(f"the law of joint {joint} depends on {what}: give the drive in a file, with these")
    places = dict.fromkeys(drive_columns(machine), np.nan)
    row = {"session": "", "joint": joint, "direction": direction, **places, "start": start, "stop": stop}
    rows = fill_conditions(pd.DataFrame(row | {"check_every": 1}, index=[0]), conditions)
    _check_history(rows, needed, None)
    return rows
