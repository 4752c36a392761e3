"""The traverses behind a report's figures, in columns of small integers, for the script of its page."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isfinite, log10
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import DECIMALS, format_configuration, format_direction, joint_name, step_unit
from stickslip_fit.errors import shorten
from stickslip_fit.fit import Result
from stickslip_fit.logs import Log
from stickslip_fit.report.figures.departures import POINTS
from stickslip_fit.report.figures.traverses import POSITION, recent, repeatability_of, thinned, traverses_of
from stickslip_fit.report.quantities import HOURS, quantities
from stickslip_fit.units import from_si

Array = npt.NDArray[np.float64]

MOST, FURTHEST = 5000, 500  # traverses of a joint
DIGITS = 4  # of the largest value on an axis: finer than a screen
LONGEST_NOTE = 200


def shown_traverses(log: Log, calibration: Result, fit: Result) -> dict[str, Any]:
    """What a page tells of each traverse that can be pointed at.

    Of a joint with more than `MOST` traverses it is those that the figures draw, the furthest from the law,
    and others by lot.

    Returns
    -------
    dict
        sessions (names); begun (s since 1970, the zero of all times); and joints, each with its number,
        name, unit, how many traverses it has in all, repeatability by direction, and columns that belong
        together: row (its number among the log's usable traverses), session (which of the names), time (s),
        sign, configuration (which of the texts), steps, seen and law (step sizes times `per`), and of each
        quantity its values times `per`; None where something is not known.
    """
    sessions = list(log.sessions)
    begun = log.rows["time"].min()
    joints = [_joint(joint, log, calibration, fit, sessions, begun) for joint in fit.joints]
    return {"sessions": sessions, "begun": int(begun.timestamp()), "joints": joints}


def kept(rows: pd.DataFrame) -> pd.DataFrame:
    """As many of a joint's traverses as a page holds."""
    if len(rows) <= MOST:
        return rows
    furthest = rows["departure"].abs().nlargest(FURTHEST).index
    drawn = thinned(recent(rows), MOST // 2).index.union(thinned(rows, POINTS).index)
    chosen = drawn.union(furthest)
    others = rows.drop(index=chosen)
    return rows.loc[chosen.union(thinned(others, max(MOST - len(chosen), 0)).index)]


def _joint(
    joint: int, log: Log, calibration: Result, fit: Result, sessions: Sequence[str], begun: pd.Timestamp
) -> dict[str, Any]:
    everything = traverses_of(joint, log, calibration, fit)
    rows, unit = kept(everything), step_unit(joint)
    places, texts = _configurations(rows, log.machine.span(joint))
    per = 10 ** (DECIMALS[unit] + 1)
    return {
        "joint": joint,
        "name": joint_name(joint),
        "unit": unit,
        "all": len(everything),
        "repeatability": [_share(repeatability_of(joint, sign, calibration, fit).value) for sign in "+-"],
        "per": per,
        "configurations": texts,
        "row": [int(row) for row in rows.index],
        "session": rows["session"].astype(object).map({name: k for k, name in enumerate(sessions)}).tolist(),
        "time": [int(passed) for passed in (rows["time"] - begun).dt.total_seconds()],
        "sign": "".join(map(format_direction, rows["direction"])),
        "configuration": places,
        "steps": rows["steps"].astype(int).tolist(),
        "seen": _scaled(from_si(rows["step_size"].to_numpy(float), unit), per),
        "law": _scaled(from_si(rows["model"].to_numpy(float), unit), per),
        "notes": {str(row): shorten(str(note), LONGEST_NOTE) for row, note in rows["note"].items() if note},
        "quantities": [_quantity(label, values) for label, values in _axes(rows).items()],
    }


def _configurations(rows: pd.DataFrame, span: float) -> tuple[list[int], list[str]]:
    """Which configuration each row has, and all of them in words."""
    names = ["joint", *POSITION, "start", "stop"]
    places = rows.groupby(names, sort=False, dropna=False).ngroup()
    first = rows.loc[~places.duplicated(), names]
    texts = [format_configuration(row, span) for _, row in first.iterrows()]
    different = list(dict.fromkeys(texts))  # both directions of a full traverse read alike
    return [different.index(texts[place]) for place in places], different


def _axes(rows: pd.DataFrame) -> dict[str, Array]:
    """What varied; the hours where nothing did."""
    return quantities(rows) or {HOURS: from_si(rows["session_seconds"].to_numpy(float), "h")}


def _quantity(label: str, values: Array) -> dict[str, Any]:
    largest = float(np.nanmax(np.abs(values)))
    per = 10.0 ** (DIGITS - ceil(log10(largest))) if largest > 0 else 1.0
    return {"label": label, "per": per, "values": _scaled(values, per)}


def _scaled(values: Array, per: float) -> list[int | None]:
    return [round(value * per) if isfinite(value) else None for value in values.tolist()]


def _share(value: float) -> float | None:
    return round(value, 6) if isfinite(value) else None
