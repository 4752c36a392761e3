"""Whether the rows of a log can be computed with, for frames that no reader has checked."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._typing import BoolArray
from stickslip_fit.errors import InputError, InputIssue

MAX_ROWS_NAMED = 5
_COORDINATES = ("q1", "q2", "q3")
_NUMBERS = ("steps", "theta", "psi", "start", "stop", *_COORDINATES)
_COLUMNS = ("session", "time", "joint", "direction", "steps", *_COORDINATES, "theta", "psi", "start", "stop")


def check_rows(rows: pd.DataFrame) -> None:
    """Check what every computation relies on: counts above 0, positions that are numbers.

    Raises
    ------
    InputError
        With every fault, by column and row number (counted from 0, as `DataFrame.iloc`). Traverses whose
        status is not ok are not looked at.
    """
    missing = [name for name in (*_COLUMNS, "status") if name not in rows]
    if missing:
        raise InputError(f"a log's rows lack the column{'s' * (len(missing) > 1)} {join_words(missing)}")
    usable = (rows["status"] == "ok").to_numpy()
    text = [name for name in _NUMBERS if not pd.api.types.is_numeric_dtype(rows[name])]
    issues = [InputIssue(f"has to hold numbers, not {rows[name].dtype}", column=name) for name in text]
    for name in _NUMBERS:
        if name in text:
            continue
        values = rows[name].to_numpy(float)
        wrong = ~np.isfinite(values)
        if name in _COORDINATES:
            # A joint's own position is not one number while it moves.
            wrong &= (rows["joint"] != int(name[1])).to_numpy()
        issues += _explain(rows, name, usable & wrong, "must be a finite number")
        if name == "steps":
            issues += _explain(rows, name, usable & (values <= 0), "must be above 0")
    issues += _explain(rows, "joint", usable & ~rows["joint"].isin((1, 2, 3)).to_numpy(), "must be 1, 2 or 3")
    issues += _explain(
        rows, "direction", usable & ~rows["direction"].isin(("+", "-")).to_numpy(), "must be + or -"
    )
    issues += _explain(rows, "time", usable & rows["time"].isna().to_numpy(), "must be given")
    if issues:
        raise InputError(issues)


def _explain(rows: pd.DataFrame, column: str, wrong: BoolArray, rule: str) -> list[InputIssue]:
    places = np.flatnonzero(wrong)
    if not len(places):
        return []
    named = [str(place) for place in places[:MAX_ROWS_NAMED]]
    if len(places) > MAX_ROWS_NAMED:
        named.append(f"{len(places) - MAX_ROWS_NAMED} more")
    where = f"{'row' if len(places) == 1 else 'rows'} {join_words(named)}"
    advice = "correct it, or give the traverse the status excluded"
    return [InputIssue(f"{rule} in {where}; {advice}", None, None, column, str(rows[column].iloc[places[0]]))]
