"""Conditions as a person types them during a capture: what the room and the drive are like."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs.columns import CONDITION_SPELLINGS, COVARIATE, fault_of_name, is_known
from stickslip_fit.units import from_si, to_si

EXAMPLE = "temperature_C=22.5 humidity_pct=40"
PLANNED = "step_period"


def conditions_of(text: str, option: str | None = None) -> dict[str, float]:
    """What "temperature_C=22.5 pressure_hPa=1013" says, by the columns of a log, SI.

    Parameters
    ----------
    text : str
        Names as a log's columns have them, each with a number. Other names than the format's make columns of
        the lab's own.
    option : str, optional
        As messages call it.

    Raises
    ------
    InputError
        For what is no such pair, lacks its unit, or is said by the plan.

    Examples
    --------
    >>> conditions_of("supply_V=80, payload_g=0.5 pressure_hPa=1013")
    {'supply': 80.0, 'payload': 0.0005, 'covariate:pressure_hPa': 1013.0}
    """
    pairs = re.findall(r"[^\s,;]+", re.sub(r"\s*=\s*", "=", text))
    return dict(_condition(pair, option) for pair in pairs)


def _condition(pair: str, option: str | None) -> tuple[str, float]:
    name, _, said = pair.partition("=")
    column, unit = CONDITION_SPELLINGS.get(name, (COVARIATE + name, "1"))
    message = None
    value = _number(said)
    if value is None or not name:
        message = f"give a name and a number, e.g. {EXAMPLE}"
    elif fault := fault_of_name(name):
        message = fault
    elif column == PLANNED or (is_known(name) and name not in CONDITION_SPELLINGS):
        message = "is what the plan says; leave it out"
    if message or value is None:
        raise InputError(Problem(message or "", column=option, value=pair))
    return column, to_si(value, unit)


def _number(said: str) -> float | None:
    try:
        value = float(said)
    except ValueError:
        return None
    return value if isfinite(value) else None


def conditions_text(conditions: Mapping[str, float]) -> str:
    """Conditions as they would be typed.

    Examples
    --------
    >>> conditions_text({"temperature": 295.65, "covariate:pressure_hPa": 1013.0})
    'temperature_C=22.5 pressure_hPa=1013'
    """
    usual: dict[str, tuple[str, str]] = {}
    for typed, (column, unit) in CONDITION_SPELLINGS.items():
        usual.setdefault(column, (typed, unit))
    shown = []
    for column, value in conditions.items():
        typed, unit = usual.get(column, (column.removeprefix(COVARIATE), "1"))
        shown.append(f"{typed}={float(from_si(value, unit)):.6g}")
    return " ".join(shown)
