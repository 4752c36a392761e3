"""A plan as a sheet to fill in: the log's own format, with time and steps left empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit.files import write_atomically
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.units import from_si


def sheet_table(plan: Plan) -> pd.DataFrame:
    """The cells of the sheet as text, one row per traverse in the order in which they are to be made."""
    rows = plan.rows()
    rotary = rows["joint"] != PRISMATIC
    ends = {"from": rows["start"], "to": rows["stop"]}
    blank = pd.Series("", rows.index)
    return pd.DataFrame(
        {
            "session": rows["session"],
            "time": blank,
            "joint": rows["joint"],
            "direction": rows["direction"],
            "steps": blank,
            **{f"{name}_deg": _cells(rows[name], "deg") for name in ("q1", "q2")},
            "q3_mm": _cells(rows["q3"], "mm"),
            **{f"{name}_deg": _cells(rows[name], "deg") for name in ("theta", "psi")},
            **{f"{name}_deg": _cells(end.where(rotary), "deg") for name, end in ends.items()},
            **{f"{name}_mm": _cells(end.where(~rotary), "mm") for name, end in ends.items()},
            "check_every": rows["check_every"],
            "step_period_ms": _cells(rows["step_period"], "ms"),
            "status": blank,
            "note": blank,
        }
    )


def write_sheet_csv(plan: Plan, path: str | Path) -> None:
    """Write the sheet, so that a person fills it in and the reader takes it as a log.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    text = sheet_table(plan).to_csv(index=False, lineterminator="\n")
    write_atomically(path, text)


def _cells(values: pd.Series, symbol: str) -> list[str]:
    """Numbers as a person writes them; empty for the moving joint's own."""
    return [
        "" if np.isnan(value) else f"{value + 0.0:.10g}"
        for value in from_si(values.to_numpy(float), symbol).round(10)
    ]
