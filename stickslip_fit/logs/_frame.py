"""check_frame: whether the rows of a Log are what a file could have given."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite

import numpy as np
import pandas as pd

from stickslip_fit._typing import BoolArray
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.logs.schema import (
    CONDITIONS,
    COVARIATE_PREFIX,
    ORIENTATION,
    OWN_LIMITS,
    LogFormat,
    is_outside,
    log_format,
)
from stickslip_fit.machine import Machine

_ROW_NUMBERS = ("joint", "steps", "check_every", "start", "stop")
_ROW_TEXTS = {"direction": ("+", "-"), "status": ("ok", "interrupted", "excluded")}


def check_frame(rows: pd.DataFrame, machine: Machine) -> None:
    """Refuse rows of a machine's Log that no file could have given, such as a count of 0 or NaN.

    InputError has an issue for each column, with the labels of its first rows.
    """
    form = log_format(machine)
    positions = [f"q{joint}" for joint in machine.joints]
    numbers = (*_ROW_NUMBERS, *ORIENTATION, *positions, *CONDITIONS)
    if missing := sorted({*numbers, *_ROW_TEXTS, "session", "time"} - set(rows)):
        raise InputError(f"the rows of a log need the columns {', '.join(missing)}; see Log.rows")
    own = [name for name in rows if str(name).startswith(COVARIATE_PREFIX)]
    faults = {"time": _wrong_times(rows["time"], form), "session": rows["session"].isna().to_numpy()}
    faults |= {name: ~rows[name].isin(choices).to_numpy() for name, choices in _ROW_TEXTS.items()}
    faults |= _wrong_numbers(rows, [*numbers, *own], form)
    issues = []
    for name, wrong in faults.items():
        if wrong.any():
            labels = ", ".join(map(str, rows.index[wrong][:MAX_LABELS]))
            more = f" and {wrong.sum() - MAX_LABELS:,} more" if wrong.sum() > MAX_LABELS else ""
            where = f"{'row' if wrong.sum() == 1 else 'rows'} {labels}{more}"
            message = f"not allowed in {where}; give {_describe_values(name, form)}"
            issues.append(InputIssue(message, column=name, value=str(rows[name].to_numpy()[wrong][0])))
    if issues:
        raise InputError(issues)


MAX_LABELS = 5  # of rows with one fault


def _wrong_times(time: pd.Series, form: LogFormat) -> BoolArray:
    """Other types than times, and missing times: where these may be missing, all of them are."""
    if not pd.api.types.is_datetime64_any_dtype(time):
        return np.ones(len(time), np.bool_)
    missing = time.isna().to_numpy()
    may_be_missing = not form.by_name["time"].required and missing.all()
    return np.zeros_like(missing) if may_be_missing else missing


def _wrong_numbers(rows: pd.DataFrame, names: Sequence[str], form: LogFormat) -> dict[str, BoolArray]:
    faults = {name: np.ones(len(rows), np.bool_) for name in names if not _is_number(rows[name].dtype)}
    numeric = [name for name in names if name not in faults]
    # All together: column by column took half of `Log.usable`.
    values = np.stack([rows[name].to_numpy(np.float64, na_value=np.nan) for name in numeric], axis=1)
    low, high = np.array([_row_limits(name, form) for name in numeric]).T
    needed = np.array([_is_needed(name, form) for name in numeric])
    joint, last = rows["joint"].to_numpy(), int(form.by_name["joint"].limits[1])
    wrong = np.isinf(values) | (np.isnan(values) & needed) | is_outside(values, (low, high))
    for place, name in enumerate(numeric):
        if name.startswith("q") and name in form.by_name:
            others = [one for one in range(1, last + 1) if one != int(name[1:])]
            wrong[:, place] |= np.isnan(values[:, place]) & np.isin(joint, others)
        faults[name] = wrong[:, place]
    return {name: faults[name] for name in names}


def _is_number(dtype: object) -> bool:
    return pd.api.types.is_numeric_dtype(dtype) and not pd.api.types.is_bool_dtype(dtype)


def _is_needed(name: str, form: LogFormat) -> bool:
    return name in _ROW_NUMBERS or (name in ORIENTATION and form.by_name[name].required)


def _row_limits(name: str, form: LogFormat) -> tuple[float, float]:
    if name in ("start", "stop"):
        return (-inf, inf)
    return form.by_name[name].limits if name in form.by_name else OWN_LIMITS


def _describe_values(name: str, form: LogFormat) -> str:
    if name in _ROW_TEXTS:
        return " or ".join(_ROW_TEXTS[name])
    if name in ("session", "time"):
        return {"session": "a label", "time": "datetime64"}[name]
    low, high = _row_limits(name, form)
    return f"a number, {low:g} to {high:g}, SI" if isfinite(low) else "a finite number, SI"
