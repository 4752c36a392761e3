"""A log back into its file format."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa

from stickslip_fit.files import write_atomically
from stickslip_fit.logs.columns import CHECK_EVERY, CONDITIONS, COVARIATE, FIELDS
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.units import SUFFIXES, from_si, to_si

if TYPE_CHECKING:
    from stickslip_fit.logs.log import Log

Floats = npt.NDArray[np.float64]

_FIELDS = {field.name: field for field in FIELDS}


def write_log(log: Log | pd.DataFrame, path: str | Path) -> None:
    """Write a log as CSV so that reading it gives the same rows.

    Quantities are written in the units people use (deg, mm, °C, ms, g), or in SI where a value has no
    exact equal there. Optional columns that say nothing are left out; from and to are always written,
    so that the traverses stay what they were under any machine file.

    Parameters
    ----------
    log : Log or DataFrame
        A Log, or its rows; history is not written, since the reader works it out.
    path : str or Path
        Written whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    rows = log if isinstance(log, pd.DataFrame) else log.rows
    write_atomically(path, to_csv(rows))


def to_csv(rows: pd.DataFrame) -> bytes:
    """Rows of a Log as the bytes of a CSV file."""
    columns = _columns(rows)
    header = ",".join(map(_quoted, columns))
    lines = map(",".join, zip(*columns.values(), strict=True))
    return "\n".join([header, *lines, ""]).encode("utf-8")


def _quoted(text: str) -> str:
    """Text as a cell; unlike the csv module, lone carriage returns are quoted too."""
    return '"' + text.replace('"', '""') + '"' if re.search('[",\r\n]', text) else text


def _texts(values: pd.Series) -> list[str]:
    quoted = {text: _quoted(text) for text in values.unique()}
    return [quoted[text] for text in values]


def _columns(rows: pd.DataFrame) -> dict[str, list[str]]:
    """Column name to cells."""
    columns = {
        "session": _texts(rows["session"]),
        "time": _times(rows["time"]),
        "joint": _numbers(rows["joint"]),
        "direction": _texts(rows["direction"]),
        "steps": _numbers(rows["steps"]),
    }
    for name in ("q1", "q2", "q3", "theta", "psi"):
        columns |= _quantity(name, rows[name].to_numpy())
    for kind, mine in (("angle", rows["joint"] != PRISMATIC), ("length", rows["joint"] == PRISMATIC)):
        for end, inside in (("from", "start"), ("to", "stop")):
            if mine.any():
                columns |= _quantity(f"{end}_{kind}", rows[inside].where(mine).to_numpy())
    return columns | _optional(rows)


def _optional(rows: pd.DataFrame) -> dict[str, list[str]]:
    columns: dict[str, list[str]] = {}
    if (rows["check_every"] != CHECK_EVERY).any():
        columns["check_every"] = _numbers(rows["check_every"])
    if (rows["status"] != "ok").any():
        columns["status"] = _texts(rows["status"])
    for name in CONDITIONS:
        if rows[name].notna().any():
            columns |= _quantity(name, rows[name].to_numpy())
    if (rows["note"] != "").any():
        columns["note"] = _texts(rows["note"])
    for name in rows.columns:
        if name.startswith(COVARIATE):
            columns[name.removeprefix(COVARIATE)] = _numbers(rows[name])
        elif name.startswith("text:"):
            columns[name.removeprefix("text:")] = _texts(rows[name])
    return columns


def _quantity(name: str, values: Floats) -> dict[str, list[str]]:
    """One column, in the first unit in which every value has an exact equal."""
    field = _FIELDS[name]
    candidates = [
        (spelling, _in_unit(values, SUFFIXES[suffix]))
        for spelling, suffix in zip(field.spellings, field.suffixes, strict=True)
    ]
    spelling, written = next((found for found in candidates if found[1][1]), candidates[0])
    return {spelling: _numbers(written[0])}


def _in_unit(values: Floats, unit: str) -> tuple[Floats, bool]:
    """Short decimals that read back as `values`, and whether all of them do to the last bit."""
    # What overflows on the way is no equal of anything, and another unit is tried.
    with np.errstate(over="ignore", invalid="ignore"):
        exact = from_si(values, unit)
        neighbours = (np.nextafter(exact, -np.inf), np.nextafter(exact, np.inf))
        written, missed = exact, ~np.isnan(values)
        for candidate in (np.round(exact, 9), np.round(exact, 12), exact, *neighbours):
            hit = missed & (to_si(candidate, unit) == values)
            written = np.where(hit, candidate, written)
            missed &= ~hit
    return written, not missed.any()


def _numbers(values: pd.Series | Floats) -> list[str]:
    """Shortest decimals that read back as the same numbers; empty for NaN."""
    return pa.array(values, from_pandas=True).cast(pa.string()).fill_null("").to_pylist()


def _times(time: pd.Series) -> list[str]:
    """ISO 8601, as fine as the finest time needs; with Z where the log has zones."""
    utc = time.to_numpy(dtype="datetime64[ns]")
    units: tuple[Literal["s", "ms", "us", "ns"], ...] = ("s", "ms", "us", "ns")
    unit = next(unit for unit in units if (utc == utc.astype(f"M8[{unit}]")).all())
    zone = "" if time.dt.tz is None else "Z"
    return [text + zone for text in np.datetime_as_string(utc, unit=unit).tolist()]
