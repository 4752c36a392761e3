"""When to make a traverse: later in the session, after other traverses, in another room."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from stickslip_fit.logs.columns import CONDITIONS, COVARIATE
from stickslip_fit.units import from_si

HOURS = (1.0, 2.0, 4.0, 7.0)
HOUR = 3600.0


def moments_ahead(rows: pd.DataFrame, places: pd.DataFrame, log: pd.DataFrame) -> pd.DataFrame:
    """Traverses again at every moment that could matter.

    Parameters
    ----------
    rows : DataFrame
        As they are right after the calibration.
    places : DataFrame
        Traverses that may be made just before, with their ``load``.
    log : DataFrame
        Rows of the log, for the conditions it saw.
    """
    return pd.concat([*_later(rows), *_following(rows, places), *_conditions(rows, log)], ignore_index=True)


def before_calibration(rows: pd.DataFrame) -> pd.DataFrame:
    """Traverses as the first of a session that is calibrated an hour later."""
    note = "as the session's first traverse, calibrating an hour later"
    return rows.assign(session_seconds=0.0, before_direction="", before_load=0.0, note=note)


def _later(rows: pd.DataFrame) -> Iterator[pd.DataFrame]:
    for hours in HOURS:
        then = rows.assign(session_seconds=rows["session_seconds"] + hours * HOUR)
        yield then.assign(note=f"{hours:g} h after the calibration, the joint at rest")
        driven = hours * HOUR / (rows["seconds"] / rows["steps"])
        yield then.assign(
            steps_before=rows["steps_before"] + driven,
            note=f"{hours:g} h after the calibration, the joint driven to and fro all the while",
        )


def _following(rows: pd.DataFrame, places: pd.DataFrame) -> Iterator[pd.DataFrame]:
    yield rows.assign(before_direction=rows["direction"], note="right after a traverse in the same direction")
    for extreme in (places.loc[places["load"].idxmin()], places.loc[places["load"].idxmax()]):
        where = ", ".join(
            f"{name} {from_si(extreme[name], 'deg'):.0f}°"
            for name in ("q1", "q2", "theta", "psi")
            if np.isfinite(extreme[name]) and (name != "q1" or extreme[name] != 0.0)
        )
        yield rows.assign(
            before_load=extreme["load"],
            note=f"right after a traverse under load {extreme['load']:+.2f} ({where})".replace("-", "−"),
        )


def _conditions(rows: pd.DataFrame, log: pd.DataFrame) -> Iterator[pd.DataFrame]:
    for name in (name for name in log.columns if name in CONDITIONS or name.startswith(COVARIATE)):
        label, unit, beyond = name.removeprefix(COVARIATE), "1", 0.0
        if condition := CONDITIONS.get(name):
            label, unit, beyond = condition.label, condition.unit, condition.beyond
        low, high = float(log[name].min()), float(log[name].max())
        if low == high:
            low, high = max(low - beyond, low / 2), high + beyond
        for value in (low, high):
            if np.isfinite(value) and low < high:
                shown = f"{from_si(value, unit):.4g} {unit if unit != '1' else ''}".strip()
                yield rows.assign(**{name: value}, note=f"once the session is calibrated, at {label} {shown}")
