"""read_times: times of day in whatever way a laboratory writes them, in seconds.

A date with slashes or hyphens is day/month/year or month/day/year: which of them, the column has to tell by a
number above 12. With points it is day.month.year.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray

DAY = 86400.0  # s
EPOCH = pd.Timestamp(0, tz="UTC").as_unit("us")
N_SAMPLE = 20  # cells of a column, by which most of those that have no times are known
AMBIGUOUS = (
    "may be day/month or month/day, since no number of the column is above 12; write dates such as 2024-05-31"
)
NEXT_DAY = "times of day that go back by more than 12 hours are of the next day"
NO_TIME = "is no time; write seconds, or times such as 2024-05-31T14:02:07.5"
_CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,]\d+)?))?(?:\s*([AaPp])\.?[Mm]\.?)?")
_DATE = re.compile(rf"(\d{{1,2}})([./-])(\d{{1,2}})\2(\d{{4}}|\d{{2}})(?:[,T]?\s*({_CLOCK.pattern}))?")
_COMPACT = re.compile(r"(\d{4})(\d{2})(\d{2})[-_T ](\d{2})(\d{2})(\d{2})")


@dataclass(frozen=True)
class Times:
    """Times of a column, in seconds since 1970, shape (n,); of clock times since the midnight before.

    `bad` marks cells that are no times, shape (n,), for the reason `fault`; `note` says what was guessed.
    """

    seconds: Array
    bad: BoolArray
    fault: str = NO_TIME
    note: str = ""


def read_times(cells: pd.Series[Any]) -> Times:
    """Times of day, durations, or numbers as they are.

    Examples
    --------
    >>> read_times(pd.Series(["23:59:50", "0:00:05"])).seconds
    array([86390., 86405.])
    >>> read_times(pd.Series(["05/31/2024 1:00 PM", "06/01/2024 1:00 PM"])).note
    'dates are read as month/day/year'
    """
    if pd.api.types.is_numeric_dtype(cells):
        numbers = cells.to_numpy(dtype=float, na_value=np.nan)
        return Times(numbers, ~np.isfinite(numbers))
    if pd.api.types.is_timedelta64_dtype(cells):
        return Times(cells.dt.total_seconds().to_numpy(), cells.isna().to_numpy())
    # In microseconds, which reach further than the years 1677 to 2262 of nanoseconds.
    moments = pd.to_datetime(cells, errors="coerce", utc=True, format="ISO8601").dt.as_unit("us")
    times = (moments - EPOCH).dt.total_seconds().to_numpy(dtype=float)
    if np.isfinite(times).all():
        return Times(times, np.zeros(len(times), dtype=bool))
    texts = [cell.strip() if isinstance(cell, str) else str(cell) for cell in cells]
    for pattern, read in ((_CLOCK, _read_clock), (_DATE, _read_dates), (_COMPACT, _read_compact)):
        matches = [pattern.fullmatch(text) for text in texts]
        if 2 * sum(match is not None for match in matches) > len(texts):
            return read(matches)
    return Times(times, ~np.isfinite(times))


def find_times(frame: pd.DataFrame) -> str:
    """The first column of texts or moments each of which is a time; empty without one.

    Examples
    --------
    >>> find_times(pd.DataFrame({"y": [1.0, 2.0], "by": ["Ann", "Bob"], "at": ["14:02", "14:09"]}))
    'at'
    """
    texts = frame.select_dtypes(exclude="number")
    return next((str(name) for name, column in texts.items() if _has_times(column)), "")


def _has_times(column: pd.Series[Any]) -> bool:
    cells = column.astype(object)
    if not all(isinstance(cell, str | datetime) for cell in cells) or cells.nunique() < 2:
        return False
    if all(str(cell).isdecimal() for cell in cells):  # numbers of samples rather than years
        return False
    return not any(read_times(some).bad.any() for some in (cells.iloc[:N_SAMPLE], cells))


def _read_clock(matches: list[re.Match[str] | None]) -> Times:
    """Clock times, of which one far before the last is of the next day."""
    seconds = np.array([_clock_seconds(match.groups()) if match else np.nan for match in matches])
    known = np.isfinite(seconds)
    days = np.cumsum(np.diff(seconds[known], prepend=seconds[known][:1]) < -DAY / 2)
    seconds[known] += DAY * days
    return Times(seconds, ~known, note=NEXT_DAY if days.max(initial=0) else "")


def _clock_seconds(parts: tuple[str | None, ...]) -> float:
    """Seconds since midnight of hours, minutes, seconds, and a or p; NaN where there is no such time."""
    hours, minutes, seconds = (float((part or "0").replace(",", ".")) for part in parts[:3])
    half = (parts[3] or "").lower()
    if half:
        hours = hours % 12 + 12 * (half == "p") if 1 <= hours <= 12 else np.nan
    return 3600 * hours + 60 * minutes + seconds if hours < 24 and minutes < 60 and seconds < 61 else np.nan


def _read_dates(matches: list[re.Match[str] | None]) -> Times:
    found = [match for match in matches if match]
    one, two = np.array([[int(match[1]), int(match[3])] for match in found]).T
    points = any(match[2] == "." for match in found)
    bad = np.array([match is None for match in matches])
    day_first = points or bool(np.any(one > 12))
    if not day_first and not np.any(two > 12) and np.any(one != two):
        return Times(np.full(len(matches), np.nan), np.ones(len(matches), dtype=bool), AMBIGUOUS)
    seconds = np.full(len(matches), np.nan)
    for place, match in enumerate(matches):
        if match:
            day, month = (match[1], match[3]) if day_first else (match[3], match[1])
            clock = match.groups()[5:9] if match[5] else ("0", "0", None, None)
            seconds[place] = _date_seconds(match[4], month, day) + _clock_seconds(clock)
    order = "day/month/year" if day_first else "month/day/year"
    note = "" if points else f"dates are read as {order}"
    return Times(seconds, bad | ~np.isfinite(seconds), note=note)


def _read_compact(matches: list[re.Match[str] | None]) -> Times:
    seconds = np.full(len(matches), np.nan)
    for place, match in enumerate(matches):
        if match:
            seconds[place] = _date_seconds(*match.groups()[:3]) + _clock_seconds((*match.groups()[3:], None))
    return Times(seconds, ~np.isfinite(seconds))


def _date_seconds(year: str, month: str, day: str) -> float:
    """Seconds since 1970; NaN where there is no such day."""
    with suppress(ValueError):
        return datetime(int(year) + 2000 * (len(year) == 2), int(month), int(day), tzinfo=UTC).timestamp()
    return float("nan")
