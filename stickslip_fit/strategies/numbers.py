"""Every number of a comparison as files, in people's units."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import write_atomically
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.strategies.comparison import Comparison
from stickslip_fit.strategies.trials import WHERE
from stickslip_fit.units import to_si

Array = npt.NDArray[np.float64]

DECIMALS = 6  # of degrees and mm: finer than anything that can be set
ANGLES = ("q1", "q2", "theta", "psi")
ABSOLUTE = (
    "measured",
    "predicted",
    "absolute",
    "rms",
    "bias",
    "worst",
    "typical_worst",
    "difference",
    "floor",
)
RELATIVE = "_relative"


def tables(found: Comparison) -> dict[str, pd.DataFrame]:
    """All tables of a comparison by name, SI."""
    cost = found.cost()
    return {
        "errors": found.errors,
        "spent": found.spent,
        "left_out": found.left_out,
        "accuracy": found.accuracy().merge(cost, on=["joint", "strategy"], suffixes=("", "_made"))
        if len(cost)
        else cost,
        "accuracy_by_direction": found.accuracy("direction"),
        "accuracy_by_configuration": found.accuracy("direction", *WHERE),
        "pairs": found.pairs,
        "bounds": found.bounds,
    }


def save_numbers(found: Comparison, folder: str | Path) -> list[Path]:
    """Write each table as CSV and as Parquet; the folder is made where it is not there.

    Angles are in deg, positions in mm, step sizes and their errors in what the column unit says, relative
    numbers in %, under names that end so.

    Raises
    ------
    InputError
        If the folder cannot be made or written to.
    """
    folder = Path(folder)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(
            Problem(f"cannot be made ({error.strerror}); name a folder in an existing one", str(folder))
        ) from None
    written = []
    for name, table in tables(found).items():
        shown, stream = in_peoples_units(table), io.BytesIO()
        shown.to_parquet(stream, index=False)
        for suffix, content in ((".csv", shown.to_csv(index=False)), (".parquet", stream.getvalue())):
            written.append(folder / f"{name}{suffix}")
            write_atomically(written[-1], content)
    return written


def in_peoples_units(table: pd.DataFrame) -> pd.DataFrame:
    """A table with its units in names and, for step sizes, in a column of its own."""
    if "joint" not in table:
        return table
    prismatic = (table["joint"] == PRISMATIC).to_numpy()
    scale = np.where(prismatic, to_si(1.0, "nm"), to_si(1.0, "µrad"))
    columns: dict[str, object] = {}
    for name in table:
        if name in ("start", "stop"):
            end, values = {"start": "from", "stop": "to"}[name], table[name].to_numpy()
            columns[f"{end}_deg"] = np.where(prismatic, np.nan, _degrees(values))
            columns[f"{end}_mm"] = np.where(prismatic, _millimetres(values), np.nan)
        elif name in ANGLES:
            columns[f"{name}_deg"] = _degrees(table[name].to_numpy())
        elif name == "q3":
            columns["q3_mm"] = _millimetres(table[name].to_numpy())
        elif name in ("relative", "sd"):
            columns[f"{name}_pct"] = 100 * table[name]
        elif RELATIVE in name:
            columns[f"{name.replace(RELATIVE, '')}_pct"] = 100 * table[name]
        elif name.removesuffix("_low").removesuffix("_high") in ABSOLUTE:
            columns.setdefault("unit", np.where(prismatic, "nm", "µrad").astype(object))
            columns[name] = table[name] / scale
        else:
            columns[name] = table[name]
    return pd.DataFrame(columns).rename(columns={"absolute": "error", "relative_pct": "error_pct"})


def _degrees(values: Array) -> Array:
    return np.degrees(values).round(DECIMALS) + 0.0


def _millimetres(values: Array) -> Array:
    return (values / to_si(1.0, "mm")).round(DECIMALS) + 0.0
