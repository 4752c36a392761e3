"""What a page tells of single traverses, as data for its script."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isfinite, log10
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import STEP_DECIMALS, format_configuration, format_direction, joint_name, step_unit
from stickslip_fit._typing import Array
from stickslip_fit.errors import shorten
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.prediction import collect_traverses
from stickslip_fit.estimation.result import choose_repeatability
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import has_times, position_columns
from stickslip_fit.machine import Machine
from stickslip_fit.plotting._style import select_recent, thin_rows
from stickslip_fit.plotting.residuals import FIT_MAX_POINTS, SESSION_HOURS, collect_covariates
from stickslip_fit.units import from_si

MAX_TRAVERSES, MAX_OUTLYING = 5000, 500  # of a joint, that a page holds
SIGNIFICANT_DIGITS = 4  # of the largest value on an axis: finer than a screen
MAX_NOTE_LENGTH = 200


def make_traverses_payload(log: Log, calibration: Result, fit: Result) -> dict[str, Any]:
    """What a page tells of each traverse that can be pointed at.

    Of a joint with more than `MAX_TRAVERSES` these are the ones that the figures draw, the largest residuals,
    and a random sample.

    Returns
    -------
    dict
        sessions (names); begun (s since 1970, the zero of all times); and joints, each with its number,
        name, unit, how many traverses it has in all, repeatability by direction, and columns of equal
        length: row (number among the log's usable traverses), session (index into the names), time (s),
        sign, configuration (index into the texts), steps, seen and law (step sizes times `per`), and of
        each quantity its values times `per`; None where not known.
    """
    sessions = list(log.sessions)
    begin = log.rows["time"].min() if has_times(log.rows) else pd.Timestamp(0)
    joints = [_joint_payload(joint, log, calibration, fit, sessions, begin) for joint in fit.joints]
    return {"sessions": sessions, "begun": int(begin.timestamp()), "joints": joints}


def thin_traverses(rows: pd.DataFrame) -> pd.DataFrame:
    """As many of a joint's traverses as a page holds."""
    if len(rows) <= MAX_TRAVERSES:
        return rows
    drawn = thin_rows(select_recent(rows), MAX_TRAVERSES // 2).index.union(
        thin_rows(rows, FIT_MAX_POINTS).index
    )
    chosen = drawn.union(rows["departure"].abs().nlargest(MAX_OUTLYING).index)
    others = thin_rows(rows.drop(index=chosen), max(MAX_TRAVERSES - len(chosen), 0))
    return rows.loc[chosen.union(others.index)]


def _joint_payload(
    joint: int, log: Log, calibration: Result, fit: Result, sessions: Sequence[str], begin: pd.Timestamp
) -> dict[str, Any]:
    traverses = collect_traverses(joint, log, calibration, fit)
    rows, unit = thin_traverses(traverses), step_unit(joint, log.machine)
    configuration, texts = _number_configurations(rows, log.machine)
    repeatability = [choose_repeatability(joint, sign, calibration, fit).value for sign in "+-"]
    seconds = np.nan_to_num(rows["session_seconds"].to_numpy(float))
    quantities = collect_covariates(rows, log.machine) or {SESSION_HOURS: from_si(seconds, "h")}
    per = 10 ** (STEP_DECIMALS[unit] + 1)
    return {
        "joint": joint,
        "name": joint_name(joint, log.machine),
        "unit": unit,
        "all": len(traverses),
        "repeatability": [round(value, 6) if isfinite(value) else None for value in repeatability],
        "per": per,
        "configurations": texts,
        "row": [int(row) for row in rows.index],
        "session": rows["session"].astype(object).map({name: k for k, name in enumerate(sessions)}).tolist(),
        "time": _scale_to_integers(np.floor((rows["time"] - begin).dt.total_seconds().to_numpy(float)), 1.0),
        "sign": "".join(map(format_direction, rows["direction"])),
        "configuration": configuration,
        "steps": rows["steps"].astype(int).tolist(),
        "seen": _scale_to_integers(from_si(rows["step_size"].to_numpy(float), unit), per),
        "law": _scale_to_integers(from_si(rows["model"].to_numpy(float), unit), per),
        "notes": {
            str(row): shorten(str(note), MAX_NOTE_LENGTH) for row, note in rows["note"].items() if note
        },
        "quantities": [_quantity_payload(label, values) for label, values in quantities.items()],
    }


def _number_configurations(rows: pd.DataFrame, machine: Machine) -> tuple[list[int], list[str]]:
    """The number of each row's configuration, and all configurations in words."""
    names = ["joint", *position_columns(rows), "start", "stop"]
    codes = rows.groupby(names, sort=False, dropna=False).ngroup()
    first = rows.loc[~codes.duplicated(), names]
    texts = [format_configuration(row, machine) for row in first.to_dict("records")]
    number = {text: k for k, text in enumerate(dict.fromkeys(texts))}  # both directions have the same text
    return [number[texts[code]] for code in codes], list(number)


def _quantity_payload(label: str, values: Array) -> dict[str, Any]:
    largest = float(np.nanmax(np.abs(values)))
    per = 10.0 ** (SIGNIFICANT_DIGITS - ceil(log10(largest))) if largest > 0 else 1.0
    return {"label": label, "per": per, "values": _scale_to_integers(values, per)}


def _scale_to_integers(values: Array, per: float) -> list[int | None]:
    return [round(value * per) if isfinite(value) else None for value in values.tolist()]
